"""Slopes over repeated runs: found where there is one, and no more often than promised where there is none."""

import numpy as np
import pytest

from hil_sim.papers.zheng.trend import slope_per_day, trend

TIME_S = np.arange(0, 48 * 3600, 600.0)


def wandering(rng):
    """Noise that remembers for hours, and a daily cycle of any phase."""
    value = np.empty(len(TIME_S))
    state = rng.normal()
    for step in range(len(TIME_S)):
        state = 0.9 * state + np.sqrt(1 - 0.81) * rng.normal()
        value[step] = state
    return value + 3.0 * np.sin(2 * np.pi * (TIME_S / 86400 + rng.uniform()))


def test_a_slope_beside_a_daily_cycle_is_exact():
    value = 7.0 + 0.3 * TIME_S / 86400 + 2.0 * np.sin(2 * np.pi * TIME_S / 86400 + 0.4)
    assert slope_per_day(TIME_S, value) == pytest.approx(0.3, rel=1e-9)


def test_no_trend_is_called_one_in_about_one_of_twenty_series():
    rng = np.random.default_rng(1)
    slopes = np.array([slope_per_day(TIME_S, wandering(rng)) for _ in range(600)]).reshape(100, 6)
    called = sum(not trend(some).consistent_with_zero for some in slopes)
    assert 0 < called < 14


def test_a_trend_is_found():
    rng = np.random.default_rng(2)
    found = trend(np.array([slope_per_day(TIME_S, wandering(rng) + 3.0 * TIME_S / 86400) for _ in range(10)]))
    assert not found.consistent_with_zero
    assert abs(found.per_day - 3.0) < 3 * found.sigma_per_day
    assert found.sigma_per_day == pytest.approx(found.one_run_per_day / np.sqrt(10))
