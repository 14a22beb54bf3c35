"""Ambiguity: the cheap criterion against the locator's own search on fields without noise, and its thresholds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from goldfield.locate import Locator
from goldfield.planning.tile import noise_of
from goldfield.site import HalfSpace
from goldfield.types import Fields, Status
from tests.host.planning.built import beacon, ceiling, cube, site_of, true_components
from tests.host.planning.test_bound import figures_at

BELOW = np.array([[3.4, 4.1, 1.2], [5.0, 2.0, 0.5], [4.6, 4.4, 1.9]])
ABOVE = BELOW * [1.0, 1.0, -1.0] + [0.0, 0.0, 6.0]


def planned(site, points):
    return [figures.ambiguous.item() for figures in figures_at(site, points)]


def located(site, points):
    """Return whether the locator calls the poses ambiguous, or finds another one, with fields without noise."""
    epochs = [
        Fields(e, 0.0, tuple(one.id for one in site.beacons), true_components(site, p, np.eye(3)).reshape(-1, 3), s)
        for e, (p, s) in enumerate((point, noise_of(site)) for point in points)
    ]
    poses = Locator(site).locate_many(epochs)
    apart = [np.linalg.norm(pose.position_m - point) > 0.1 for pose, point in zip(poses, points, strict=True)]
    return [pose.status is Status.AMBIGUOUS or bool(far) for pose, far in zip(poses, apart, strict=True)]


@pytest.mark.parametrize(
    ("site", "points", "expected"),
    [
        (cube(), [[1.0, 1.1, 0.9], [0.4, 0.3, 0.5], [3.0, 1.0, 1.0]], False),
        (ceiling(4, 4, side=0), BELOW, True),
        (ceiling(4, 4, side=-1), BELOW, False),
        (ceiling(4, 4, side=1), ABOVE, False),
        (ceiling(4, 4, side=-1), ABOVE, True),
    ],
    ids=["cube", "either side", "below", "above", "on the wrong side"],
)
def test_it_agrees_with_the_locator(site, points, expected):
    assert planned(site, np.array(points)) == [expected] * len(points) == located(site, points)


def test_coils_around_one_point_have_an_image_beyond_it():
    axes = np.vstack([np.eye(3), [1.0, 1.0, 1.0]])
    site = site_of([beacon(i, (0.0, 0.0, 0.0), axis) for i, axis in enumerate(axes)])
    points = BELOW / 4.0
    assert planned(site, points) == [True] * 3 == located(site, points)
    half = replace(site, half_space=HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0])))
    assert planned(half, points) == [False] * 3 == located(half, points)


def test_a_beacon_out_of_the_plane_tells_the_sides_apart_as_soon_as_the_locator_can_tell():
    """The further one coil hangs below the others the better it tells the sides apart; both judge alike."""
    told = []
    for drop in (0.0, 0.003, 0.01, 0.1, 0.5):
        site = ceiling(4, 4, side=0)
        moved = tuple(
            replace(one, position_m=one.position_m - [0.0, 0.0, drop * (i % 2)]) for i, one in enumerate(site.beacons)
        )
        site = replace(site, beacons=moved)
        assert planned(site, BELOW[:1]) == located(site, BELOW[:1])
        told += planned(site, BELOW[:1])
    assert told[0]
    assert not told[-1]
    assert sorted(told, reverse=True) == told
