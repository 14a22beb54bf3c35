"""Declared errors of site and sensor on the board: sites that are really off by them, with fields made by magpylib."""

import dataclasses

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.locate import Locator
from goldfield.site.model import Survey
from goldfield.types import Fields
from hil_sim.clib import ROOT
from tests.firmware.core.pose.test_pose import (
    INCONSISTENT,
    OK,
    UNVERIFIED,
    Sensor,
    covariance_of,
    inside,
    position_of,
    rotation_of,
    with_fault,
    wrong_ok,
)

SIGMA_T = 2e-8 / np.sqrt(1023)  # 0.2 mG a sample
CLASSES = {
    "default": (Survey(0.003, 0.005, 0.003), (0.003, 0.005)),
    "1 cm, 1 degree, 1 %": (Survey(0.01, np.deg2rad(1.0), 0.01), (0.0, 0.0)),
    "sensor alone": (Survey(0.0, 0.0, 0.0), (0.01, 0.01)),
}


def declared(name):
    """The cube, declared as known to the errors of a class."""
    survey, (gain, axis) = CLASSES[name]
    cube = sites.load(ROOT / "host/sites/prigge8.toml")
    beacons = tuple(dataclasses.replace(beacon, survey=survey) for beacon in cube.beacons)
    sensor = dataclasses.replace(cube.sensor, gain_sd=gain, axis_sd_rad=axis)
    return dataclasses.replace(cube, beacons=beacons, sensor=sensor)


def epoch(site, position, rotation, rng, share=1.0):
    """The fields, shape (n, 3), of a site and a sensor that are off by so much of what is declared; without noise."""
    rows = []
    for b in site.beacons:
        survey = b.survey
        place = b.position_m + share * survey.position_sd_m * rng.normal(size=3)
        lean = Rotation.from_rotvec(share * survey.axis_sd_rad * rng.normal(size=3))
        coil = magpylib.current.Circle(
            current=b.turns * b.current_A * (1.0 + share * survey.current_sd * rng.normal()),
            diameter=2 * b.radius_m,
            position=place,
            orientation=lean * Rotation.align_vectors(b.axis[None], [[0.0, 0.0, 1.0]])[0],
        )
        rows.append(coil.getB(position))
    off = site.sensor.axis_sd_rad * rng.normal(size=(3, 3))
    off[np.diag_indices(3)] = site.sensor.gain_sd * rng.normal(size=3)
    return rotation.inv().apply(np.array(rows)) @ (np.eye(3) + share * off).T


def monte_carlo(core, name, count, seed):
    """Poses of sites that are off as declared, with their truths and fields."""
    site = declared(name)
    rng = np.random.default_rng(seed)
    sensor = Sensor(core, site)
    position, rotation = inside(site, 1.2, count, rng)
    results = []
    for e in range(count):
        fields = epoch(site, position[e], rotation[e], rng) + rng.normal(0.0, SIGMA_T, (8, 3))
        results.append((sensor.locate(fields, SIGMA_T), position[e], rotation[e], fields))
    return site, results


@pytest.mark.parametrize("name", CLASSES)
def test_sites_that_are_off_as_declared(core, name):
    count = 300
    _, results = monte_carlo(core, name, count, 31)
    place, turn = [], []
    for pose, position, rotation, _ in results:
        error = position_of(pose) - position
        vector = (rotation_of(pose) * rotation.inv()).as_rotvec()
        covariance = covariance_of(pose)
        place.append(error @ np.linalg.solve(covariance[0], error) / 3)
        turn.append(vector @ np.linalg.solve(covariance[1], vector) / 3)
    statuses = np.bincount([pose.status for pose, *_ in results], minlength=6)
    wrong = sum(wrong_ok(pose, position) for pose, position, *_ in results)
    beyond = sum(np.linalg.norm(position_of(pose) - position) > pose.protection_m for pose, position, *_ in results)
    rms = np.sqrt(np.mean([np.sum((position_of(pose) - position) ** 2) for pose, position, *_ in results]))
    print(f"{name}: NEES/3 {np.mean(place):.2f}, attitude {np.mean(turn):.2f}, rms {1e3 * rms:.1f} mm")
    print(f"statuses {statuses.tolist()}, wrong ok {wrong}, beyond the protection level {beyond}")
    assert 0.7 < np.mean(place) < 1.3
    assert 0.7 < np.mean(turn) < 1.3
    assert (wrong, beyond) == (0, 0)
    assert statuses[INCONSISTENT] <= 1  # of 300, where 0.2 are to be expected


@pytest.mark.parametrize("name", CLASSES)
def test_pose_covariance_and_level_as_the_hosts(core, name):
    site, results = monte_carlo(core, name, 60, 32)
    locator, names = Locator(site), tuple(beacon.id for beacon in site.beacons)
    apart, ratio, level = [], [], []
    for e, (pose, _, _, fields) in enumerate(results):
        host = locator.locate(Fields(e, 0.0, names, fields, np.full(8, SIGMA_T)))
        size = np.sqrt(np.trace(host.position_cov_m2))
        apart.append(np.linalg.norm(position_of(pose) - host.position_m) / size)
        own_place, own_turn = covariance_of(pose)
        ratio.append([np.trace(own_place) / size**2, np.trace(own_turn) / np.trace(host.attitude_cov_rad2)])
        level.append(pose.protection_m / host.protection_m)
        assert pose.residual == pytest.approx(host.residual, abs=0.05)
    print(f"{name}: apart {np.percentile(apart, [50, 100])} of sigma, covariance {np.median(ratio, axis=0)}")
    print(f"protection level {np.percentile(level, [0, 50, 100])} of the host's")
    assert np.median(apart) < 0.02
    assert np.mean(np.array(apart) < 0.1) > 0.95
    assert np.median(ratio, axis=0) == pytest.approx([1.0, 1.0], abs=0.03)
    assert 0.95 < np.median(level) < 1.1


def test_without_the_declaration_such_sites_are_inconsistent(core):
    """The test above can fail: a board that knows only noise takes these fields for faulty."""
    exact = Sensor(core, sites.load(ROOT / "host/sites/prigge8.toml"))
    _, results = monte_carlo(core, "default", 40, 33)
    assert np.mean([exact.locate(fields, SIGMA_T).status == INCONSISTENT for *_, fields in results]) > 0.9


@pytest.mark.parametrize(("share", "alarmed"), [(1.0, False), (6.0, True)])
def test_errors_beyond_what_is_declared_raise_the_alarm(core, share, alarmed):
    site, rng = declared("default"), np.random.default_rng(34)
    sensor = Sensor(core, site)
    position, rotation = inside(site, 1.0, 30, rng)
    poses = [
        sensor.locate(epoch(site, position[e], rotation[e], rng, share) + rng.normal(0.0, SIGMA_T, (8, 3)), SIGMA_T)
        for e in range(30)
    ]
    inconsistent = np.mean([pose.status == INCONSISTENT for pose in poses])
    left_out = np.mean([pose.left_out != 2**32 - 1 for pose in poses])
    assert (inconsistent + left_out > 0.9) if alarmed else (inconsistent + left_out == 0.0)


@pytest.mark.parametrize("kind", ["dead", "reversed", "strong", "moved"])
def test_one_faulty_beacon_among_declared_errors(core, kind):
    site, rng = declared("default"), np.random.default_rng(35)
    sensor = Sensor(core, site)
    position, rotation = inside(site, 1.0, 80, rng)
    right, others, wrong = 0, 0, 0
    for e in range(80):
        clean = epoch(site, position[e], rotation[e], rng)
        fields = with_fault(site, kind, e % 8, position[e], rotation[e], clean) + rng.normal(0.0, SIGMA_T, (8, 3))
        pose = sensor.locate(fields, SIGMA_T)
        right += pose.left_out == e % 8
        others += pose.left_out not in (e % 8, 2**32 - 1)
        wrong += wrong_ok(pose, position[e])
    print(f"{kind}: left out {right} of 80, another {others}, wrong ok {wrong}")
    assert (others, wrong) == (0, 0)
    assert right >= 0.9 * 80


@pytest.mark.parametrize("gain", [1.2, 0.8])
def test_a_gain_beyond_the_declared_is_named(core, gain):
    site, rng = declared("default"), np.random.default_rng(36)
    sensor = Sensor(core, site)
    position, rotation = inside(site, 1.0, 60, rng)
    named = 0
    for e in range(60):
        pose = sensor.locate(gain * epoch(site, position[e], rotation[e], rng), SIGMA_T)
        assert pose.status not in (OK, UNVERIFIED)
        named += pose.reason == 12
    assert named >= 0.9 * 60
