"""The closed form of the exact separation, against least squares in double precision."""

import numpy as np
import pytest

N = 1023


def prepared(core, gold_family, codes):
    ffi, lib = core
    sums = gold_family(10)[codes].sum(axis=1)
    state = ffi.new("separation_t *")
    good = lib.separation_init(state, codes, sums.tolist(), len(codes))
    return state, good


@pytest.mark.parametrize("count", [1, 3, 8, 64])
def test_fields_and_noise_as_least_squares(core, gold_family, count):
    """Any codes but v: balanced, unbalanced, and u."""
    ffi, lib = core
    rng = np.random.default_rng(count)
    codes = [1023, *rng.choice(1023, 63, replace=False).tolist()][:count]
    state, good = prepared(core, gold_family, codes)
    assert good
    chips = gold_family(10)[codes].astype(float)
    truth, offset = rng.normal(size=count) * 10.0 ** rng.uniform(-3, 0, count), 50.0
    samples = truth @ chips + offset + rng.normal(0, 0.1, N)
    columns = np.vstack([chips, np.ones(N)]).T
    expected = np.linalg.lstsq(columns, samples, rcond=None)[0][:count]
    field = ffi.new("float[]", (chips @ samples / N).tolist())
    lib.separation_apply(state, samples.mean(), field)
    np.testing.assert_allclose(list(field), expected, atol=2e-5)  # The offset's share of single precision.
    variance = np.diag(np.linalg.inv(columns.T @ columns))[:count]
    np.testing.assert_allclose([lib.separation_variance(state, i) for i in range(count)], variance, rtol=1e-5)


@pytest.mark.parametrize("codes", [[2, 1024], [5, 6, 5], list(range(65))])
def test_codes_that_the_closed_form_cannot_separate_are_refused(core, gold_family, codes):
    state, good = prepared(core, gold_family, codes)
    assert not good
    assert state.count == 0


def test_no_codes(core):
    ffi, lib = core
    assert lib.separation_init(ffi.new("separation_t *"), [], [], 0)
