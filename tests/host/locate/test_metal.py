"""Location in a room with a body of metal, with and without knowing of it; the truth is magpylib's."""

from __future__ import annotations

import itertools
from dataclasses import replace

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.errors import UserError
from goldfield.locate import Locator
from goldfield.sensor.location import location
from goldfield.sensor.options import Method, Options
from goldfield.site import Beacon, SensorSite, Site
from goldfield.site.metal import BeaconMetal, Metal
from goldfield.types import Fields, Status

NOISE_T = 2e-10
BODY = np.array([2.4, 1.0, 1.0])
POLARISABILITY = 4e5 * np.eye(3)
"""That of a ball of iron of 68 cm across: 4 pi a^3/mu0."""


def _site(metal: Metal | None) -> Site:
    beacons = []
    for i, corner in enumerate(itertools.product((0.0, 2.0), repeat=3)):
        axis = np.eye(3)[i % 3]
        of_metal = None if metal is None else BeaconMetal(metal, np.empty(0))
        beacons.append(Beacon(f"b{i}", np.array(corner), axis, 20.0, 0.15, None, 10.0, code=i, metal=of_metal))
    return Site("cube", 0.003, 5, None, SensorSite(2e-8), tuple(beacons), metal=metal)


def _metal(sd_T_A: float = 0.0, walked_m: np.ndarray | None = None) -> Metal:
    walked = np.empty((0, 3)) if walked_m is None else walked_m
    return Metal(np.zeros(3), 1.0, 0, BODY[None], POLARISABILITY[None], sd_T_A, walked)


def _epochs(
    count: int, seed: int, body_m: np.ndarray = BODY, noise_T: float = NOISE_T
) -> tuple[list[Fields], np.ndarray]:
    rng = np.random.default_rng(seed)
    position = rng.uniform(0.4, 1.6, (count, 3))
    turn = Rotation.random(count, rng=rng)
    columns = []
    for beacon in _site(None).beacons:
        coil = magpylib.current.Circle(diameter=0.3, current=200.0)
        coil.rotate(Rotation.align_vectors(beacon.axis[None], np.array([[0.0, 0.0, 1.0]]))[0])
        coil.position = beacon.position_m
        answer = magpylib.misc.Dipole(moment=POLARISABILITY @ coil.getB(body_m), position=body_m)
        columns.append((coil.getB(position) + answer.getB(position)).reshape(-1, 3))
    field = np.stack(columns, axis=1)
    measured = np.einsum("eji,enj->eni", turn.as_matrix(), field) + noise_T * rng.normal(size=field.shape)
    names = tuple(f"b{i}" for i in range(8))
    return [Fields(e, 0.1 * e, names, measured[e], np.full(8, NOISE_T)) for e in range(count)], position


def _errors(site: Site, epochs: list[Fields], position: np.ndarray) -> np.ndarray:
    poses = Locator(site).locate_many(epochs)
    return np.array([np.linalg.norm(pose.position_m - true) for pose, true in zip(poses, position, strict=True)])


def test_metal_that_is_known_does_no_harm() -> None:
    """With the body described the poses reach what noise alone allows; without it they are centimetres off."""
    epochs, position = _epochs(60, 1)
    known, unknown = (_errors(_site(metal), epochs, position) for metal in (_metal(), None))
    poses = Locator(_site(_metal())).locate_many(epochs)
    assert all(pose.status is Status.OK for pose in poses)
    nees = [
        (pose.position_m - true) @ np.linalg.solve(pose.position_cov_m2, pose.position_m - true) / 3.0
        for pose, true in zip(poses, position, strict=True)
    ]
    assert 0.7 < np.mean(nees) < 1.35  # 180 degrees of freedom: 3 sigma are 0.32
    assert np.median(unknown) > 10.0 * np.median(known)


def test_what_is_left_of_the_metal_widens_the_covariance() -> None:
    (fields,), _ = _epochs(1, 2)
    exact, unsure = (Locator(_site(_metal(sd))).locate(fields) for sd in (0.0, 3.0 * NOISE_T / 10.0))
    ratio = np.trace(unsure.position_cov_m2) / np.trace(exact.position_cov_m2)
    assert ratio == pytest.approx(10.0, rel=0.02)  # 1 + 3^2


def test_outside_the_walked_room_nothing_is_verified() -> None:
    epochs, position = _epochs(40, 3)
    corners = np.array(list(itertools.product((0.0, 1.0), (0.0, 2.0), (0.0, 2.0))))
    poses = Locator(_site(_metal(walked_m=corners))).locate_many(epochs)
    for pose, true in zip(poses, position, strict=True):
        if abs(true[0] - 1.0) < 0.01:
            continue
        outside = true[0] > 1.0
        assert pose.status is (Status.UNVERIFIED if outside else Status.OK)
        assert np.isinf(pose.protection_m) == outside
        assert ("outside the room in which the metal was learned" in (pose.reason or "")) == outside
    assert 10 <= int((position[:, 0] > 1.0).sum()) <= 30


def test_a_site_with_the_same_metal_elsewhere_is_another() -> None:
    """The body's place matters: 30 cm off, the fields no longer fit."""
    epochs, position = _epochs(20, 4)
    moved = replace(_metal(), body_m=BODY[None] + [0.0, 0.3, 0.0])
    there, elsewhere = (_errors(_site(metal), epochs, position) for metal in (_metal(), moved))
    assert np.median(elsewhere) > 3.0 * np.median(there)
    suspected = [pose.status is not Status.OK or pose.excluded for pose in Locator(_site(moved)).locate_many(epochs)]
    assert np.mean(suspected) > 0.9


@pytest.mark.parametrize("method", [Method.EACH, Method.TRACK])
@pytest.mark.parametrize("moved_m", [0.0, 0.02, 0.1])
def test_metal_that_was_moved_since_is_said_within_ten_seconds(moved_m: float, method: Method) -> None:
    """The first epochs are those of the survey's room; in a place at rest, since the history of a track is told."""
    before, _ = _epochs(1, 5, noise_T=0.0)
    after, _ = _epochs(1, 5, BODY + np.array([0.0, moved_m, 0.0]), noise_T=0.0)
    rng = np.random.default_rng(6)
    locate = location(_site(_metal()), method)
    said = []
    for e in range(200):
        still = (before if e < 100 else after)[0]
        field = still.field_T + NOISE_T * rng.normal(size=still.field_T.shape)
        fields = replace(still, epoch=e, time_s=0.1 * e, field_T=field)
        pose = locate(fields, None)
        word = pose.status is Status.INCONSISTENT or bool(pose.excluded or pose.findings)
        said.append(pose.reason or "" if word else None)
    assert said[:100] == [None] * 100
    words = [word for word in said[100:] if word is not None]
    assert bool(words) == (moved_m > 0.0)
    if moved_m == 0.02:
        assert any("or metal was moved since it was learned" in word for word in words)


def test_a_sensor_that_computes_its_own_pose_knows_no_metal() -> None:
    with pytest.raises(UserError, match=r"does not know what metal adds to the fields \(\[metal\] of the site file\)"):
        Options(method=Method.ON_SENSOR).check(_site(_metal()))
    Options(method=Method.ON_SENSOR).check(_site(None))
