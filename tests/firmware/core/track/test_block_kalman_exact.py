"""One filter of the bank to the last bits of single precision: any rows of docs/blocks.md's form, any turn.

Where test_block_kalman.py has rows of real blocks, which other modules make, these are made up.
"""

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from tests.firmware.core.track import dense
from tests.firmware.core.track.single import Kernel, cube, some_state
from tests.firmware.core.track.test_block_kalman import SD, some_covariance


def differs(ours, truth, scale):
    """The greatest difference over what the numbers are measured by."""
    return np.abs((ours - truth) / scale).max()


def lower(matrix):
    """A covariance from its lower triangle, if the blocks of six on its diagonal are symmetric, as is promised."""
    for k in range(0, len(matrix), 6):
        block = matrix[k : k + 6, k : k + 6]
        assert np.array_equal(block, block.T)
    return np.tril(matrix) + np.tril(matrix, -1).T


class Made:
    """A filter whose covariance is not kept up above the blocks on its diagonal, and rows that are no block's."""

    def __init__(self, core, seed, size, swept):
        rng = np.random.default_rng(seed)
        self.ffi, self.lib = core
        self.kernel = Kernel(core, cube(3), 0.02)
        self.covariance, self.reference = some_covariance(rng), some_state(rng)
        self.state = self.reference.moved(0.5 * SD * rng.normal(size=18))
        self.y = rng.normal(size=12 if swept else 9)
        self.rows = size * rng.normal(size=(len(self.y), 18)) / SD
        set_ = np.zeros((12, 18), dtype=bool)  # All errors, those of the motion, those of the turn, and the sweep's.
        set_[:3], set_[3:6, :12], set_[6:9, 3:12], set_[9:, 3:15] = True, True, True, True
        self.rows[~set_[: len(self.rows)]] = 0.0
        self.measure = self.ffi.addressof(self.kernel.filter.measure)
        self.sweep = self.ffi.new("block_sweep_t *") if swept else self.ffi.NULL
        self.kernel.put_state(self.measure.reference, self.reference)
        given = np.where(set_[: len(self.rows)], self.rows, np.nan)  # What a row is without is not set.
        for k, row in enumerate(np.column_stack([given, self.y]).tolist()):
            (self.measure.rows if k < 9 else self.sweep.rows)[k % 9] = row
        self.filter = self.ffi.addressof(self.kernel.filter.filters[0])
        kept = self.covariance.copy()
        for k in (6, 12):
            kept[:k, k : k + 6] = np.nan
        self.kernel.put(self.filter, self.state, kept, (1.0, 2.0))

    def truth(self):
        """Return what the textbook's update makes of it."""
        return dense.updated(self.state, self.covariance, self.reference, self.y, self.rows)

    def update(self, limit=1e9):
        """Return state, covariance, chi-square and logarithm."""
        logarithm = self.ffi.new("float *", np.nan)
        chi_square = self.lib.block_kalman_update(self.filter, self.measure, self.sweep, limit, logarithm)
        matrix = self.kernel.matrix(self.filter.covariance)
        return self.kernel.state(self.filter.state), matrix, chi_square, logarithm[0]


@pytest.mark.parametrize("swept", [False, True])
@pytest.mark.parametrize("size", [0.03, 0.3, 3.0])
def test_an_update_by_any_rows_is_the_textbooks(core, size, swept):
    for seed in range(3):
        made = Made(core, seed, size, swept)
        state, covariance, chi_square, logarithm = made.truth()
        ours, matrix, chi, log = made.update()
        sd = np.sqrt(np.diag(covariance))
        assert differs(ours.minus(state), 0.0, sd) < 1e-3
        assert differs(lower(matrix), covariance, np.outer(sd, sd)) < 1e-3
        assert chi == pytest.approx(chi_square, rel=1e-4)
        assert log == pytest.approx(logarithm, rel=1e-4)


@pytest.mark.parametrize("swept", [False, True])
def test_a_covariance_below_nothing_counts_as_nothing(core, swept):
    """As rounding may leave one: the pivots are 1, neither less nor none at all."""
    for share in (0.001, 0.003, 0.01):
        made = Made(core, 4, 1.0, swept)
        for row in made.filter.covariance:
            row[0:18] = (-share * np.array(list(row))).tolist()
        state, _, chi_square, logarithm = made.update()
        assert logarithm == 0.0
        assert np.isfinite(chi_square)
        assert np.all(np.isfinite(state.minus(made.state)))


@pytest.mark.parametrize("swept", [False, True])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_no_number_leaves_a_filter_as_it_is(core, bad, swept):
    for row in range(12 if swept else 9):
        made = Made(core, 1, 1.0, swept)
        (made.measure.rows if row < 9 else made.sweep.rows)[row % 9][18] = bad
        before = bytes(made.ffi.buffer(made.filter))
        *_, chi_square, _ = made.update()
        assert not chi_square <= 1e9
        assert bytes(made.ffi.buffer(made.filter)) == before


@pytest.mark.parametrize("swept", [False, True])
def test_a_block_is_taken_whose_chi_square_is_the_limit(core, swept):
    made = Made(core, 2, 1.0, swept)
    *_, limit, _ = made.update()
    for most, taken in ((limit, True), (np.nextafter(np.float32(limit), np.float32(0.0)), False)):
        made = Made(core, 2, 1.0, swept)
        before = bytes(made.ffi.buffer(made.filter))
        assert made.update(float(most))[2] == limit
        assert (bytes(made.ffi.buffer(made.filter)) != before) == taken


@pytest.mark.parametrize("swept", [False, True])
def test_a_block_that_is_refused_tells_all_of_its_likelihood(core, swept):
    """By the first rows it is refused already."""
    made = Made(core, 2, 1.0, swept)
    _, _, chi_square, logarithm = made.truth()
    _, _, chi, log = made.update(limit=1e-3)
    assert chi == pytest.approx(chi_square, rel=1e-4)
    assert log == pytest.approx(logarithm, rel=1e-4)


def moved(covariance, w, agility, seconds):
    """F P F' + Q by docs/blocks.md, which has the turn rate's part of the attitude to first order."""
    f = np.eye(18)
    f[:3, 6:9] = f[3:6, 9:12] = seconds * np.eye(3)
    f[3:6, 3:6] = Rotation.from_rotvec(seconds * w).as_matrix()
    t = abs(seconds)
    q = np.array([[t**3 / 3, seconds * t / 2], [seconds * t / 2, t]])
    walk = np.zeros((18, 18))
    for place, size in ((0, agility[0]), (3, agility[1])):
        for axis in range(place, place + 3):
            walk[np.ix_([axis, axis + 6], [axis, axis + 6])] = size**2 * q
    walk += block_diag(np.zeros((12, 12)), 5.0**2 * t * np.eye(3), 0.02**2 * t * np.eye(3))
    return f @ covariance @ f.T + walk


@pytest.mark.parametrize("seconds", [0.1, -0.07, 0.0])
@pytest.mark.parametrize("known", [0.0, 1e-3, 1.0])
def test_a_prediction_by_turns_of_any_length_from_any_certainty(core, known, seconds):
    rng = np.random.default_rng(9)
    ffi, lib = core
    kernel = Kernel(core, cube(3), 0.02)
    for speed in (0.0, 1.0, 20.0):
        state, covariance, agility = some_state(rng, speed=speed), known**2 * some_covariance(rng), (2.0, 4.0)
        expected = moved(covariance, state.w, agility, seconds)
        sd = np.maximum(np.sqrt(np.diag(expected)), 1e-9)
        filter_ = ffi.addressof(kernel.filter.filters[0])
        kept = covariance.copy()
        for k in (6, 12):
            kept[:k, k : k + 6] = np.nan
        kernel.put(filter_, state, kept, agility)
        ahead, moving = ffi.new("block_state_t *", filter_.state), ffi.new("float[12][12]", kept[:12, :12].tolist())
        lib.block_kalman_predict(filter_, seconds)
        lib.block_kalman_ahead(ahead, moving, 4.0, 16.0, seconds)
        assert differs(lower(kernel.matrix(filter_.covariance)), expected, np.outer(sd, sd)) < 1e-5
        assert differs(lower(kernel.matrix(moving)), expected[:12, :12], np.outer(sd, sd)[:12, :12]) < 1e-5
        later = state.ahead(seconds)
        for result in (filter_.state, ahead):
            assert np.abs(kernel.state(result).minus(later)).max() < 1e-5
