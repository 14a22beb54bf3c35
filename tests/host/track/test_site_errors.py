"""Tracks on sites that are not quite as the file says: the errors stay, and the covariance says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.locate import Locator
from goldfield.site import Survey
from goldfield.track import (
    Agility,
    CycleData,
    CycleLocator,
    FixedLagSmoother,
    Tracker,
)
from goldfield.types import Fields, Status
from tests.bench import locate_trials as bench
from tests.bench.motion_trials import Room, circling, flight_poses
from tests.host.locate import built_sites as built

CALM = Agility(acceleration=0.05, angular_acceleration=0.05)
"""How a sensor may move that stands or goes round slowly: with more, the covariance would hold motion that is not."""

SENSOR = (0.01, np.radians(1.0))
FIRST = 8
"""Epochs that a track needs to settle."""


def as_built(site, rng, survey=built.DECLARED):
    """The site with errors of its own, drawn once."""
    beacons = []
    for beacon in site.beacons:
        turn = Rotation.from_rotvec(survey.axis_sd_rad * rng.normal(size=3))
        place = beacon.position_m + survey.position_sd_m * rng.normal(size=3)
        current = beacon.current_A * (1.0 + survey.current_sd * rng.normal())
        beacons.append(replace(beacon, position_m=place, axis=turn.apply(beacon.axis), current_A=current))
    return replace(site, beacons=tuple(beacons))


def distortion(rng, gain, lean):
    return np.eye(3) + np.where(np.eye(3) > 0, gain, lean) * rng.normal(size=(3, 3))


def epochs_of(site, real, matrix, rng, count, speed):
    """True positions and rotations, and the fields, of a sensor that goes round slowly."""
    flight = circling(rng, speed=speed, rate=speed)
    times = site.cycle_s * np.arange(count)
    position, rotation = flight.poses(times)
    rotation = rotation.as_matrix()
    sigma = site.sensor.noise_T / np.sqrt(bench.CHIPS)
    field = bench.magpylib_fields(real, position) @ rotation @ matrix.T
    field = field + sigma * rng.normal(size=field.shape)
    names = tuple(beacon.id for beacon in site.beacons)
    sigmas = np.full(len(names), sigma)
    fields = [
        Fields(k, time, names, one, sigmas, sweep_T_s=0.0)
        for k, (time, one) in enumerate(zip(times, field, strict=True))
    ]
    return position, rotation, fields


def judged(poses, position, rotation):
    """NEES/3 of position and attitude of each pose."""
    turned = Rotation.from_quat([pose.orientation_xyzw for pose in poses]).as_matrix()
    error = np.array([pose.position_m for pose in poses]) - position
    of_position = bench.normalised_error(error, np.array([pose.position_cov_m2 for pose in poses]))
    turn = bench.turn_error(rotation, turned)
    return of_position, bench.normalised_error(turn, np.array([pose.attitude_cov_rad2 for pose in poses]))


def tracks(speed, count, lag=None, noise=2e-8, sites=24):
    """All poses after the first of many tracks, each on a site of its own: NEES/3, statuses, and beacons left out."""
    site = built.mixed_cube(noise)
    told = built.declared(site, built.DECLARED, *SENSOR)
    results, sound = [], []
    for seed in range(sites):
        rng = np.random.default_rng([21, seed])
        truth = epochs_of(site, as_built(site, rng), distortion(rng, *SENSOR), rng, count, speed)
        tracker = Tracker(told, agility=CALM)
        if lag is None:
            poses = [tracker.update(fields) for fields in truth[2]]
        else:
            poses = list(FixedLagSmoother(told, tracker, lag).poses(truth[2]))
        results.append(np.mean(judged(poses[FIRST:], truth[0][FIRST:], truth[1][FIRST:]), axis=1))
        sound += [pose.status is Status.OK and not pose.excluded for pose in poses]
    return np.mean(results, axis=0), np.mean(sound)


@pytest.mark.parametrize("lag", [None, 5], ids=["filter", "smoother"])
@pytest.mark.parametrize("speed", [0.0, 0.2], ids=["at rest", "moving"])
def test_the_covariance_of_a_track_holds_the_errors_of_the_site(speed, lag):
    """They do not average out: what a plain filter reports after some cycles is many times too small."""
    (of_position, of_attitude), sound = tracks(speed, 14, lag)
    assert 0.7 < of_position < 1.3
    assert 0.7 < of_attitude < 1.3
    assert sound > 0.98


def test_what_stays_does_not_average_out_and_what_is_noise_does():
    site = built.mixed_cube(2e-7)
    small = Survey(0.0005, 0.0005, 0.0005)
    rng = np.random.default_rng(22)
    _, _, fields = epochs_of(site, site, np.eye(3), rng, 25, 0.0)

    def deviations(survey):
        tracker = Tracker(built.declared(site, survey), agility=CALM)
        poses = [tracker.update(one) for one in fields]
        alone = Locator(built.declared(site, survey)).locate(fields[-1])
        return np.sqrt(np.trace(poses[-1].position_cov_m2)), np.sqrt(np.trace(alone.position_cov_m2))

    tracked, alone = deviations(built.DECLARED)
    assert 0.7 * alone < tracked < alone
    tracked, alone = deviations(small)
    assert 0.05 * alone < tracked < 0.8 * alone


def test_single_cycles_know_of_the_errors_too():
    """One cycle of samples on a site that is off gives an honest covariance."""
    site = built.mixed_cube(2e-8)
    told = built.declared(site, built.DECLARED, *SENSOR)
    squares = []
    for seed in range(8):
        rng = np.random.default_rng([23, seed])
        flight = circling(rng, speed=0.5, rate=0.5)
        samples = Room(as_built(site, rng)).samples(flight, 0.0, 2e-8, rng) @ distortion(rng, *SENSOR).T
        ids = tuple(beacon.id for beacon in site.beacons)
        found = CycleLocator(told).locate(CycleData(0, 0.0, ids, samples))
        assert found.pose.status in (Status.OK, Status.UNVERIFIED)
        position, _ = flight_poses(flight, 0.0)
        error = found.pose.position_m - position
        squares.append(error @ np.linalg.solve(found.pose.position_cov_m2, error) / 3.0)
    print(squares)
    assert 0.4 < np.mean(squares) < 1.8
