"""When fields are nothing but noise: against the exact law, and on both sides of its limit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, ncx2

from goldfield.locate import silence
from goldfield.locate.fit import Measurements
from goldfield.locate.silence import SILENCE, audible


def test_far_poses_fail_as_rarely_as_stated():
    """Fields without the strongest beacon are noise or not: both sides of the threshold, against the exact law."""
    sigma, count, rng = 6e-9, 40000, np.random.default_rng(52)
    limit = chi2.isf(SILENCE, 21)
    for energy in (0.0, 30.0, 60.0):
        truth = np.zeros((8, 3))
        truth[:, 0] = sigma * np.sqrt(energy / 7)
        truth[0, 0] = 100 * sigma
        field = truth + sigma * rng.normal(size=(count, 8, 3))
        heard = audible(Measurements(field, np.full((count, 8), sigma))).mean()
        expected = ncx2.sf(limit, 21, energy) if energy else SILENCE
        assert heard == pytest.approx(expected, abs=4 * np.sqrt(expected * (1 - expected) / count))


@pytest.mark.parametrize("row", range(3))
@pytest.mark.parametrize("share", [0.999, 1.001])
def test_the_limit_is_that_of_the_components_beside_those_of_the_strongest_beacon(row, share):
    """A sensor with three axes, one with one axis, and beacons of which the strongest has one more or less."""
    known = np.array([[3, 3, 3, 3], [1, 1, 0, 0], [2, 3, 1, 0]])[row]
    others = (6 + 3, 1, 2 + 1)[row]
    field, sigma = np.full((1, 4, 3), np.nan), np.array([[2.0, 3.0, 0.5, 1.0]])
    for beacon, count in enumerate(known):
        field[0, beacon, :count] = 0.0
    strongest = 0 if row == 1 else 1
    field[0, strongest, 0] = 300.0
    field[0, 1 - strongest, 0] = sigma[0, 1 - strongest] * np.sqrt(share * chi2.isf(SILENCE, others))
    assert audible(Measurements(field, sigma)).tolist() == [share > 1.0]


def test_each_epoch_is_judged_alone():
    """By what is strong over its own noise: the field of the first beacon is the larger, not the stronger."""
    field = np.zeros((3, 2, 3))
    field[:, 0, 0], field[:, 1, 1] = [100.0, 100.0, 3.0], [10.0, 10.0, 9.0]
    sigma = np.array([[1.0, 1.0], [50.0, 1.0], [1.0, 1.0]])
    assert audible(Measurements(field, sigma)).tolist() == [True, False, False]


def test_one_beacon_alone_is_as_good_as_none():
    field = np.full((1, 3, 3), np.nan)
    field[0, 1] = 1.0
    assert audible(Measurements(field, np.full((1, 3), 1e-9))).tolist() == [False]


def test_what_is_just_as_much_as_the_limit_is_noise(monkeypatch):
    monkeypatch.setattr(silence, "_of_silence", lambda components: np.full(components + 1, 4.0))
    field = np.zeros((2, 3, 3))
    field[:, 0, 0], field[:, 1, 1] = 9.0, [2.0, 2.5]
    assert audible(Measurements(field, np.ones((2, 3)))).tolist() == [False, True]
