"""One cycle of a moving sensor: pose, velocity and turn rate at the Cramer-Rao bound, with no prior."""

import numpy as np
import pytest

from goldfield.locate.uncertainty import cramer_rao_bound
from goldfield.track import CycleData, CycleLocator
from goldfield.types import Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import EARTH_T, Room, cycle_bound, flight_poses, random_flight

IDS = tuple(beacon.id for beacon in prigge_cube().beacons)


def errors(noise_T, count, seed, speed=1.0, rate=1.0):
    """Position errors over the bound, normalised errors squared per axis, and results of random flights."""
    site = prigge_cube(noise_T)
    room, locator = Room(site), CycleLocator(site)
    rng = np.random.default_rng(seed)
    ratio, normalised, moving = [], [], []
    for index in range(count):
        flight = random_flight(site, rng, speed, rate)
        samples = room.samples(flight, 0.0, noise_T, rng)
        found = locator.locate(CycleData(index, 0.1 * index, IDS, samples))
        position, _ = flight_poses(flight, 0.0)
        error = found.pose.position_m - position
        ratio.append(np.linalg.norm(error) / cycle_bound(room, flight, noise_T))
        normalised.append(error @ np.linalg.solve(found.pose.position_cov_m2, error) / 3)
        moving.append((flight, found))
    return np.array(ratio), np.array(normalised), moving


def test_at_the_bound_at_one_metre_and_one_radian_a_second():
    ratio, normalised, _ = errors(2e-7, 30, 11)
    assert 0.8 < np.sqrt((ratio**2).mean()) < 1.15
    assert 0.5 < normalised.mean() < 1.6


def test_low_noise_shows_no_motion():
    _, normalised, moving = errors(5e-9, 25, 12)
    position = [np.linalg.norm(found.pose.position_m - flight_poses(flight, 0.0)[0]) for flight, found in moving]
    assert np.sqrt(np.mean(np.square(position))) < 1e-3
    assert 0.5 < normalised.mean() < 1.6
    for flight, found in moving:
        before, after = flight_poses(flight, -1e-3), flight_poses(flight, 1e-3)
        velocity = (after[0] - before[0]) / 2e-3
        rate = (after[1] * before[1].inv()).as_rotvec() / 2e-3
        deviation = np.sqrt(np.diag(found.covariance))
        assert (np.abs(found.state.velocity_m_s - velocity) < 6 * deviation[6:9]).all()
        assert (np.abs(found.state.rate_rad_s - rate) < 6 * deviation[9:12]).all()
        assert (np.abs(found.state.ambient_T - EARTH_T) < 6 * deviation[12:]).all()
        assert found.pose.status is Status.OK
        assert found.pose.used == IDS
        assert found.pose.excluded == ()


def test_a_sensor_at_rest_and_the_tags_are_kept():
    ratio, _, moving = errors(2e-7, 15, 13, speed=0.0, rate=0.0)
    assert np.sqrt((ratio**2).mean()) < 1.4
    assert [found.pose.epoch for _, found in moving] == list(range(15))
    assert moving[3][1].pose.time_s == pytest.approx(0.3)


def test_two_axes_and_none():
    site = prigge_cube(5e-9)
    room, locator = Room(site), CycleLocator(site)
    rng = np.random.default_rng(14)
    flight = random_flight(site, rng, 0.5, 0.5)
    samples = room.samples(flight, 0.0, 5e-9, rng)
    samples[:, 2] = np.nan
    found = locator.locate(CycleData(0, 0.0, IDS, samples))
    error = found.pose.position_m - flight_poses(flight, 0.0)[0]
    assert found.pose.status is Status.OK
    assert error @ np.linalg.solve(found.pose.position_cov_m2, error) < 30
    nothing = locator.locate(CycleData(1, 0.1, IDS, np.full((1023, 3), np.nan)))
    assert nothing.pose.status is Status.FAILED
    assert nothing.state is None


def test_the_wrong_site_is_told():
    """A beacon 20 cm from where the site says: no motion explains that."""
    room = Room(prigge_cube(2e-8))
    room.coils[2].move([0.1, 0.1, 0.14])
    rng = np.random.default_rng(15)
    flight = random_flight(room.site, rng, 1.0, 1.0)
    found = CycleLocator(room.site).locate(CycleData(0, 0.0, IDS, room.samples(flight, 0.0, 2e-8, rng)))
    assert found.pose.status is Status.INCONSISTENT
    assert found.pose.residual > 2


def test_the_bound_is_that_of_a_still_sensor_when_it_stands_still():
    """With the ambient field known to be constant, motion costs a still sensor nothing at mid-cycle but the sweep."""
    site = prigge_cube()
    rng = np.random.default_rng(16)
    flight = random_flight(site, rng, 0.0, 0.0)
    position, rotation = flight_poses(flight, 0.0)
    still = cramer_rao_bound(site, position[None], rotation.as_matrix()[None])[0]
    assert cycle_bound(Room(site), flight, 2e-7) == pytest.approx(np.sqrt(np.trace(still[:3, :3])), rel=0.05)
