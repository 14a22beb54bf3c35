"""Unknowns with a prior that are eliminated, against the normal equations of all unknowns in double precision."""

import numpy as np
import pytest


def eliminated(core, effects, rows):
    """(N, X, the rows that are left) after folding in effects, shape (3m, 6), and rows, shape (3m, 7)."""
    ffi, lib = core
    nuisance = ffi.new("nuisance_t *")
    ffi.memmove(nuisance, b"\x7f" * ffi.sizeof("nuisance_t"), ffi.sizeof("nuisance_t"))
    lib.nuisance_init(nuisance)
    left = []
    for first in range(0, len(rows), 3):
        s = ffi.new("float[3][6]", effects[first : first + 3].tolist())
        a = ffi.new("float[3][7]", rows[first : first + 3].tolist())
        lib.nuisance_eliminate(nuisance, s, a)
        left += [list(row) for row in a]
    n, x = (np.array([list(row) for row in m]) for m in (nuisance.n, nuisance.x))
    return nuisance, n, x, np.array(left)


def blocks(seed, scale):
    """Effects and rows; the third effect is none, the fifth one acts on the last rows alone."""
    rng = np.random.default_rng(seed)
    effects, rows = scale * rng.normal(size=(12, 6)), rng.normal(size=(12, 7)) * rng.uniform(0.3, 3.0, 7)
    effects[:, 2], effects[:9, 4] = 0.0, 0.0
    return effects, rows


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_what_is_left_is_the_problem_without_the_nuisance(core, scale):
    """N'N = 1 + S'S and N'X = S'A; what is left of A has the normal matrix A'A - A'S (1 + S'S)^-1 S'A."""
    effects, rows = blocks(1, scale)
    _, n, x, left = eliminated(core, effects, rows)
    information = np.eye(6) + effects.T @ effects
    assert np.array_equal(n, np.triu(n))
    assert n.T @ n == pytest.approx(information, abs=2e-6 * information.max())
    cross = effects.T @ rows
    assert n.T @ x == pytest.approx(cross, abs=2e-6 * np.abs(cross).max() + 2e-6 * information.max())
    expected = rows.T @ rows - cross.T @ np.linalg.solve(information, cross)
    assert left.T @ left == pytest.approx(expected, abs=3e-6 * (rows.T @ rows).max())


@pytest.mark.parametrize("scale", [0.1, 1.0, 10.0])
def test_rows_without_what_the_nuisance_explains_of_them(core, scale):
    """A - S N^-1 X = A - S (1 + S'S)^-1 S'A, and S N^-1, whose products are S (1 + S'S)^-1 S'."""
    ffi, lib = core
    effects, rows = blocks(2, scale)
    nuisance, *_ = eliminated(core, effects, rows)
    s, a = ffi.new("float[3][6]", effects[9:].tolist()), ffi.new("float[3][7]", rows[9:].tolist())
    lib.nuisance_predict(nuisance, s, a)
    information = np.eye(6) + effects.T @ effects
    expected = rows[9:] - effects[9:] @ np.linalg.solve(information, effects.T @ rows)
    assert np.array([list(row) for row in a]) == pytest.approx(expected, abs=3e-5)
    over = np.array([list(row) for row in s])
    explained = effects[9:] @ np.linalg.solve(information, effects[9:].T)
    assert over @ over.T == pytest.approx(explained, abs=1e-5)
    whole = np.linalg.inv(np.linalg.cholesky(information)) @ effects[9:].T
    assert np.abs(over) == pytest.approx(np.abs(whole.T), abs=1e-5)
