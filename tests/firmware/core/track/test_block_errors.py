"""The covariance by the site's errors against least squares of one block with each error really made."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.core.track import dense
from tests.firmware.core.track.single import Bits, Kernel, cube, some_state

POSITION_M, AXIS_RAD, CURRENT = 0.003, 0.005, 0.004
GAIN, SENSOR_AXIS_RAD = 0.006, 0.007


def wrong_coils(coils):
    """Yield coils with one error of one standard deviation each."""
    for i in range(len(coils.k)):
        for axis in range(3):
            centre, turned, k = coils.centre.copy(), coils.axis.copy(), coils.k.copy()
            centre[i, axis] += POSITION_M
            turned[i] = Rotation.from_rotvec(AXIS_RAD * np.eye(3)[axis]).apply(turned[i])
            yield replace(coils, centre=centre)
            yield replace(coils, axis=turned)
        k[i] *= 1.0 + CURRENT
        yield replace(coils, k=k)


def wrong_sensors():
    """Yield matrices on the fields in the sensor's frame: gains, and axes that lean towards each other."""
    for axis in range(3):
        yield np.eye(3) + GAIN * np.diag(np.eye(3)[axis])
        lean = np.zeros((3, 3))
        lean[axis, axis - 1] = lean[axis - 1, axis] = SENSOR_AXIS_RAD / np.sqrt(2.0)
        yield np.eye(3) + lean


@pytest.mark.parametrize("beacons", [3, 8])
def test_each_error_moves_the_pose_by_its_bias(core, gold_family, beacons):
    rng = np.random.default_rng(beacons)
    coils, noise = cube(beacons), 0.02
    state = replace(some_state(rng, speed=0.0), b=np.zeros(3))
    bits, kernel = Bits(gold_family(10), beacons), Kernel(core, coils, noise)
    gram, moment = dense.products(bits.columns(40))
    right = dense.sums(coils, state, gram, moment)
    _, rows = dense.measured(coils, state, gram, moment, right, noise)
    seen = rows[:9, [*range(6), *range(12, 15)]]
    expected = np.zeros((6, 6))
    wrong = [dense.sums(other, state, gram, moment) for other in wrong_coils(coils)]
    wrong += [right @ matrix for matrix in wrong_sensors()]
    for data in wrong:
        y, _ = dense.measured(coils, state, gram, moment, data, noise)
        bias = np.linalg.solve(seen, y[:9])[:6]
        expected += np.outer(bias, bias)
    expected[3:, 3:] += 0.5 * SENSOR_AXIS_RAD**2 * np.eye(3)
    ffi, lib = core
    kernel.fill(bits.words(40), right)
    measure, covariance = ffi.addressof(kernel.filter.measure), ffi.new("float[6][6]")
    kernel.put_state(measure.reference, state)
    lib.block_measure(kernel.block, kernel.coils, measure)
    errors, table = ffi.new("block_site_errors_t *"), ffi.new("block_beacon_errors_t[]", beacons)
    for entry in table:
        entry.position_sd_m, entry.axis_sd_rad, entry.current_sd = POSITION_M, AXIS_RAD, CURRENT
    errors.beacons, errors.gain_sd, errors.axis_sd_rad = table, GAIN, SENSOR_AXIS_RAD
    lib.block_errors(measure, kernel.coils, beacons, errors, covariance)
    ours, sd = kernel.matrix(covariance), np.sqrt(np.diag(expected))
    np.testing.assert_allclose(ours / np.outer(sd, sd), expected / np.outer(sd, sd), atol=0.03)


def test_without_errors_and_without_information_there_is_none(core, gold_family):
    ffi, lib = core
    coils = cube(1)
    kernel = Kernel(core, coils, 0.02)
    state = some_state(np.random.default_rng(1))
    kernel.fill(Bits(gold_family(10), 1).words(3), np.zeros((2, 3)))
    measure, covariance = ffi.addressof(kernel.filter.measure), ffi.new("float[6][6]")
    kernel.put_state(measure.reference, state)
    lib.block_measure(kernel.block, kernel.coils, measure)
    errors, table = ffi.new("block_site_errors_t *"), ffi.new("block_beacon_errors_t[]", 1)
    errors.beacons = table
    lib.block_errors(measure, kernel.coils, 1, errors, covariance)
    assert not kernel.matrix(covariance).any()
    table[0].position_sd_m = 0.01
    lib.block_errors(measure, kernel.coils, 1, errors, covariance)
    assert np.all(np.isfinite(kernel.matrix(covariance)))
