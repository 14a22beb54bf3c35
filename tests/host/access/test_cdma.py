"""Gold codes and their exact separation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goldfield.access import Separator, code_matrix, plain_correlation, sequence
from goldfield.access.gold import PREFERRED_PAIRS
from goldfield.errors import UserError
from tests.host.fake_sensor import CHIPS, CODES

# IS-GPS-200, table 3-I: code delay chips of G2 and the first ten chips in octal; PRN with delay d is our k = 1023 - d.
GPS = [
    (5, "1440"),
    (6, "1620"),
    (7, "1710"),
    (8, "1744"),
    (17, "1133"),
    (18, "1455"),
    (139, "1131"),
    (140, "1454"),
    (141, "1626"),
    (251, "1504"),
]
HALF_GAUSS_T = 0.5e-4


@pytest.mark.parametrize(("delay", "octal"), GPS)
def test_first_ten_chips_of_gps(delay, octal):
    bits = (1 - code_matrix(10, [1023 - delay])[:10, 0].astype(int)) // 2
    assert f"{int(''.join(map(str, bits)), 2):04o}" == octal


def test_against_shift_registers_stage_by_stage():
    np.testing.assert_array_equal(code_matrix(10, CODES), CHIPS)


@pytest.mark.parametrize("degree", PREFERRED_PAIRS)
def test_preferred_pairs(degree):
    """m-sequences have two-valued, preferred pairs three-valued correlations (Gold 1967)."""
    u, v = (1 - 2 * sequence(degree, which).astype(int) for which in (0, 1))
    length = 2**degree - 1
    threshold = 1 + 2 ** ((degree + 2) // 2)
    for one in (u, v):
        assert {int(one @ np.roll(one, k)) for k in range(1, length)} == {-1}
    assert {int(u @ np.roll(v, k)) for k in range(length)} == {-threshold, -1, threshold - 2}


def test_sums_of_the_family():
    """The census of maths.md, 1."""
    values, counts = np.unique(code_matrix(10, range(1025)).sum(axis=0, dtype=int), return_counts=True)
    assert dict(zip(values.tolist(), counts.tolist(), strict=True)) == {-1: 769, 63: 136, -65: 120}


def test_code_beyond_the_family():
    with pytest.raises(ValueError, match="0 to 1024"):
        code_matrix(10, [1025])


@pytest.mark.parametrize("count", [1, 8, 64, 256, 1000])
def test_exact_without_noise(count):
    """The issue's bound: 1e-9 of the strongest field, with an offset of half a gauss, codes balanced and not."""
    rng = np.random.default_rng(count)
    codes = rng.choice(1023, size=count, replace=False)
    fields = rng.uniform(-1.0, 1.0, size=(count, 3)) * np.logspace(0.0, -4.0, count)[:, None] * 1.2e-6
    offset = HALF_GAUSS_T * np.array([1.0, -1.0, 0.6])
    samples = code_matrix(10, codes) @ fields + offset
    separator = Separator(10, codes, noise_T=2e-7)
    strongest = np.abs(fields).max()
    by_samples = separator.from_samples(samples)
    assert np.abs(by_samples.field_T - fields).max() < 1e-9 * strongest
    np.testing.assert_allclose(by_samples.offset_T, offset, rtol=1e-12)
    sums = code_matrix(10, codes).T @ samples / 1023
    by_sums = separator.from_correlations(sums, samples.mean(axis=0), np.zeros(count))
    assert np.abs(by_sums.field_T - fields).max() < 1e-9 * strongest
    np.testing.assert_allclose(by_sums.offset_T, offset, rtol=1e-12)


@pytest.mark.parametrize("degree", PREFERRED_PAIRS)
def test_exact_at_every_degree_with_u_and_v(degree):
    length = 2**degree - 1
    codes = [0, 3, 7, length, length + 1]
    fields = np.arange(15.0).reshape(5, 3) * 1e-7 - 4e-7
    separation = Separator(degree, codes, 1e-9).from_samples(code_matrix(degree, codes) @ fields + HALF_GAUSS_T)
    np.testing.assert_allclose(separation.field_T, fields, atol=1e-16)


def test_the_patents_example():
    """US 6,691,074: 12, 6 and 1 are estimated as 11.99, 5.99 and 0.98 by plain correlation; exact here."""
    codes = [2, 3, 4]
    samples = (code_matrix(10, codes) @ [12.0, 6.0, 1.0] + 500.0)[:, None] * np.ones(3) * 1e-7
    plain = plain_correlation(samples, 10, codes)[:, 0] * 1e7
    assert np.round(plain, 2).tolist() == [11.99, 5.99, 0.98]
    exact = Separator(10, codes, 1e-9).from_samples(samples).field_T[:, 0] * 1e7
    np.testing.assert_allclose(exact, [12.0, 6.0, 1.0], rtol=1e-9)


@pytest.mark.parametrize(("degree", "codes"), [(10, range(1025)), (5, range(33)), (5, range(32)), (10, [4, 4])])
def test_dependent_codes_are_refused(degree, codes):
    with pytest.raises(UserError, match="cannot be separated"):
        Separator(degree, codes, 1e-9)


def test_all_codes_have_the_rank_of_maths():
    """maths.md, 1: 1023 of 1026 with the offset, so 1022 of 1025 fields."""
    with pytest.raises(UserError, match=r"1025 codes .* only 1022 .* leave out 3 "):
        Separator(10, range(1025), 1e-9)


def test_sigma_is_what_noise_makes():
    """In two hundred cycles of noise the spread of the estimates equals sigma within 5 % (rms over 1200 numbers)."""
    rng = np.random.default_rng(5)
    codes = [2, 9, 1023, 1024, 500, 640]
    separator = Separator(10, codes, noise_T=2e-7)
    normalised = []
    for _ in range(200):
        separation = separator.from_samples(rng.normal(scale=2e-7, size=(1023, 3)))
        normalised.append(separation.field_T / separation.sigma_T[:, None])
    assert np.sqrt(np.mean(np.square(normalised))) == pytest.approx(1.0, abs=0.05)


@settings(max_examples=25)
@given(st.sets(st.integers(0, 1022), max_size=900), st.integers(0, 2))
def test_missing_samples_cost_only_what_they_hold(missing, axis):
    codes = [2, 3, 4, 5]
    fields = np.arange(12.0).reshape(4, 3) * 1e-7
    samples = code_matrix(10, codes) @ fields + HALF_GAUSS_T
    samples[list(missing), axis] = np.nan
    separation = Separator(10, codes, 2e-7).from_samples(samples)
    np.testing.assert_allclose(separation.field_T, fields, atol=1e-15)
    floor = 2e-7 / np.sqrt(1023 - len(missing))
    assert (separation.sigma_T >= 0.999 * floor).all()


def test_an_axis_that_was_not_measured():
    codes = [2, 3]
    samples = code_matrix(10, codes) @ np.ones((2, 3)) * 1e-7
    samples[:, 1] = np.nan
    separation = Separator(10, codes, 2e-7).from_samples(samples)
    assert np.isnan(separation.field_T).tolist() == [[False, True, False]] * 2
    assert np.isfinite(separation.sigma_T).all()
    samples[:] = np.nan
    nothing = Separator(10, codes, 2e-7).from_samples(samples)
    assert np.isnan(nothing.field_T).all()
    assert np.isinf(nothing.sigma_T).all()


def test_a_missing_correlation_widens_the_others_by_its_leak():
    codes = [2, 3, 4]
    fields = np.array([[5e-6, 0, 0], [1e-6, 0, 0], [2e-6, 0, 0.0]])
    samples = code_matrix(10, codes) @ fields + HALF_GAUSS_T
    sums = code_matrix(10, codes).T @ samples / 1023
    sums[0] = np.nan
    separation = Separator(10, codes, 1e-12).from_correlations(sums, samples.mean(axis=0), np.array([5e-6, 0.0, 0.0]))
    assert np.isnan(separation.field_T[0]).all()
    error = np.abs(separation.field_T[1:, 0] - fields[1:, 0])
    np.testing.assert_allclose(error, separation.sigma_T[1:], rtol=1e-3)
    assert error[0] == pytest.approx(5e-6 / 1023, rel=0.01)
