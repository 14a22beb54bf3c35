"""Tracks on sites that are not quite as the file says: the errors stay, and the covariance says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.track import FixedLagSmoother, Tracker
from goldfield.types import Fields, Status
from tests.bench import locate_trials as bench
from tests.bench.motion_trials import circling
from tests.host.locate import built_sites as built

SENSOR = (0.01, np.radians(1.0))
FIRST = 10
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


def tracks(speed, count, lag=None, noise=2e-8, sites=60):
    """All poses after the first of many tracks, each on a site of its own: NEES/3, statuses, and beacons left out."""
    site = built.mixed_cube(noise)
    told = built.declared(site, built.DECLARED, *SENSOR)
    results, sound = [], []
    for seed in range(sites):
        rng = np.random.default_rng([21, seed])
        truth = epochs_of(site, as_built(site, rng), distortion(rng, *SENSOR), rng, count, speed)
        tracker = Tracker(told)
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
    """They do not average out: what a plain filter reports after thirty cycles is many times too small."""
    (of_position, of_attitude), sound = tracks(speed, 30, lag)
    print(of_position, of_attitude, sound)
    assert 0.7 < of_position < 1.3
    assert 0.7 < of_attitude < 1.3
    assert sound > 0.98
