"""Code reuse: the level of conflicts, their threshold, and numbers that respect them."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.planning import Grid, Request, Settings, plan
from goldfield.planning.codes import shared_codes
from goldfield.planning.maps import Conflicts
from tests.host.planning.built import beacon, ceiling, site_of, true_components


def two_islands():
    """Return four beacons around the origin and four 60 m away."""
    places = [(x + far, y, z) for far in (0.0, 60.0) for x, y, z in ((0, 0, 2), (2, 0, 2), (0, 2, 2), (2, 2, 1))]
    return site_of([beacon(i, place) for i, place in enumerate(places)])


def plan_of(site, point, conflict_dB, best=4):
    grid = Grid.of_box(np.array(point), np.array(point), 1.0)
    return plan(Request(site, grid, Settings(best=best, truncation=0.0, conflict_dB=conflict_dB)))


def test_levels_are_ratios_of_the_true_fields():
    site, point = two_islands(), [1.2, 0.7, 0.4]
    strength = np.linalg.norm(true_components(site, point, np.eye(3)).reshape(-1, 3), axis=1)
    conflicts = plan_of(site, point, 300.0).conflicts
    assert {tuple(pair) for pair in conflicts.pair.tolist()} == {(i, j) for i in range(4) for j in range(8) if i != j}
    for (used, other), level in zip(conflicts.pair, conflicts.level_dB, strict=True):
        assert level == pytest.approx(20.0 * np.log10(strength[other] / strength[used]), abs=1e-6)


def test_beacons_may_share_a_code_from_the_threshold_on():
    site, point = two_islands(), [1.2, 0.7, 0.4]
    found = plan_of(site, point, 300.0).conflicts
    level = np.full((4, 8), -np.inf)
    level[found.pair[:, 0], found.pair[:, 1]] = found.level_dB
    limit = level[:, 4:].min(axis=0).max()  # above it one of the far beacons disturbs all four near ones
    assert limit < -60.0
    apart, shared = (plan_of(site, point, -limit + margin) for margin in (0.01, -0.01))
    assert apart.shared_code.max() + 1 == 5
    assert shared.shared_code.max() + 1 == 4


def test_numbers_respect_every_conflict_and_a_larger_hall_needs_no_more():
    needed = []
    for count in (10, 14):
        site = ceiling(count, count, spacing=4.0)
        middle = 4.0 * (count - 1)
        grid = Grid.of_box(np.array([0.0, 0.0, 1.5]), np.array([middle, middle, 1.5]), 2.0)
        maps = plan(Request(site, grid, Settings(best=4, conflict_dB=26.0)))
        first, second = maps.conflicts.pair.T
        assert (maps.shared_code[first] != maps.shared_code[second]).all()
        assert (maps.conflicts.level_dB >= -26.0).all()
        needed.append(int(maps.shared_code.max()) + 1)
    assert needed[0] < 100
    assert needed[1] <= 1.25 * needed[0]


def test_a_ring_of_an_odd_length_needs_three():
    ring = np.array([[i, (i + 1) % 5] for i in range(5)], dtype=np.int32)
    number = shared_codes(Conflicts(ring, np.zeros(5)), 6)
    assert (number[ring[:, 0]] != number[ring[:, 1]]).all()
    assert number.max() + 1 == 3
