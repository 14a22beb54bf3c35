"""The closed form of the exact separation, against least squares in double precision."""

import numpy as np
import pytest


def prepared(core, gold_family, codes, degree=10):
    ffi, lib = core
    sums = gold_family(degree)[codes].sum(axis=1)
    state = ffi.new("separation_t *")
    good = lib.separation_init(state, 2**degree - 1, codes, sums.tolist(), len(codes))
    return state, good


@pytest.mark.parametrize(
    ("degree", "count"), [(10, 1), (10, 3), (10, 8), (10, 64), (5, 1), (5, 25), (6, 8), (7, 64), (9, 8), (11, 64)]
)
def test_fields_and_noise_as_least_squares(core, gold_family, degree, count):
    """Any codes but v: balanced, unbalanced, and u."""
    ffi, lib = core
    rng, length = np.random.default_rng(count), 2**degree - 1
    codes = [length, *rng.choice(length, count - 1, replace=False).tolist()]
    state, good = prepared(core, gold_family, codes, degree)
    assert good
    chips = gold_family(degree)[codes].astype(float)
    truth, offset = rng.normal(size=count) * 10.0 ** rng.uniform(-3, 0, count), 50.0
    samples = truth @ chips + offset + rng.normal(0, 0.1, length)
    columns = np.vstack([chips, np.ones(length)]).T
    expected = np.linalg.lstsq(columns, samples, rcond=None)[0][:count]
    field = ffi.new("float[]", [*(chips @ samples / length).tolist(), 7.0])
    lib.separation_apply(state, samples.mean(), field)
    np.testing.assert_allclose(list(field)[:count], expected, atol=2e-5)  # The offset's share of single precision.
    assert field[count] == 7.0, "what lies behind the list is not its"
    variance = np.diag(np.linalg.inv(columns.T @ columns))[:count]
    np.testing.assert_allclose([lib.separation_variance(state, i) for i in range(count)], variance, rtol=1e-5)


NARROW = [(5, (5, 15, 10), 30), (6, (5, 47, 10), 62), (5, (6, 16, 8), 29), (6, (6, 48, 8), 61)]
"""Degrees, and how many codes of each sum, from the least sum on, of lists with as many columns as chips or one less.
The last two lack one rank, however few the columns are."""


@pytest.mark.parametrize(("degree", "counts", "rank"), NARROW)
def test_every_list_that_can_be_separated_is(core, gold_family, degree, counts, rank):
    """Down to those of which the normal equations just have a solution: by the rank of the columns themselves."""
    ffi, lib = core
    family, length = gold_family(degree)[:-1], 2**degree - 1
    sums = family.sum(axis=1)
    codes = [
        int(code)
        for total, n in zip(np.unique(sums), counts, strict=True)
        for code in np.flatnonzero(sums == total)[:n]
    ]
    columns = np.vstack([family[codes], np.ones((1, length))]).T
    separable = np.linalg.matrix_rank(columns) == len(codes) + 1
    assert np.linalg.matrix_rank(columns) == rank + 1
    state, good = prepared(core, gold_family, codes, degree)
    assert good == separable
    assert state.count == (len(codes) if separable else 0)
    if separable:
        truth = np.random.default_rng(degree).normal(size=len(codes))
        samples = truth @ family[codes] + 0.5
        field = ffi.new("float[]", (family[codes] @ samples / length).tolist())
        lib.separation_apply(state, samples.mean(), field)
        np.testing.assert_allclose(list(field), truth, atol=2e-6)
        variance = np.diag(np.linalg.inv(columns.T @ columns))[: len(codes)]
        np.testing.assert_allclose([lib.separation_variance(state, i) for i in range(len(codes))], variance, rtol=1e-5)


@pytest.mark.parametrize(
    ("degree", "codes"),
    [
        (10, [2, 1024]),
        (10, [5, 6, 5]),
        (10, list(range(65))),
        (7, [2, 128]),
        (5, list(range(31))),
        (5, list(range(32))),
    ],
)
def test_codes_that_the_closed_form_cannot_separate_are_refused(core, gold_family, degree, codes):
    """Among them more than fit: the 31 shifts of degree 5 and a constant are 32 columns in 31 chips."""
    state, good = prepared(core, gold_family, codes, degree)
    assert not good
    assert state.count == 0


def test_no_codes(core, gold_family):
    _, lib = core
    state, good = prepared(core, gold_family, [3, 4])
    assert (good, state.count) == (True, 2)
    assert lib.separation_init(state, 1023, [], [], 0)
    assert state.count == 0


def test_a_list_that_is_refused_leaves_none(core, gold_family):
    _, lib = core
    state, good = prepared(core, gold_family, [3, 4])
    assert (good, state.count) == (True, 2)
    assert not lib.separation_init(state, 1023, [3, 1024], [-1, -1], 2)
    assert state.count == 0
