"""Normal equations of three unknowns against NumPy in double precision."""

import numpy as np
import pytest


def problem(seed):
    """A matrix and a right side, of rows with weights, as single precision holds them."""
    rng = np.random.default_rng(seed)
    slopes, weights = rng.normal(size=(8, 3)) * [1.0, 3.0, 0.3], rng.uniform(0.5, 2.0, 8)
    return ((slopes.T * weights) @ slopes).astype(np.float32), (slopes.T @ rng.normal(size=8)).astype(np.float32)


def solved(core, matrix, side):
    ffi, lib = core
    normal, x = ffi.new("normal3_t *"), ffi.new("float[4]", [7.0] * 4)
    normal.matrix, normal.side = matrix.tolist(), side.tolist()
    lib.normal3_solve(normal, x)
    assert [list(row) for row in normal.matrix] == matrix.tolist()
    assert x[3] == 7.0
    return np.array(list(x))[:3]


def inverse_of(core, matrix):
    ffi, lib = core
    inverse = ffi.new("float[3][3]", [[7.0] * 3] * 3)
    lib.normal3_invert(matrix.tolist(), inverse)
    return np.array([list(row) for row in inverse])


@pytest.mark.parametrize("seed", range(5))
def test_solution_and_covariance(core, seed):
    matrix, side = problem(seed)
    expected = np.linalg.inv(matrix.astype(float))
    assert inverse_of(core, matrix) == pytest.approx(expected, abs=1e-4 * np.abs(expected).max())
    x = np.linalg.solve(matrix.astype(float), side.astype(float))
    assert solved(core, matrix, side) == pytest.approx(x, abs=1e-4 * np.abs(x).max())


@pytest.mark.parametrize("hidden", [0, 1, 2])
def test_what_no_row_tells_stays_where_it_is_with_a_huge_variance(core, hidden):
    matrix, side = problem(6)
    matrix[hidden], matrix[:, hidden], side[hidden] = 0.0, 0.0, 0.0
    told = [i for i in range(3) if i != hidden]
    part = np.linalg.inv(matrix[np.ix_(told, told)].astype(float))
    inverse, x = inverse_of(core, matrix), solved(core, matrix, side)
    assert inverse[np.ix_(told, told)] == pytest.approx(part, rel=1e-4)
    assert inverse[hidden, hidden] == pytest.approx(1e20)
    assert list(inverse[hidden, told]) == [0.0, 0.0]
    assert x[told] == pytest.approx(part @ side[told], rel=1e-3)
    assert x[hidden] == 0.0


@pytest.mark.parametrize(("diagonal", "variance"), [(0.95e-20, 1e20), (1.05e-20, 1.0 / 1.05e-20)])
def test_no_variance_is_above_1e20(core, diagonal, variance):
    """Neither is what other unknowns are told through one that is told so little."""
    inverse = inverse_of(core, np.diag([2.0, diagonal, 4.0]))
    assert inverse.diagonal() == pytest.approx([0.5, variance, 0.25], rel=1e-4)
    coupled = np.array([[diagonal, 1e-20, 0.0], [1e-20, 3e-20, 0.0], [0.0, 0.0, 1.0]])
    left = 3e-20 - 1e-20 * min(1e20, 1.0 / diagonal) * 1e-20
    assert inverse_of(core, coupled)[1, 1] == pytest.approx(1.0 / left, rel=1e-4)
