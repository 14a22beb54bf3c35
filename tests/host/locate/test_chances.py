"""The distributions of location against SciPy's."""

import numpy as np
import pytest
from scipy import special, stats

from goldfield.locate import chances
from goldfield.locate.chances import MANY, chdtri, gammaincc, ndtri, probability

FREEDOM = np.array([1, 2, 3, 4, 5, 6, 7, 12, 15, 24, 50, 99, 192, 400, 897])[:, None]


def test_the_tail_of_chi_square():
    half = np.concatenate([np.logspace(-6.0, 3.3, 60), [0.0, np.inf]])
    expected = special.gammaincc(FREEDOM / 2.0, half)
    found = np.stack([gammaincc(shape, half) for shape in FREEDOM / 2.0])
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-290)
    assert np.isnan(gammaincc(1.5, np.nan))
    assert len(half) < MANY <= found.size
    assert gammaincc(FREEDOM / 2.0, half).tolist() == expected.tolist()


def test_quantiles_of_chi_square():
    rates = np.concatenate([np.logspace(-15.0, -0.05, 80), [0.0, 1.0]])
    np.testing.assert_allclose(chdtri(FREEDOM, rates), special.chdtri(FREEDOM * 1.0, rates), rtol=1e-12)
    near_1 = 1.0 - np.logspace(-9.0, -2.0, 8)  # as exact as the chance itself, which is a double near 1
    below = np.broadcast_to(1.0 - near_1, (len(FREEDOM), 8))
    np.testing.assert_allclose(special.chdtr(FREEDOM * 1.0, chdtri(FREEDOM, near_1)), below, rtol=0, atol=1e-12)
    assert np.isnan(chdtri(3, [np.nan, -0.01, 1.01])).all()


@pytest.mark.parametrize("rate", [1e-300, 1e-150, 1e-15, 1e-5, 0.01, 0.3, 0.9])
def test_a_quantile_takes_about_a_dozen_steps(monkeypatch, rate):
    """Also of rates so low that the first steps lead to where the tail is less than any number."""
    tail, asked, steps = chances._tail, [], []
    monkeypatch.setattr(chances, "_tail", lambda *given: asked.append(given) or tail(*given))
    for freedom in FREEDOM[:, 0].tolist():
        asked.clear()
        chances._quantile.cache_clear()
        found = float(chdtri(freedom, rate))
        steps.append(len(asked))
        assert stats.chi2.logsf(found, freedom) == pytest.approx(np.log(rate), rel=1e-12, abs=1e-15)
    assert max(steps) < 12


@pytest.mark.parametrize("quantile", [chdtri, gammaincc])
def test_one_number_beside_many(quantile):
    some = np.array([0.02, 0.5])
    np.testing.assert_array_equal(quantile(2.0, some), [quantile(2.0, 0.02), quantile(2.0, 0.5)])
    np.testing.assert_array_equal(quantile(some * 100.0, 0.3), [quantile(2.0, 0.3), quantile(50.0, 0.3)])


@pytest.mark.parametrize("count", [MANY - 1, MANY])
def test_scipy_is_asked_from_so_many_numbers_on(monkeypatch, count):
    asked = []
    monkeypatch.setattr(special, "gammaincc", lambda shape, value: asked.append(len(value)) or np.zeros(len(value)))
    gammaincc(1.5, np.ones(count))
    assert asked == ([count] if count == MANY else [])


def test_quantiles_of_the_normal_distribution():
    rates = np.concatenate([np.logspace(-12.0, -0.31, 40), [0.5], 1.0 - np.logspace(-9.0, -0.31, 40)])
    np.testing.assert_allclose(ndtri(rates), special.ndtri(rates), rtol=1e-12, atol=1e-15)
    assert [float(ndtri(rate)) for rate in (0.0, 1.0)] == [-np.inf, np.inf]


@pytest.mark.parametrize("freedom", [0, 0.5, 2.5, -1])
def test_degrees_of_freedom_that_are_none_are_refused(freedom):
    with pytest.raises(ValueError, match="degrees of freedom"):
        chdtri(freedom, 0.1)
    with pytest.raises(ValueError, match="degrees of freedom"):
        gammaincc(freedom / 2.0, 1.0)
    with pytest.raises(ValueError, match="degrees of freedom"):
        gammaincc(np.full(MANY, freedom / 2.0), 1.0)


@pytest.mark.parametrize("many", [False, True])
def test_the_probability_of_a_cost_is_that_of_chi_square_where_there_is_redundancy(many):
    """One by one and together; what was not found is as unlikely as can be, or 0 where nothing else tells."""
    cost = np.array([0.0, 3.0, 25.0, 7.5, 2.0, np.inf, np.nan, np.inf, np.nan, 4.0, np.inf])
    freedom = np.array([4, 1, 18, 2, 0, 3, 3, 0, -1, -2, 1])
    expected = [
        1.0,
        stats.chi2.sf(3.0, 1),
        stats.chi2.sf(25.0, 18),
        stats.chi2.sf(7.5, 2),
        1.0,
        0.0,
        0.0,
        0.0,
        0.0,
        1.0,
        0.0,
    ]
    rows = [np.arange(11)] if many else [np.array([k]) for k in range(11)]
    found = np.concatenate([probability(cost[row], freedom[row]) for row in rows])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
