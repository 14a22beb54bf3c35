"""Iron that passes: poses that are off are not said to be right, and sound ones are."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from goldfield.track.blocks import BlockFilter
from goldfield.types import Status
from tests.bench import rate_trials
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import EARTH_T
from tests.bench.rate_iron import ball, copper, passing, sheet
from tests.bench.rate_ways import Errors, follow
from tests.bench.rate_world import World, motion_of

SETTLED_S = 0.3


@pytest.mark.long
@pytest.mark.parametrize("name", ["still", "1 m/s, 1 rad/s", "hand, 2 Hz", "drone, 3 m/s"])
def test_thirty_kilograms_that_pass_draw_no_pose_that_is_said_to_be_right(name):
    """At 2 mG the fields of the beacons hardly tell; the ambient field does, and the covariance holds the errors."""
    errors = passing((ball(30.0),), BlockFilter, 2e-7, name, 0, 1.2).after(SETTLED_S)
    assert errors.distance_m.max() > 0.02, "the iron does draw the poses"
    assert not errors.unsaid.any()
    assert (errors.status != Status.OK).mean() > 0.2
    assert errors.nees < 2.0


@pytest.mark.long
@pytest.mark.parametrize("thing", [sheet(0.3), copper(0.1)], ids=["sheet", "copper"])
def test_metal_of_other_kinds(thing):
    """Copper leaves the ambient field as it is: what the beacons leave tells of it, as it is strong enough at .2 mG."""
    errors = passing((thing,), BlockFilter, 2e-8, "1 m/s, 1 rad/s", 1, 1.0).after(SETTLED_S)
    assert errors.unsaid.mean() < 0.01
    assert (errors.status != Status.OK).any()


@pytest.mark.long
@pytest.mark.parametrize("noise_T", [2e-7, 2e-8])
@pytest.mark.parametrize(
    "trial", [partial(rate_trials.blocks_lost, lambda number: False), partial(rate_trials.survey, 3e-3)]
)
def test_no_iron_is_said_where_there_is_none(trial, noise_T):
    runs = [trial(BlockFilter, noise_T, name, 4, 0.7) for name in ("0.5 m/s, 0.5 rad/s", "hand, 2 Hz", "drone, 3 m/s")]
    errors = Errors.joined([run.after(SETTLED_S) for run in runs])
    assert (errors.status == Status.OK).all()


def test_a_magnet_that_is_switched_on_turns_no_pose():
    """An ambient field that jumps by 10 uT: the bank that takes it for even turns, and is not believed."""
    room = World(prigge_cube(2e-7))
    times = room.times(8184)
    position, rotation = motion_of("still", 5).poses(times)
    ambient = EARTH_T + np.outer(np.clip((times - 0.4) / 0.1, 0.0, 1.0), [7e-6, -5e-6, 5e-6])
    track = room.track(position, rotation, np.random.default_rng(5), 2e-7, ambient_T=ambient)
    block_filter, weights = BlockFilter(track.site), []
    for _, block in track.blocks():
        pose = block_filter.update(block)
        weights.append(block_filter._banks[0].alone)
    errors = follow(track, BlockFilter(track.site))
    during = errors.after(0.4)
    assert np.degrees(np.linalg.norm(during.attitude_rad, axis=1)).max() < 4.0
    assert not during.unsaid.any()
    assert max(weights[40:120]) < 0.5 < max(weights[130:])
    assert pose.status is Status.UNVERIFIED
    assert "the ambient field has changed by" in pose.reason


@pytest.mark.long
@pytest.mark.parametrize(("usual_T_m", "said"), [(3e-6, True), (3e-5, False)])
def test_steel_in_the_walls_is_iron_unless_the_site_says_that_it_is_usual(usual_T_m, said):
    """A drone in a harmonic field of 12 uT/m."""
    room = World(prigge_cube(2e-8))
    times = room.times(16368)
    position, rotation = motion_of("drone, 3 m/s", 3).poses(times)
    ambient = EARTH_T + (position - position[0]) @ np.diag([12e-6, -6e-6, -6e-6])
    track = room.track(position, rotation, np.random.default_rng(6), 2e-8, ambient_T=ambient)
    site = replace(track.site, ambient_gradient_T_m=usual_T_m)
    errors = follow(track, BlockFilter(site)).after(SETTLED_S)
    assert (errors.status == Status.UNVERIFIED).any() == said
    assert (errors.status == Status.INCONSISTENT).sum() == 0
    assert not errors.unsaid.any()
