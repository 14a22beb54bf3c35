"""The covariance by the site's errors against least squares of one block with each error really made."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.core.track import dense
from tests.firmware.core.track.single import Bits, Kernel, cube, some_state

KINDS = {"position": 3e-4, "axis": 5e-4, "current": 4e-4, "gain": 6e-4, "sensor axes": 7e-4}
"""Standard deviations of each kind of error, m, rad or relative: small ones, that second orders do not count."""


def wrong_coils(coils, kind, sizes):
    """Yield coils with one error of one standard deviation each, one for each beacon."""
    for i, size in enumerate(sizes):
        for axis in range(3):
            centre, turned = coils.centre.copy(), coils.axis.copy()
            centre[i, axis] += size
            turned[i] = Rotation.from_rotvec(size * np.eye(3)[axis]).apply(turned[i])
            if kind != "current":
                yield replace(coils, centre=centre) if kind == "position" else replace(coils, axis=turned)
        k = coils.k.copy()
        k[i] *= 1.0 + size
        if kind == "current":
            yield replace(coils, k=k)


def wrong_sensors(kind, size):
    """Yield matrices on the fields in the sensor's frame: gains, or axes that lean towards each other."""
    for axis in range(3):
        lean = np.zeros((3, 3))
        lean[axis, axis - 1] = lean[axis - 1, axis] = size / np.sqrt(2.0)
        yield np.eye(3) + (size * np.diag(np.eye(3)[axis]) if kind == "gain" else lean)


class OneBlock:
    """A block at rest without noise, and what C and the dense calculation make of the site's errors by it.

    The ambient field is that of the Earth or a share of it: it goes into no pose, but single precision shows it.
    """

    def __init__(self, core, gold_family, beacons, ambient=0.04):
        self.ffi, self.lib = core
        self.coils, self.beacons = cube(beacons), beacons
        state = some_state(np.random.default_rng(beacons), speed=0.0)
        self.state = replace(state, e=ambient * state.e, b=np.zeros(3))
        bits, self.kernel = Bits(gold_family(10), beacons), Kernel(core, self.coils, 0.02)
        self.products = dense.products(bits.columns(40))
        self.right = dense.sums(self.coils, self.state, *self.products)
        self.kernel.fill(bits.words(40), self.right)
        self.measure = self.ffi.addressof(self.kernel.filter.measure)
        self.kernel.put_state(self.measure.reference, self.state)
        self.lib.block_measure(self.kernel.block, self.kernel.coils, self.measure)

    def bias(self, data):
        """Return by how much least squares of sums moves position and attitude."""
        y, rows = dense.measured(self.coils, self.state, *self.products, data, 0.02)
        return np.linalg.solve(rows[:9, [*range(6), *range(12, 15)]], y[:9])[:6]

    def covariance(self, sizes=None, **of_sensor):
        """Return that of C, by errors of the beacons, a row of position, axis and current each, and of the sensor."""
        errors = self.ffi.new("block_site_errors_t *", of_sensor)
        table = self.ffi.new("block_beacon_errors_t[]", self.beacons + 1)
        table[self.beacons] = (1.0, 1.0, 1.0)  # Behind those that count.
        for entry, row in zip(table, [] if sizes is None else sizes, strict=False):
            entry.position_sd_m, entry.axis_sd_rad, entry.current_sd = row
        errors.beacons, covariance = table, self.ffi.new("float[6][6]", [[np.nan] * 6] * 6)
        self.lib.block_errors(self.measure, self.kernel.coils, self.beacons, errors, covariance)
        return self.kernel.matrix(covariance)


def by_kind(block, kind):
    """Return the covariance of C by one kind of errors, of which each beacon has another size, and these sizes."""
    sizes = KINDS[kind] * np.linspace(0.5, 1.5, block.beacons)
    if kind == "gain":
        return block.covariance(gain_sd=KINDS[kind]), sizes
    if kind == "sensor axes":
        return block.covariance(axis_sd_rad=KINDS[kind]), sizes
    return block.covariance(np.outer(sizes, np.array(list(KINDS)[:3]) == kind)), sizes


@pytest.mark.parametrize(
    ("beacons", "kind", "ambient", "most"),
    [*((n, kind, 0.04, 0.002) for n in (3, 5) for kind in KINDS), (5, "gain", 1.0, 0.03)],
)
def test_each_error_moves_the_pose_by_its_bias(core, gold_family, beacons, kind, ambient, most):
    block, expected = OneBlock(core, gold_family, beacons, ambient), np.zeros((6, 6))
    ours, sizes = by_kind(block, kind)
    if kind in ("gain", "sensor axes"):
        wrong = [block.right @ matrix for matrix in wrong_sensors(kind, KINDS[kind])]
    else:
        wrong = [dense.sums(other, block.state, *block.products) for other in wrong_coils(block.coils, kind, sizes)]
    for bias in map(block.bias, wrong):
        expected += np.outer(bias, bias)
    if kind == "sensor axes":  # Axes that all lean alike are a turn.
        expected[3:, 3:] += 0.5 * KINDS[kind] ** 2 * np.eye(3)
    sd = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(ours / np.outer(sd, sd), expected / np.outer(sd, sd), atol=most)
    assert np.array_equal(ours, ours.T)


def test_errors_of_all_kinds_add_up(core, gold_family):
    block = OneBlock(core, gold_family, 4)
    each = sum(by_kind(block, kind)[0] for kind in KINDS)
    sizes = np.outer(np.linspace(0.5, 1.5, 4), list(KINDS.values())[:3])
    together = block.covariance(sizes, gain_sd=KINDS["gain"], axis_sd_rad=KINDS["sensor axes"])
    sd = np.sqrt(np.diag(each))
    np.testing.assert_allclose(together / np.outer(sd, sd), each / np.outer(sd, sd), atol=1e-4)


def test_without_errors_and_without_information_there_is_none(core, gold_family):
    block = OneBlock(core, gold_family, 1)
    assert not block.covariance().any()


def test_errors_move_nothing_of_which_a_block_tells_nothing(core, gold_family):
    """One beacon tells three numbers of the pose: the others stay, and these move as by least squares of them alone."""
    block = OneBlock(core, gold_family, 1, ambient=0.04)
    rows = block.kernel.matrix(block.measure.rows)
    known = [k for k in range(6) if rows[3 + k].any()]  # Behind the ambient field's.
    assert len(known) == 3
    expected, sizes = np.zeros((6, 6)), KINDS["current"] * np.ones(1)
    (wrong,) = wrong_coils(block.coils, "current", sizes)
    data = dense.sums(wrong, block.state, *block.products)
    y, seen = dense.measured(block.coils, block.state, *block.products, data, 0.02)
    bias = np.linalg.lstsq(seen[:9, [*known, *range(12, 15)]], y[:9], rcond=None)[0][:3]
    expected[np.ix_(known, known)] = np.outer(bias, bias)
    ours = block.covariance([[0.0, 0.0, sizes[0]]])
    np.testing.assert_allclose(ours, expected, atol=0.01 * expected.max())
    assert np.array_equal(ours == 0.0, expected == 0.0)
