"""What a state leaves of the sums of a block, and which beacon's residual is more than it should be."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from tests.firmware.core.track.dense import State, products, still_part
from tests.firmware.core.track.single import Bits, Kernel, cube, some_state

MOST = 9.0
"""Largest square of a residual over its expectation."""


@dataclass
class Doubts:
    """What is known of errors: of the state, of the beacons, and of the sensor; and noise."""

    position_m2: float = 0.0
    attitude_rad2: float = 0.0
    ambient_uT2: float = 0.0
    position_sd_m: float = 0.0
    axis_sd_rad: float = 0.0
    current_sd: float = 0.0
    gain_sd: float = 0.0
    sensor_axis_sd_rad: float = 0.0
    noise_uT: float = 0.02


class Case:
    """A block of some beacons at a state."""

    def __init__(self, core, gold_family, beacons=4, seed=2):
        self.ffi, self.lib = core
        rng = np.random.default_rng(seed)
        self.count, self.coils = beacons, cube(beacons)
        self.state: State = some_state(rng)
        self.words = Bits(gold_family(10), beacons).words(400)
        self.gram, _ = products(Bits(gold_family(10), beacons).columns(400))
        self.kernel = Kernel(core, self.coils, 0.02)
        self.at = self.ffi.new("block_state_t *")
        self.kernel.put_state(self.at, self.state)
        self.residual = self.ffi.new("block_residual_t *")
        self.data = rng.normal(size=(beacons + 1, 3))

    def fields(self):
        """Fields of the model in the site's frame."""
        return still_part(self.coils, self.state) @ self.state.rotation.T

    def put(self, data, chips=31):
        """Take sums."""
        self.kernel.fill(self.words, data, chips)
        self.lib.block_residual(self.kernel.block, self.kernel.coils, self.count, self.at, self.residual)

    def worst(self, left, doubts, out=0):
        """The beacon that is worst when the sums are the model's and `left`, in the site's frame."""
        return self.judged((self.gram @ self.fields() + left) @ self.state.rotation, doubts, out)

    def judged(self, data, doubts, out=0, chips=31):
        """The beacon that is worst with some sums."""
        self.put(data, chips)
        doubt = self.ffi.new("block_doubt_t *", [doubts.position_m2, doubts.attitude_rad2, doubts.ambient_uT2])
        beacon = [doubts.position_sd_m, doubts.axis_sd_rad, doubts.current_sd]
        beacons = self.ffi.new("block_beacon_errors_t[]", [beacon] * self.count)
        errors = self.ffi.new("block_site_errors_t *", [beacons, doubts.gain_sd, doubts.sensor_axis_sd_rad])
        block, coils = self.kernel.block, self.kernel.coils
        return self.lib.block_residual_worst(
            self.residual, block, coils, self.count, self.at, doubt, errors, doubts.noise_uT, out
        )


def test_residuals_are_what_the_state_leaves_of_the_sums(core, gold_family):
    case = Case(core, gold_family)
    case.put(case.data)
    ours = np.array([list(row) for row in case.residual.left_uT])[:5]
    np.testing.assert_allclose(ours, case.data @ case.state.rotation.T - case.gram @ case.fields(), atol=5e-4)
    np.testing.assert_allclose([list(row) for row in case.residual.field_uT][:5], case.fields(), atol=1e-5)


def one(count, beacon, size):
    """A residual of one beacon that has a length, in a direction of no axis."""
    left = np.zeros((count + 1, 3))
    left[beacon] = size * np.array([0.6, -0.48, 0.64])
    return left


# Each doubt by itself, so great that the rounding of the fields is nothing beside it; and what the truth is of the
# variance of a field, over its square or, of the last two, itself: a gradient is at most 4 fields over a distance.
DOUBTS = [
    (Doubts(noise_uT=1.0), lambda field2, distance2: 0.0),
    (Doubts(attitude_rad2=0.5), lambda field2, distance2: 0.5 * field2),
    (Doubts(current_sd=0.7), lambda field2, distance2: 0.49 * field2),
    (Doubts(axis_sd_rad=0.7), lambda field2, distance2: 2 * 0.49 * field2),
    (Doubts(gain_sd=0.7), lambda field2, distance2: 0.49 * field2),
    (Doubts(sensor_axis_sd_rad=0.7), lambda field2, distance2: 2 * 0.49 * field2),
    (Doubts(position_m2=0.5), lambda field2, distance2: 0.5 * 16.0 * field2 / distance2),
    (Doubts(position_sd_m=0.7), lambda field2, distance2: 3 * 0.49 * 16.0 * field2 / distance2),
    (Doubts(ambient_uT2=4.0), None),
]


@pytest.mark.parametrize(("doubts", "variance"), DOUBTS)
@pytest.mark.parametrize("beacon", [0, 3])
def test_a_residual_is_compared_with_what_is_known_of_its_errors(core, gold_family, doubts, variance, beacon):
    case = Case(core, gold_family)
    field2 = (case.fields()[:-1] ** 2).sum(axis=1)
    distance2 = ((case.state.p - case.coils.centre) ** 2).sum(axis=1) + case.coils.radius**2
    variances = np.append(variance(field2, distance2) * np.ones(4), 0.0) if variance else np.eye(5)[4] * 4.0
    expected = 3.0 * doubts.noise_uT**2 * 31.0 + case.gram[beacon] ** 2 @ variances
    limit = np.sqrt(MOST * expected)
    assert case.worst(one(4, beacon, 0.997 * limit), doubts) == 4
    assert case.worst(one(4, beacon, 1.003 * limit), doubts) == beacon


def test_the_worst_of_several_is_told_and_those_left_out_are_not(core, gold_family):
    case, noise = Case(core, gold_family), Doubts(noise_uT=1.0)
    sizes = np.sqrt(3.0 * 31.0) * np.array([3.2, 5.0, 4.0, 5.5])
    left = sum(one(4, beacon, size) for beacon, size in enumerate(sizes))
    told = [case.worst(left, noise, out) for out in (0b0, 0b1000, 0b1010, 0b1110, 0b1111)]
    assert told == [3, 1, 2, 0, 4]


def test_the_ambient_fields_residual_accuses_no_beacon(core, gold_family):
    case = Case(core, gold_family)
    assert case.worst(one(4, 4, 1e3), Doubts(noise_uT=1.0)) == 4


@pytest.mark.parametrize(("size", "told"), [(3.0, 1), (3.001, 0)])
def test_as_much_as_may_be_is_not_beyond(core, gold_family, size, told):
    """One chip of noise 1: the square is expected to be 3, and may be 27."""
    case = Case(core, gold_family, beacons=1)
    case.state = State(np.ones(3), np.eye(3), *np.zeros((4, 3)))
    case.kernel = Kernel(core, replace(case.coils, k=np.zeros(1)), 0.02)
    case.kernel.put_state(case.at, case.state)
    assert case.judged(np.full((2, 3), size), Doubts(noise_uT=1.0), chips=1) == told


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_block_that_is_no_number_fits_no_better_than_others(core, gold_family, bad):
    case = Case(core, gold_family)
    assert case.judged(np.full((5, 3), bad), Doubts(noise_uT=1.0), out=0b1000) < 3


def test_a_beacon_that_is_silent_is_found(core, gold_family):
    """Its field is missing in all sums; that of the ambient field is known."""
    case = Case(core, gold_family)
    silent = replace(case.coils, k=case.coils.k * np.array([1.0, 1.0, 0.0, 1.0]))
    fields = still_part(silent, case.state) @ case.state.rotation.T
    assert case.worst(case.gram @ (fields - case.fields()), Doubts(position_m2=1e-6, attitude_rad2=1e-6)) == 2
    assert case.worst(np.zeros((5, 3)), Doubts(position_m2=1e-6, attitude_rad2=1e-6)) == 4
