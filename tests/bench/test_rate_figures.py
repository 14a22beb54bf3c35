"""The figures of the block filter rest on these: the samples, the least error, the bench of boards, and a short run."""

from __future__ import annotations

from functools import partial

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.track.blocks import BlockFilter
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import CHIPS, EARTH_T, Room, cycle_bound, straight
from tests.bench.rate_boards import open_bench, scenario_file, streamed
from tests.bench.rate_bound import LeastError
from tests.bench.rate_iron import _dipoles as dipoles
from tests.bench.rate_iron import ball, copper, sheet
from tests.bench.rate_trials import lost, random_walks, starts
from tests.bench.rate_ways import follow, held_fixes
from tests.bench.rate_world import BLOCK_CHIPS, Walks, World, matched_walks, motion_of

NOISE_T = 2e-7


class LateRoom(Room):
    """A room in which the time 0 of a flight is the end of the cycle of samples, not its middle."""

    def samples(self, flight, middle_s, noise_T, rng, earth_T=EARTH_T):
        return super().samples(flight, middle_s - 0.5 * self.site.cycle_s, noise_T, rng, earth_T)


def test_the_least_error_of_a_straight_flight_is_that_of_all_its_samples_at_once():
    """The recursion over a cycle tells at its end what the information of all its samples does."""
    site = prigge_cube(NOISE_T)
    velocity, rate = np.array([0.6, -0.5, 0.3]), np.array([0.4, 0.5, 0.6])
    flight = straight(np.array([0.9, 1.2, 0.8]), Rotation.from_rotvec([0.3, 1.0, -0.5]), velocity, rate)
    position, rotation = flight.poses((np.arange(CHIPS) + 1 - CHIPS) * site.chip_period_s)
    walks = Walks(position[None], rotation.as_matrix()[None], np.tile(EARTH_T, (1, CHIPS, 1)), np.zeros((1, CHIPS, 3)))
    least = LeastError(World(site), walks, NOISE_T, agility=(1e-6, 1e-6), ambient_walk=0.0, offset_sd_T=0.0)
    at_once = cycle_bound(LateRoom(site), flight, NOISE_T)
    assert np.sqrt(np.trace(least.of_samples()[0, -1][:3, :3])) == pytest.approx(at_once, rel=2e-3)
    assert 0.998 < np.sqrt(np.trace(least.of_sums()[0, -1][:3, :3])) / at_once < 1.02


def test_random_walks_have_the_agility_that_they_are_asked_for():
    period_s, count = 1e-4, 2000
    walks = matched_walks(np.random.default_rng(1), 100, count, period_s, (0.5, 1.0))
    velocity = np.diff(walks.position_m[:, ::500], axis=1) / (500 * period_s)
    # Mean velocities of neighbouring intervals T differ by a variance of a^2 T (1/3 + 1/3).
    assert np.diff(velocity, axis=1).var() == pytest.approx(0.5**2 * 0.05 * 2.0 / 3.0, rel=0.1)
    turns = Rotation.from_matrix(walks.rotation[:, ::500].reshape(-1, 3, 3))
    steps = (turns[1:] * turns[:-1].inv()).as_rotvec().reshape(-1, 3)
    rates = np.insert(steps, len(steps), np.nan, axis=0).reshape(100, 4, 3)[:, :3] / (500 * period_s)
    assert np.diff(rates, axis=1).var() == pytest.approx(1.0**2 * 0.05 * 2.0 / 3.0, rel=0.1)


def test_a_matched_track_reaches_the_least_error():
    """The rms over the least error is at most 1.05, and what chance adds to ten walks. Their ambient field walks and
    bends nothing: the allowance for iron is off."""
    noise_T, agility, count = 2e-8, (2.0, 4.0), 2046
    site, rng = prigge_cube(noise_T), np.random.default_rng(5)
    walks = matched_walks(rng, 10, count, site.chip_period_s, agility)
    least = LeastError(World(site), walks, noise_T, agility).of_sums()
    settled, make = slice(count // BLOCK_CHIPS // 2, None), partial(BlockFilter, even_T=np.inf)
    runs = [run.where(settled) for run in random_walks(make, World(site), walks, noise_T, 5)]
    variance = np.diagonal(least[:, settled], axis1=-2, axis2=-1).mean(axis=(0, 1))
    for errors, part in (("position_m", slice(0, 3)), ("attitude_rad", slice(3, 6))):
        square = np.array([(getattr(run, errors) ** 2).sum(axis=1).mean() for run in runs]) / variance[part].sum()
        chance = square.std(ddof=1) / np.sqrt(len(runs)) / 2.0  # of the root
        assert np.sqrt(square.mean()) < 1.05 + chance
        assert chance < 0.12
    assert 0.7 < np.mean([run.nees for run in runs]) < 1.3


def test_a_bench_streams_what_the_simulated_samples_are():
    """The samples of boards differ from those of magpylib's coils at the truth by noise alone, a chip each."""
    bench = open_bench(scenario_file("1 m/s, 1 rad/s", 0, NOISE_T, "stream = 1\n"), "host")
    track = streamed(bench, 0.6)
    bench.close()
    ideal = World(bench.site).track(track.position_m, track.rotation, np.random.default_rng(0), 0.0)
    rest = track.samples_T - ideal.samples_T
    np.testing.assert_allclose(rest.std(axis=0), bench.site.sensor.noise_T, rtol=0.1)
    assert np.abs(np.mean(rest[:, :, None] * World(bench.site).chips(len(rest))[:, None], axis=0)).max() < 2e-8
    assert track.first_cycle > 0
    blocks = list(track.blocks())
    assert [block.chip for _, block in blocks[:2]] == [0, 31]
    assert blocks[0][1].cycle == track.first_cycle


def test_a_held_fix_is_as_old_as_it_is():
    site = prigge_cube(2e-9)
    motion = motion_of("1 m/s, 1 rad/s", 0)
    errors = held_fixes(World(site).motion_track(motion, 0.5, np.random.default_rng(2), 2e-9))
    position, _ = motion.poses(errors.time_s[:1])
    assert 0.05 < errors.rms_mm / 1e3 < 0.2
    assert errors.nees > 1e3
    assert len(position) == 1


def test_a_track_of_a_shaken_sensor_is_accurate_and_protected():
    """A hand's motion at 0.2 mG: the protection of a pose is that of the track, not of a cycle at rest."""
    site = prigge_cube(2e-8)
    track = World(site).motion_track(motion_of("hand, 2 Hz", 0), 0.8, np.random.default_rng(3), 2e-8)
    errors = follow(track, BlockFilter(site)).after(0.3)
    assert errors.rms_mm < 4.0
    assert errors.share_ok == 1.0
    assert errors.wrong == "0+0"


def test_a_start_from_one_block_finds_the_sensor():
    for run in starts(BlockFilter, NOISE_T, 4, seed=1):
        assert not lost(run, 0.1)
        assert not run.unsaid.any()


def test_the_fields_of_iron_are_those_of_its_dipoles():
    """A ball of 30 kg answers 50 uT with half a A m^2; its dipole's field is magpylib's."""
    thing, field = ball(30.0), np.array([3e-5, 0.0, -4e-5])
    moment = thing.size_m3 / 1e-7 * field
    assert np.linalg.norm(moment) == pytest.approx(0.455, rel=1e-2)
    place = np.array([[0.2, -0.1, 0.25]])
    expected = magpylib.misc.Dipole(moment=moment).getB(place)
    np.testing.assert_allclose(dipoles(place, np.tile(moment, (1, 1, 1)))[:, 0].ravel(), expected.ravel(), rtol=1e-6)
    assert copper(0.1).size_m3 == pytest.approx(-0.5e-3)
    assert sheet(0.3).size_m3 == pytest.approx(4.0 / (3.0 * np.pi) * 0.027)
