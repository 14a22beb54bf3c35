"""Least squares in square-root form against NumPy in double precision."""

import numpy as np
import pytest


@pytest.mark.parametrize("condition", [1.0, 1e2, 1e4])
def test_least_squares_of_ill_conditioned_rows(core, condition):
    """The truth is in double precision; the last case's normal matrix, of condition 1e8, is lost in single."""
    ffi, lib = core
    rng = np.random.default_rng(2)
    u, _, vt = np.linalg.svd(rng.normal(size=(24, 6)), full_matrices=False)
    rows = (u * np.geomspace(1.0, 1.0 / condition, 6)) @ vt
    rows = rows.astype(np.float32).astype(float)
    truth = rng.normal(size=6)
    right = (rows @ truth).astype(np.float32)
    triangle = ffi.new("triangle_t *")
    lib.triangle_init(triangle)
    for block in range(0, 24, 3):
        table = np.column_stack([rows[block : block + 3], right[block : block + 3]])
        lib.triangle_add(triangle, table.tolist())
    step, inverse = ffi.new("float[6]"), ffi.new("float[6][6]")
    lib.triangle_solve(triangle, 0.0, step)
    np.testing.assert_allclose(list(step), truth, atol=2e-6 * condition)
    assert lib.triangle_invert(triangle, inverse)
    root = np.array([list(row) for row in inverse])
    expected = np.linalg.inv(rows.T @ rows)
    np.testing.assert_allclose(np.diag(root @ root.T), np.diag(expected), rtol=1e-5 * condition)
    damping = 0.3
    lib.triangle_solve(triangle, damping, step)
    normal = rows.T @ rows
    damped = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), rows.T @ right)
    np.testing.assert_allclose(list(step), damped, atol=1e-4)


def test_an_unknown_that_no_row_tells(core):
    ffi, lib = core
    rng = np.random.default_rng(3)
    triangle = ffi.new("triangle_t *")
    lib.triangle_init(triangle)
    for _ in range(4):
        rows = rng.normal(size=(3, 7))
        rows[:, 4] = 0.0
        lib.triangle_add(triangle, rows.tolist())
    step = ffi.new("float[6]")
    lib.triangle_solve(triangle, 1e-3, step)
    assert np.isfinite(list(step)).all()
    assert step[4] == 0.0
    assert not lib.triangle_invert(triangle, ffi.new("float[6][6]"))


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_rows_of_any_scale(core, scale, damping):
    """The triangle has the normal matrix of the rows, and stays as it is when it is solved."""
    ffi, lib = core
    rng = np.random.default_rng(4)
    rows = (scale * rng.normal(size=(12, 7)) * rng.uniform(0.3, 3.0, 7)).astype(np.float32).astype(float)
    triangle, step = ffi.new("triangle_t *"), ffi.new("float[7]", [7.0] * 7)
    ffi.memmove(triangle, b"\x7f" * ffi.sizeof("triangle_t"), ffi.sizeof("triangle_t"))
    lib.triangle_init(triangle)
    for block in range(0, 12, 3):
        lib.triangle_add(triangle, rows[block : block + 3].tolist())
    r = np.array([list(row) for row in triangle.r])
    normal = rows.T @ rows
    assert np.array_equal(r, np.triu(r))
    assert (r.T @ r)[:6] == pytest.approx(normal[:6], abs=2e-6 * np.abs(normal).max())
    lib.triangle_solve(triangle, damping, step)
    expected = np.linalg.solve(normal[:6, :6] + damping * np.diag(normal.diagonal()[:6]), normal[:6, 6])
    assert list(step)[:6] == pytest.approx(expected, abs=2e-5 * np.abs(expected).max())
    assert step[6] == 7.0
    assert np.array_equal([list(row) for row in triangle.r], r)
    inverse = ffi.new("float[6][6]", [[7.0] * 6] * 6)
    assert lib.triangle_invert(triangle, inverse)
    assert np.array([list(row) for row in inverse]) == pytest.approx(
        np.linalg.inv(r[:, :6]), rel=1e-4, abs=1e-6 / scale
    )


@pytest.mark.parametrize(("share", "told"), [(0.95e-6, False), (1.05e-6, True)])
@pytest.mark.parametrize("column", [1, 5])
def test_an_unknown_with_a_millionth_of_its_column_left_is_told(core, column, share, told):
    """The rest of it is what the unknowns before have in common with it; of the whole nothing must be in the way."""
    ffi, lib = core
    triangle = ffi.new("triangle_t *")
    for row in range(6):
        triangle.r[row][row] = 2.0
    triangle.r[0][column], triangle.r[column][column] = 3.0, 3.0 * share
    assert lib.triangle_invert(triangle, ffi.new("float[6][6]")) == told


@pytest.mark.parametrize("scale", [1e-14, 1e-15, 1e-16, 1e-17, 1e-18, 1e-19, 1e-20, 1e-22, 1e-24, 1e-40])
def test_an_unknown_of_which_rows_tell_next_to_nothing(core, scale):
    """Where squares of its column underflow nothing becomes infinite: it was, from 1e-15 on, by what rounding left."""
    ffi, lib = core
    rng = np.random.default_rng(6)
    triangle, step = ffi.new("triangle_t *"), ffi.new("float[6]")
    lib.triangle_init(triangle)
    rows = rng.normal(size=(12, 7))
    rows[:, 4] *= scale
    for block in range(0, 12, 3):
        lib.triangle_add(triangle, rows[block : block + 3].tolist())
    assert np.isfinite([list(row) for row in triangle.r]).all()
    lib.triangle_solve(triangle, 1e-3, step)
    assert np.isfinite(list(step)).all()
    if scale > 1e-15 or scale < 1e-19:
        others = [0, 1, 2, 3, 5]
        kept = rows[:, [*others, 4]] / [1, 1, 1, 1, 1, scale] if scale > 1e-15 else rows[:, others]
        normal = kept.T @ kept
        expected = np.linalg.solve(normal + 1e-3 * np.diag(normal.diagonal()), kept.T @ rows[:, 6])
        assert [step[i] for i in others] == pytest.approx(expected[:5], abs=1e-4)
