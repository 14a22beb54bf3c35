"""Poses afterwards: how far a sensor on a surveyed site is off, and how far it must be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.survey.equations import derivatives
from goldfield.survey.outcome import Solution
from goldfield.survey.parameters import beacons_of, matrix_of
from goldfield.survey.problem import axes_of
from goldfield.types import FloatArray
from tests.bench.integrity_sites import sigma_of
from tests.bench.survey_trials import Room, Trial, fields_of, measured, walk

POSES = 50


@dataclass(frozen=True)
class PoseScore:
    """Squares of errors of position, m^2, means over the poses: the real ones, and what they must be at the least."""

    square_m2: float
    bound_m2: float
    lost: int


def poses_afterwards(room: Room, truth: Trial, solution: Solution, found: Locator, seed: int) -> PoseScore:
    """Lead the sensor through the room once more, and locate it with the surveyed site.

    Parameters
    ----------
    room, truth
        Where it moves, and what is true.
    solution : Solution
        The survey.
    found : Locator
        That of the surveyed site.
    seed : int
    """
    rng = np.random.default_rng([seed, 1])
    position, rotation = walk(room, rng, POSES)
    sigma = sigma_of(truth.site)
    field = measured(truth.coils, position, rotation, truth.sensor, sigma, rng)
    poses = found.locate_many(fields_of(tuple(beacon.id for beacon in truth.site.beacons), field, sigma))
    place = np.array([pose.position_m for pose in poses])
    have = np.isfinite(place).all(axis=1)
    square = ((place - position)[have] ** 2).sum(axis=1)
    bound = _bound(solution, field, sigma, position, rotation.swapaxes(1, 2))[have]
    return PoseScore(float(square.mean()), float(bound.mean()), int((~have).sum()))


def _bound(
    solution: Solution, field_T: FloatArray, sigma_T: float, position_m: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return the least mean square error of each position, m^2: by noise, and by the survey's whole covariance.

    A reading is J pose + K common + noise, with the common parameters as the survey's covariance has them: the pose
    with the least variance counts all readings of an epoch by the inverse of the covariance that they have together.
    """
    problem, state = solution.problem, solution.state
    model = FieldModel(beacons_of(problem.site, state))
    parts = derivatives(model, state, axes_of(problem.site), field_T, position_m, rotation, matrix_of(state.terms))
    epochs, beacons = field_T.shape[:2]
    common = np.zeros((epochs, beacons, 3, len(solution.covariance)))
    width = parts.beacon.shape[3]
    for i in range(beacons):
        common[:, i, :, width * i : width * (i + 1)] = parts.beacon[:, i]
    common[..., width * beacons :][..., : parts.sensor.shape[3]] = parts.sensor
    by_common = common.reshape(epochs, 3 * beacons, -1) / sigma_T
    by_pose = parts.pose.reshape(epochs, 3 * beacons, 6) / sigma_T
    together = np.eye(3 * beacons) + by_common @ solution.covariance @ by_common.swapaxes(1, 2)
    information = by_pose.swapaxes(1, 2) @ np.linalg.solve(together, by_pose)
    return np.asarray(np.trace(np.linalg.inv(information)[:, :3, :3], axis1=1, axis2=2))
