"""The distributions of location against SciPy's."""

import numpy as np
import pytest
from scipy import special

from goldfield.locate.chances import MANY, chdtri, gammaincc, ndtri

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
    chances = np.concatenate([np.logspace(-15.0, -0.05, 80), [0.0, 1.0]])
    np.testing.assert_allclose(chdtri(FREEDOM, chances), special.chdtri(FREEDOM * 1.0, chances), rtol=1e-12)
    near_1 = 1.0 - np.logspace(-9.0, -2.0, 8)  # as exact as the chance itself, which is a double near 1
    below = np.broadcast_to(1.0 - near_1, (len(FREEDOM), 8))
    np.testing.assert_allclose(special.chdtr(FREEDOM * 1.0, chdtri(FREEDOM, near_1)), below, rtol=0, atol=1e-12)
    assert np.isnan(chdtri(3, np.nan))


def test_quantiles_of_the_normal_distribution():
    chances = np.concatenate([np.logspace(-12.0, -0.4, 40), [0.5], 1.0 - np.logspace(-9.0, -0.4, 40)])
    np.testing.assert_allclose(ndtri(chances), special.ndtri(chances), rtol=1e-12, atol=1e-15)
    assert [float(ndtri(chance)) for chance in (0.0, 1.0)] == [-np.inf, np.inf]


@pytest.mark.parametrize("freedom", [0, 0.5, 2.5, -1])
def test_degrees_of_freedom_that_are_none_are_refused(freedom):
    with pytest.raises(ValueError, match="degrees of freedom"):
        chdtri(freedom, 0.1)
    with pytest.raises(ValueError, match="degrees of freedom"):
        gammaincc(freedom / 2.0, 1.0)
    with pytest.raises(ValueError, match="degrees of freedom"):
        gammaincc(np.full(MANY, freedom / 2.0), 1.0)
