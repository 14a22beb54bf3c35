"""Rival explanations of an epoch by the sensor or the whole site: mirrored, stronger, distorted, in other units.

All of them are b = S R'B(p) with a symmetric S, since any matrix is a symmetric one times a turn: S = -1 is a
left-handed sensor or reversed coils, S = f one gain or one factor in all currents, S = 1 + g e e' the gain of the axis
e, any other S a sensor with iron beside it or with axes that are not square. A site in other units of length is
S = f as well: a loop's field depends on position over radius, and on the inverse of the radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from goldfield.field import FieldModel
from goldfield.locate import sentences
from goldfield.locate.constellation import Constellation, probability
from goldfield.locate.fault_statistics import DISTORTIONS
from goldfield.locate.fit import Fit, Measurements, pose_jacobian, stacked
from goldfield.locate.least_squares import Evaluate, State, minimise
from goldfield.locate.rotations import turned
from goldfield.types import Explanation, Finding, FloatArray

EXPLAINS = 1e-5
"""A rival explains an epoch if its cost is not less likely than this."""

BY_CHANCE = 1e-4
"""What a rival may take off the cost by chance counts for nothing: the chi-square of its unknowns at this rate."""

LEAST_FOR_ONE_FACTOR, LEAST_FOR_ANY = 4, 5
"""Beacons needed to tell one factor, and any distortion."""

UNITS = {
    "inches": 0.0254,
    "feet": 0.3048,
    "centimetres": 0.01,
    "millimetres": 0.001,
}
"""Units of length, m, that a file may be in instead of metres."""

SAME_FACTOR = 0.01
"""Relative difference of a factor from that of a unit that may be noise."""

FACTORS = np.concatenate(
    [np.geomspace(0.1, 10.0, 25), *([size, 1.0 / size, size**3, size**-3] for size in UNITS.values())]
)
"""Factors of all fields from which the search for the right one starts."""

STARTS = 4
"""Best starts that are fitted with a distortion."""

SILENT = 4.0
"""An axis whose components have a root mean square below this many standard deviations may be dead."""


@dataclass(frozen=True, eq=False)
class SensorRival:
    """An explanation by the sensor or the whole site, with its cost and what that cost is worth.

    Attributes
    ----------
    finding : Finding
    cost : float
    score : float
        Cost, and what its unknowns may take off it by chance: lower is better.
    """

    finding: Finding
    cost: float
    score: float


def mirrored(constellation: Constellation, measurements: Measurements, cost: float, margin: float) -> Finding | None:
    """Search one epoch's pose from the negated fields; a finding if they fit and cost less by ``margin``."""
    negated = measurements.of_fields(-measurements.field_T)
    best = constellation.solve(negated).best
    if not (probability(best.cost, measurements.freedom)[0] > EXPLAINS and best.cost[0] + margin < cost):
        return None
    return Finding(Explanation.MIRRORED, (), sentences.MIRRORED, factor=-1.0)


def sensor_rivals(constellation: Constellation, measurements: Measurements, poses: Fit) -> list[SensorRival]:
    """Return what explains one epoch by the sensor or the whole site, the best score first.

    Parameters
    ----------
    poses : Fit
        Poses to start from: those of the fields as they are, with whatever beacons.
    """
    heard = int(measurements.known.sum())
    if heard < LEAST_FOR_ONE_FACTOR or not measurements.complete:
        return []
    starts, strengths = _starts(constellation, measurements, poses)
    found = []
    factor = _fitted(constellation.model, measurements, starts, strengths, DISTORTIONS[:1])
    found.append(_rival(measurements, factor, 1, 1))
    if heard >= LEAST_FOR_ANY:
        starts, strengths = _with_dead_axes(constellation, measurements, starts, strengths)
        whole = _fitted(constellation.model, measurements, starts, strengths, DISTORTIONS)
        found.append(_rival(measurements, whole, len(DISTORTIONS), 1))
        if found[-1] is not None:
            for axis in np.eye(3):
                # From the pose of any distortion, which is near that of the right one.
                one = whole.distortion[None] * np.outer(axis, axis) + np.diag(1.0 - axis)
                found.append(
                    _rival(
                        measurements,
                        _fitted(
                            constellation.model,
                            measurements,
                            whole.pose,
                            one,
                            axis[None, :, None] * axis[None, None, :],
                        ),
                        1,
                        3,
                    )
                )
    return sorted((rival for rival in found if rival is not None), key=lambda rival: rival.score)


@dataclass(frozen=True)
class _Distorted:
    """A pose, ``Fit`` of one, with the sensor's distortion S, shape (3, 3), and their cost."""

    pose: Fit
    distortion: FloatArray
    cost: float


def _starts(constellation: Constellation, measurements: Measurements, poses: Fit) -> tuple[Fit, FloatArray]:
    """Return the poses and distortions, shape (s, 3, 3), to start from: those given, and the best by any factor."""
    repeated = measurements.take(np.zeros(len(FACTORS), dtype=np.intp))
    scaled = repeated.of_fields(repeated.field_T / FACTORS[:, None, None], 1.0 / FACTORS[:, None])
    chain = constellation.from_magnitudes(scaled)
    best = np.argsort(np.where(np.isfinite(chain.cost), chain.cost, np.inf))[:STARTS]
    given = np.flatnonzero(np.isfinite(poses.cost))[:STARTS]
    factor = np.concatenate([FACTORS[best], np.ones(len(given))])
    return stacked([chain.take(best), poses.take(given)]), factor[:, None, None] * np.eye(3)


def _with_dead_axes(
    constellation: Constellation, measurements: Measurements, starts: Fit, strengths: FloatArray
) -> tuple[Fit, FloatArray]:
    """Add, for an axis that shows next to nothing, the pose of a sensor without it."""
    whitened = measurements.filled_T[0] / measurements.sigma_T[0][:, None]
    size = np.sqrt((whitened**2).sum(axis=0) / measurements.known.sum())
    silent = np.flatnonzero(size < SILENT)
    if len(silent) != 1:
        return starts, strengths
    field = measurements.field_T.copy()
    field[:, :, silent] = np.nan
    pose = constellation.solve(measurements.of_fields(field)).best
    if not np.isfinite(pose.cost[0]):
        return starts, strengths
    dead = np.eye(3)
    dead[silent, silent] = 0.0
    return stacked([starts, pose]), np.concatenate([strengths, dead[None]])


def _fitted(
    model: FieldModel, measurements: Measurements, starts: Fit, distortion: FloatArray, basis: FloatArray
) -> _Distorted:
    """Fit pose and distortion, S moving along the basis, shape (k, 3, 3), from each start; the best of them."""
    count = len(starts.cost)
    repeated = measurements.take(np.zeros(count, dtype=np.intp))
    end = minimise(
        _distorted_misfit(model, repeated, basis),
        lambda state, step: _retract(state, step, basis),
        (starts.position_m, starts.rotation, distortion),
        iterations=60,
        tolerance=1e-3,
    )
    best = int(np.argmin(np.where(np.isfinite(end.cost), end.cost, np.inf)))
    position, rotation, fitted = (part[best : best + 1] for part in end.state)
    pose = Fit(
        position,
        rotation,
        end.cost[best : best + 1],
        end.normal[best : best + 1, :6, :6],
        end.converged[best : best + 1],
    )
    return _Distorted(pose, fitted[0], float(end.cost[best]))


def _distorted_misfit(model: FieldModel, measurements: Measurements, basis: FloatArray) -> Evaluate:
    weight = measurements.inverse_sigma()
    measured = measurements.filled_T.swapaxes(1, 2)

    def evaluate(state: State, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        position, rotation, distortion = state
        w = weight[rows]
        slope, field = pose_jacobian(model, position)
        back = rotation.swapaxes(1, 2)
        seen = back @ field
        of_pose = (distortion @ back)[:, None] @ slope
        of_distortion = basis @ seen[:, None]
        jacobian = np.concatenate([of_pose, of_distortion], axis=1) * w[:, None]
        residual = (measured[rows] - distortion @ seen) * w
        return residual.reshape(len(rows), -1), jacobian.reshape(len(rows), 6 + len(basis), -1)

    return evaluate


def _retract(state: State, step: FloatArray, basis: FloatArray) -> State:
    position, rotation, distortion = state
    change = np.einsum("ek,kij->eij", step[:, 6:], basis)
    return position + step[:, :3], turned(rotation, step[:, 3:6]), distortion + change


def _rival(measurements: Measurements, fitted: _Distorted, unknowns: int, tried: int) -> SensorRival | None:
    """Judge a fit: None if it does not explain the epoch."""
    freedom = np.maximum(measurements.freedom - unknowns, 0)
    if not probability(np.array([fitted.cost]), freedom)[0] > EXPLAINS:
        return None
    score = fitted.cost + float(chdtri(float(unknowns), BY_CHANCE / tried))
    return SensorRival(_named(fitted.distortion, unknowns, tried), fitted.cost, score)


def _named(distortion: FloatArray, unknowns: int, tried: int) -> Finding:
    if unknowns == 1 and tried == 1:
        return _factor(float(distortion[0, 0]))
    if unknowns == 1:
        axis = int(np.argmax(np.abs(np.diag(distortion) - 1.0)))
        factor = float(distortion[axis, axis])
        return Finding(Explanation.AXIS_GAIN, (), sentences.axis_gain("xyz"[axis], factor), factor=factor)
    if np.linalg.det(distortion) < 0.0:
        return Finding(Explanation.MIRRORED, (), sentences.MIRRORED)
    return Finding(Explanation.SENSOR, (), sentences.distorted(np.asarray(np.linalg.eigvalsh(distortion))))


def _factor(factor: float) -> Finding:
    """Name one factor of all fields: mirrored if it is negative, a unit of length, else a gain."""
    if factor < 0.0:
        return Finding(Explanation.MIRRORED, (), sentences.MIRRORED, factor=factor)
    for unit, size in UNITS.items():
        # Radii in the same units: the field goes with 1/length; radii in metres: with 1/length^3.
        for power, what in ((1, "positions and radii"), (3, "positions")):
            for said, real in ((unit, "metres"), ("metres", unit)):
                scale = size**power if said == "metres" else size**-power
                if abs(np.log(factor / scale)) < SAME_FACTOR:
                    return Finding(Explanation.UNITS, (), sentences.units(what, said, real, factor), factor=factor)
    return Finding(Explanation.STRENGTH, (), sentences.strength(factor), factor=factor)
