"""One filter of the bank in single precision against the dense calculation in double precision."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tests.firmware.core.track import dense
from tests.firmware.core.track.single import Bits, Kernel, cube, some_state

SD = np.repeat([0.005, 0.01, 0.3, 0.5, 2.0, 2.0], 3)
"""Standard deviations of the errors before a block."""


def some_covariance(rng):
    """A covariance with correlations of all errors."""
    q = rng.normal(size=(18, 18))
    return np.outer(SD, SD) * (0.5 * q @ q.T / 18 + 0.5 * np.eye(18))


def relative(covariance, truth):
    """The greatest difference of two covariances, in standard deviations of both errors."""
    sd = np.sqrt(np.diag(truth))
    return np.abs((covariance - truth) / np.outer(sd, sd)).max()


class Case:
    """A filter that is not the reference, and a block; both versions of the update, with the sweep if swept."""

    def __init__(self, core, gold_family, beacons, seed, noise=0.02, speed=1.0, swept=False):
        rng = np.random.default_rng(seed)
        self.coils, chip = cube(beacons), int(rng.integers(1023))
        bits, self.kernel = Bits(gold_family(10), beacons), Kernel(core, self.coils, noise)
        gram, moment = dense.products(bits.columns(chip))
        self.reference = some_state(rng, speed=speed)
        self.covariance = some_covariance(rng)
        factor = np.linalg.cholesky(self.covariance)
        self.state = self.reference.moved(0.3 * factor @ rng.normal(size=18))
        truth = self.reference.moved(factor @ rng.normal(size=18))
        values, vectors = np.linalg.eigh(gram)
        scatter = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * rng.normal(0.0, noise, (len(gram), 3)))
        self.data = dense.sums(self.coils, truth, gram, moment) + scatter
        self.gram, self.moment, self.noise, self.swept = gram, moment, noise, swept
        self.kernel.fill(bits.words(chip), self.data)

    def dense(self):
        y, rows = dense.measured(self.coils, self.reference, self.gram, self.moment, self.data, self.noise)
        y, rows = (y, rows) if self.swept else (y[:9], rows[:9])
        return dense.updated(self.state, self.covariance, self.reference, y, rows)

    def single(self, limit=1e9):
        """State, covariance, chi-square, logarithm, whether it was taken."""
        kernel, ffi = self.kernel, self.kernel.ffi
        measure, filter_ = ffi.addressof(kernel.filter.measure), ffi.addressof(kernel.filter.filters[0])
        kernel.put_state(measure.reference, self.reference)
        kernel.lib.block_measure(kernel.block, kernel.coils, measure)
        sweep = ffi.new("block_sweep_t *") if self.swept else ffi.NULL
        measure.rank += kernel.lib.block_sweep(kernel.block, measure, sweep) if self.swept else 0
        kernel.put(filter_, self.state, self.covariance, (1.0, 2.0))
        logarithm = ffi.new("float *")
        chi_square = kernel.lib.block_kalman_update(filter_, measure, sweep, limit, logarithm)
        return kernel.state(filter_.state), kernel.covariance(filter_), chi_square, logarithm[0], chi_square <= limit


@pytest.mark.parametrize("beacons", [3, 4, 8, 16, 29])
@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_an_update_is_that_of_the_whitened_rows(core, gold_family, beacons, speed):
    for seed in range(4):
        case = Case(core, gold_family, beacons, seed, speed=speed)
        state, covariance, chi_square, logarithm = case.dense()
        ours = case.single()
        assert ours[4]
        assert np.abs(ours[0].minus(state) / np.sqrt(np.diag(covariance))).max() < 0.03
        assert relative(ours[1], covariance) < 0.03
        assert ours[2] == pytest.approx(chi_square, rel=0.01, abs=0.05)
        assert ours[3] == pytest.approx(logarithm, abs=0.02)
        assert case.kernel.filter.measure.rank == 9


@pytest.mark.parametrize(("beacons", "allowed"), [(3, 4.0), (4, 1.0), (8, 1.0), (16, 1.0), (29, 4.0)])
@pytest.mark.parametrize("speed", [0.0, 3.0])
def test_an_update_by_the_sweep_is_that_of_the_whitened_rows(core, gold_family, beacons, speed, allowed):
    """Few or very many beacons tell of the sweep little that single precision does not see, and that is left out."""
    for seed in range(4):
        case = Case(core, gold_family, beacons, seed, speed=speed, swept=True)
        state, covariance, chi_square, logarithm = case.dense()
        ours = case.single()
        assert ours[4]
        assert np.abs(ours[0].minus(state) / np.sqrt(np.diag(covariance))).max() < 0.03 * allowed
        assert relative(ours[1], covariance) < 0.03 * allowed
        assert ours[2] == pytest.approx(chi_square, rel=0.01 * allowed, abs=0.05 * allowed)
        assert ours[3] == pytest.approx(logarithm, abs=0.02 * allowed)
        assert (9 if beacons == 3 else 12) <= case.kernel.filter.measure.rank <= 12


@pytest.mark.parametrize("swept", [False, True])
def test_more_columns_than_chips(core, gold_family, swept):
    """32 beacons and 31 chips: the gram matrix is singular. The truth has 28 of them, and so less information."""
    case, fewer = (Case(core, gold_family, n, 3, swept=swept) for n in (32, 28))
    ours, truth = case.single(), fewer.dense()
    assert ours[4]
    assert np.linalg.eigvalsh(ours[1]).min() > 0.0
    ratio = np.sqrt(np.diag(ours[1])[:6] / np.diag(truth[1])[:6])
    assert np.all(ratio < 1.2)
    assert np.all(ratio > 0.6)


def test_one_beacon_and_two_tell_what_they_can(core, gold_family):
    """Three numbers, and six of which one is weak, and the ambient field: the rest stays as uncertain as it was."""
    for beacons, most in ((1, 6), (2, 9)):
        for seed in range(5):
            case = Case(core, gold_family, beacons, seed)
            _, covariance, chi_square, _ = case.dense()
            ours = case.single()
            assert 3 < case.kernel.filter.measure.rank <= most
            assert ours[4]
            before, after = np.diag(case.covariance), np.diag(ours[1])
            assert np.all(after > 0.0)
            assert np.all(after <= before * 1.000001)
            assert np.all(after > 0.9 * np.diag(covariance))
            assert ours[2] < chi2.isf(1e-6, most)
            assert chi_square < chi2.isf(1e-6, 9)


@pytest.mark.parametrize("swept", [False, True])
def test_the_gate_has_two_sides(core, gold_family, swept):
    case = Case(core, gold_family, 8, 2, swept=swept)
    *_, chi_square, _, _ = case.single()
    state, covariance, *_, taken = case.single(limit=1.001 * chi_square)
    assert taken
    assert np.linalg.norm(state.minus(case.state) / SD) > 0.1
    state, covariance, *_, taken = case.single(limit=0.999 * chi_square)
    assert not taken
    np.testing.assert_allclose(covariance, np.float32(case.covariance), rtol=0, atol=0)
    assert np.abs(state.minus(case.state) / SD).max() < 1e-3


@pytest.mark.parametrize("seconds", [0.00303, 0.1, -0.01])
def test_a_prediction_is_that_of_numerical_derivatives(core, gold_family, seconds):
    rng = np.random.default_rng(7)
    kernel = Kernel(core, cube(3), 0.02)
    for _ in range(5):
        state, covariance, agility = some_state(rng), some_covariance(rng), (2.0, 4.0)
        later, expected = dense.predicted(state, covariance, agility, seconds)
        filter_ = kernel.ffi.addressof(kernel.filter.filters[0])
        kernel.put(filter_, state, covariance, agility)
        ahead = kernel.ffi.new("block_state_t *", filter_.state)
        moving = kernel.ffi.new("float[12][12]", covariance[:12, :12].tolist())
        kernel.lib.block_kalman_ahead(ahead, moving, 4.0, 16.0, seconds)
        kernel.lib.block_kalman_predict(filter_, seconds)
        ours = kernel.covariance(filter_)
        # The turn rate's part of the attitude is taken to first order: half of the angle is left out.
        turn = 0.5 * abs(seconds) * np.linalg.norm(state.w)
        assert relative(ours, expected) < 1e-5 + turn
        np.testing.assert_allclose(np.tril(kernel.matrix(moving)), np.tril(ours[:12, :12]), rtol=1e-5, atol=1e-9)
        for result in (filter_.state, ahead):
            assert np.abs(kernel.state(result).minus(later) / SD).max() < 1e-3


def test_turns_of_any_length(core):
    ffi, lib = core
    quaternion = ffi.new("float[4]")
    for size in (0.0, 1e-5, 0.01, 1.0, 1.999, 2.001, 3.1, 20.0):
        for seed in range(4):
            axis = np.random.default_rng(seed).normal(size=3)
            vector = size * axis / np.linalg.norm(axis)
            lib.quaternion_exp(vector.tolist(), quaternion)
            difference = Rotation.from_quat(list(quaternion)) * Rotation.from_rotvec(vector).inv()
            assert difference.magnitude() < 1e-6 * (1.0 + size)
            assert np.linalg.norm(list(quaternion)) == pytest.approx(1.0, abs=3e-7)
