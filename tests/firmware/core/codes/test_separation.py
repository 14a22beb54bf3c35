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
    field = ffi.new("float[]", (chips @ samples / length).tolist())
    lib.separation_apply(state, samples.mean(), field)
    np.testing.assert_allclose(list(field), expected, atol=2e-5)  # The offset's share of single precision.
    variance = np.diag(np.linalg.inv(columns.T @ columns))[:count]
    np.testing.assert_allclose([lib.separation_variance(state, i) for i in range(count)], variance, rtol=1e-5)


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


def test_no_codes(core):
    ffi, lib = core
    assert lib.separation_init(ffi.new("separation_t *"), 1023, [], [], 0)
