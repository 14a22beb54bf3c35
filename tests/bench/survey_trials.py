"""Seeded surveys: a site that is not as its file says, a walk through it, and how near the survey comes to the truth.

The truth's fields are magpylib's, independent of the host's model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from goldfield.site import HalfSpace, Site
from goldfield.site.reading import ASSUMED_AXIS_SD_RAD, ASSUMED_GAIN_SD
from goldfield.survey.data import AnchorFields, KnownPoint, SurveyData, SurveyResult
from goldfield.survey.parameters import BEACON, across, turn_between
from goldfield.types import Fields
from tests.bench.integrity_coils import Coils
from tests.bench.integrity_sites import Errors, told
from tests.bench.locate_trials import CHIPS, ceiling_lattice, loop_beacon, prigge_cube, site_of

FloatArray = NDArray[np.float64]

ASTRAY = Errors(position_m=0.2 / math.sqrt(3.0), axis_rad=math.radians(10.0) / math.sqrt(2.0), current=0.03)
"""How wrong the site's file is: 20 cm, 10 degrees and 3 % as roots of the mean square."""
POINT_SD_M = 0.002
ANCHOR_PLACE_SD_M = 1e-4
"""How far an anchor's sensor stands from the centre of its coil, along each axis, as boards are made."""


@dataclass(frozen=True)
class Room:
    """A room to walk in: the site as it is thought to be, and the box within which the sensor moves."""

    site: Site
    low_m: FloatArray
    high_m: FloatArray


def cube(noise_T: float = 2e-8) -> Room:
    """Return Prigge and How's cube, walked in its inner half."""
    return Room(prigge_cube(noise_T), np.array([0.35, 0.35, 0.25]), np.array([1.8, 1.8, 1.5]))


def lattice(noise_T: float = 2e-8) -> Room:
    """Return 4 x 4 coils under a ceiling at 2.7 m, 3 m apart."""
    beacons = [loop_beacon(4 * i + j, (3.0 * i, 3.0 * j, 2.7)) for i in range(4) for j in range(4)]
    below = HalfSpace(np.array([0.0, 0.0, 2.7]), np.array([0.0, 0.0, -1.0]))
    return Room(site_of(beacons, below, noise_T), np.array([0.3, 0.3, 0.6]), np.array([8.7, 8.7, 1.9]))


def walk(room: Room, rng: np.random.Generator, epochs: int) -> tuple[FloatArray, FloatArray]:
    """Return positions and attitudes of a sensor that a hand leads through a room, ten epochs a second."""
    corners = max(epochs // 20, 4)
    knots = room.low_m + (room.high_m - room.low_m) * rng.uniform(size=(corners, 3))
    time = np.linspace(0.0, 1.0, epochs)
    path = CubicSpline(np.linspace(0.0, 1.0, corners), knots)(time)
    turn = CubicSpline(np.linspace(0.0, 1.0, corners), 1.2 * rng.normal(size=(corners, 3)))(time)
    return np.clip(path, room.low_m - 0.15, room.high_m + 0.15), Rotation.from_rotvec(turn).as_matrix()


@dataclass(frozen=True)
class Trial:
    """A survey to be made, and the truth.

    Attributes
    ----------
    site : Site
        What the file says.
    data : SurveyData
    coils : Coils
        What is true, one row.
    sensor : ndarray, shape (3, 3)
        What the sensor makes of a field.
    position_m, rotation : ndarray
        True poses of the epochs; the rotations take the site's frame to the sensor's.
    corrupted : ndarray of bool, shape (e,)
    """

    site: Site
    data: SurveyData
    coils: Coils
    sensor: FloatArray
    position_m: FloatArray
    rotation: FloatArray
    corrupted: NDArray[np.bool_]


def fields_of(names: tuple[str, ...], field_T: FloatArray, sigma_T: float, first: int = 0) -> tuple[Fields, ...]:
    return tuple(
        Fields(first + e, 0.1 * e, names, values, np.full(len(names), sigma_T)) for e, values in enumerate(field_T)
    )


def measured(
    coils: Coils,
    position_m: FloatArray,
    rotation: FloatArray,
    sensor: FloatArray,
    sigma_T: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return what a sensor reads of the true coils, shape (e, n, 3); ``rotation`` takes the site's frame to its own."""
    many = Coils(
        *(
            np.repeat(part, len(position_m), axis=0)
            for part in (coils.position_m, coils.axis, coils.radius_m, coils.ampere_turns)
        )
    )
    seen = np.einsum("ij,ekj,enk->eni", sensor, rotation.swapaxes(1, 2), many.field(position_m))
    return seen + sigma_T * rng.normal(size=seen.shape)


def trial(
    room: Room,
    seed: int,
    *,
    epochs: int = 600,
    points: int = 10,
    corrupted: float = 0.0,
    errors: Errors = ASTRAY,
    anchors: bool = False,
    anchor_lever_m: float = ANCHOR_PLACE_SD_M,
    levers_told_m: float | None = None,
) -> Trial:
    """Draw a survey: the true site around the file's, a walk, known points in it, and corrupted epochs.

    The sensors of anchors stand ``anchor_lever_m`` from the centres of their coils, root of the mean square along each
    axis; with ``levers_told_m`` that was measured so well.

    A corrupted epoch has one to three beacons with fields of another place and attitude.
    """
    rng = np.random.default_rng(seed)
    site = told(room.site, errors)
    coils = Coils.of(site, 1)
    coils = coils.moved(errors.position_m * rng.normal(size=coils.axis.shape))
    coils = coils.turned(errors.axis_rad * rng.normal(size=coils.axis.shape))
    coils = coils.scaled(np.exp(errors.current * rng.normal(size=coils.radius_m.shape)))
    sensor = np.eye(3) + np.where(np.eye(3, dtype=bool), errors.gain, errors.sensor_axis_rad) * rng.normal(size=(3, 3))
    sigma = site.sensor.noise_T / np.sqrt(CHIPS)
    position, rotation = walk(room, rng, epochs)
    standing = room.low_m + (room.high_m - room.low_m) * rng.uniform(size=(points, 3))
    which = np.linspace(0, epochs - 1, points).round().astype(int) if points else np.empty(0, dtype=int)
    position[which] = standing
    field = measured(coils, position, rotation, sensor, sigma, rng)
    wrong = rng.uniform(size=epochs) < corrupted
    wrong[which] = False
    for e in np.flatnonzero(wrong):
        some = rng.choice(len(site.beacons), size=rng.integers(1, 4), replace=False)
        field[e, some] = field[rng.integers(epochs), some] @ Rotation.random(rng=rng).as_matrix()
    names = tuple(beacon.id for beacon in site.beacons)
    known = tuple(
        KnownPoint(int(e), place + POINT_SD_M * rng.normal(size=3), POINT_SD_M)
        for e, place in zip(which, standing, strict=True)
    )
    witnesses: tuple[AnchorFields, ...] = ()
    if anchors:
        attitudes = Rotation.random(len(names), rng=rng).as_matrix()
        beside = anchor_lever_m * rng.normal(size=(len(names), 3))
        place = coils.position_m[0] + beside
        levers = np.einsum("aij,aj->ai", attitudes, beside)
        seen = measured(coils, place, attitudes, np.eye(3), sigma / np.sqrt(100.0), rng)
        seen[np.arange(len(names)), np.arange(len(names))] = np.nan
        size = np.where(np.eye(3, dtype=bool), ASSUMED_GAIN_SD, ASSUMED_AXIS_SD_RAD)
        gains = np.eye(3) + size * rng.normal(size=(len(names), 3, 3))
        seen = np.einsum("aij,anj->ani", gains, seen)
        witnesses = tuple(
            AnchorFields(name, Fields(a, 0.0, names, seen[a], np.full(len(names), sigma / 10.0)))
            for a, name in enumerate(names)
        )
        if levers_told_m is not None:
            levers = levers + levers_told_m * rng.normal(size=levers.shape)
            witnesses = tuple(
                replace(one, lever_m=lever, lever_sd_m=levers_told_m)
                for one, lever in zip(witnesses, levers, strict=True)
            )
    data = SurveyData(fields_of(names, field, sigma), known, (), witnesses)
    return Trial(site, data, coils, sensor, position, rotation, wrong)


def errors_of(result: SurveyResult, truth: Trial) -> FloatArray:
    """Return how far what was found is from the truth, in the order of the covariance, shape (6 n,).

    The covariance is linear, and fields do not tell how a whole site is turned: without known points that is known to
    degrees only, and the square of a few degrees, as a shift of beacons metres apart, is more than their distances are
    off. The error is therefore the linear effect of the turn of the whole site, which is taken as a rotation vector,
    and what is left once the truth is turned as the site was found. A turn of milliradians makes no difference.
    """
    found = result.site.beacons
    place, true_place = np.array([beacon.position_m for beacon in found]), truth.coils.position_m[0]
    axis, middle = np.array([beacon.axis for beacon in found]), place.mean(axis=0)
    arm, true_arm = place - middle, true_place - true_place.mean(axis=0)
    rotation = Rotation.align_vectors(arm, true_arm)[0]
    vector = rotation.as_rotvec()
    shape = arm - rotation.apply(true_arm)
    turn = turn_between(rotation.apply(truth.coils.axis[0]), axis) + vector
    strength = np.log([b.turns * b.current_A for b in found]) - np.log(truth.coils.ampere_turns[0])
    shift = shape + np.cross(vector, arm) + middle - true_place.mean(axis=0)
    return np.column_stack([shift, np.einsum("nij,nj->ni", across(axis), turn), strength]).ravel()


@dataclass(frozen=True)
class Score:
    """Errors of a survey: roots of the mean square over its beacons (m), and what they should be."""

    rms_m: float
    bound_m: float
    nees: float


def score(result: SurveyResult, truth: Trial) -> Score:
    """Compare a survey with the truth; the normalised square of all errors is per degree of freedom."""
    error = errors_of(result, truth)
    places = np.arange(len(error)).reshape(-1, BEACON)[:, :3].ravel()
    free = np.diag(result.covariance) > 0.0
    part = result.covariance[np.ix_(free, free)]
    scale = 1.0 / np.sqrt(np.diag(part))
    normal = np.linalg.solve(scale[:, None] * part * scale, scale * error[free])
    count = len(places) / 3.0
    return Score(
        float(np.sqrt((error[places] ** 2).sum() / count)),
        float(np.sqrt(np.diag(result.covariance)[places].sum() / count)),
        float((scale * error[free]) @ normal / free.sum()),
    )


__all__ = ["ASTRAY", "ceiling_lattice", "cube", "lattice", "replace", "score", "trial"]
