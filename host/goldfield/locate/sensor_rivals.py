"""Rival explanations of an epoch by the sensor or the whole site: mirrored, stronger, distorted, in other units.

All of them are b = S R'B(p) with a symmetric S, since any matrix is a symmetric one times a turn: S = -1 is a
left-handed sensor or reversed coils, S = f one gain or one factor in all currents, S = 1 + g e e' the gain of the axis
e, any other S a sensor with iron beside it or with axes that are not square. A site in other units of length is
S = f as well: a loop's field depends on position over radius, and on the inverse of the radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.locate import sentences
from goldfield.locate.chances import chdtri, probability
from goldfield.locate.constellation import SECOND_EVALUATIONS, Constellation
from goldfield.locate.distorted import Distorted, fit_distorted
from goldfield.locate.fault_statistics import DISTORTIONS
from goldfield.locate.fit import Fit, Measurements
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

GAUSS, ABOUT_GAUSS = 1e4, 0.05
"""Gauss in a tesla, and the relative difference of a factor from that: no unit of length has one near it."""

NEARLY, FAR_FROM_ONE = 0.02, 2.0
"""One factor of all fields is told, though it does not explain them within the noise, if it leaves less than this part
of the cost and is larger than the second or smaller than its reciprocal: fields and noise may be in different units."""

SAME_FACTOR = 0.01
"""Relative difference of a factor from that of a unit that may be noise."""

FACTORS = np.concatenate(
    [np.geomspace(0.1, 10.0, 13), *([size, 1.0 / size, size**3, size**-3] for size in UNITS.values())]
)
"""Factors of all fields from which the search for the right one starts."""

STARTS = 4
"""Best starts that are fitted with a distortion."""

MOST_UNEQUAL = 10.0
"""Gains in a greater ratio than this are no sensor's, unless one of its axes is silent."""

SILENT = 4.0
"""An axis is silent if its components have a root mean square below this many standard deviations."""

ROUGHNESS = 0.1
"""Model error of the fit that finds the best of them: it compares poses that are nearly right."""

ROUGH_ITERATIONS = 10
"""Evaluations of that fit."""


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


@dataclass(frozen=True, eq=False)
class SensorRivals:
    """What was found of the sensor and the whole site.

    Attributes
    ----------
    explaining : list of SensorRival
        What explains the epoch, the best score first.
    factor : Distorted or None
        The best pose by one factor of all fields, which need not explain them, from anywhere and from the first of the
        given poses; None if it was not sought anywhere.
    """

    explaining: list[SensorRival]
    factor: Distorted | None = None


def mirrored(constellation: Constellation, measurements: Measurements, cost: float, margin: float) -> Finding | None:
    """Search one epoch's pose from the negated fields; a finding if they fit and cost less by ``margin``."""
    negated = measurements.of_fields(-measurements.field_T)
    best = constellation.solve(negated, SECOND_EVALUATIONS, at_any_cost=False).best
    if not (probability(best.cost, measurements.freedom)[0] > EXPLAINS and best.cost[0] + margin < cost):
        return None
    return Finding(Explanation.MIRRORED, (), sentences.MIRRORED, factor=-1.0)


def sensor_rivals(
    constellation: Constellation, measurements: Measurements, poses: Fit, *, anywhere: bool = True
) -> SensorRivals:
    """Seek what explains one epoch by the sensor or the whole site.

    Parameters
    ----------
    poses : Fit
        Poses to start from: those of the fields as they are, with whatever beacons.
    anywhere : bool
        Whether to start from the best poses by any factor of all fields, too.
    """
    heard = int(measurements.known.sum())
    if heard < LEAST_FOR_ONE_FACTOR or not measurements.complete:
        return SensorRivals([])
    model = constellation.model
    position, rotation = _starts(constellation, measurements, poses) if anywhere else _given(poses)
    factors = fit_distorted(model, measurements, position, rotation, basis=DISTORTIONS[:1])
    factor = factors.best()
    found = [_rival(measurements, factor, 1, 1)]
    if heard >= LEAST_FOR_ANY:
        whole = fit_distorted(model, measurements, position, rotation, basis=DISTORTIONS).best()
        any_distortion = _rival(measurements, whole, len(DISTORTIONS), 1)
        plausible = any_distortion is not None and _plausible(measurements, whole)
        found.append(any_distortion if plausible else None)
        for axis in np.eye(3) if plausible else []:
            # From the pose of any distortion, which is near that of the right one.
            other, along = np.diag(1.0 - axis), np.outer(axis, axis)[None]
            gain = fit_distorted(model, measurements, whole.position_m, whole.rotation, basis=along, fixed=other)
            found.append(_rival(measurements, gain, 1, 3))
    explaining = sorted((rival for rival in found if rival is not None), key=lambda rival: rival.score)
    return SensorRivals(explaining, factors.best(among=STARTS + 1) if anywhere else None)


def nearly_one_factor(
    constellation: Constellation, measurements: Measurements, poses: Fit, fitted: Distorted | None
) -> Finding | None:
    """Return the factor of all fields that explains most of one epoch though not all of it, if there is one.

    Parameters
    ----------
    poses : Fit
        The best poses of the fields as they are.
    fitted : Distorted or None
        The best pose by one factor, if it is known.
    """
    if int(measurements.known.sum()) < LEAST_FOR_ONE_FACTOR or not measurements.complete:
        return None
    if fitted is None:
        position, rotation = _starts(constellation, measurements, poses)
        fitted = fit_distorted(constellation.model, measurements, position, rotation, basis=DISTORTIONS[:1]).best()
    factor = float(fitted.distortion[0, 0, 0])
    if not fitted.cost[0] < NEARLY * poses.cost[0] or 1.0 / FAR_FROM_ONE < factor < FAR_FROM_ONE:
        return None
    told = _factor(factor)
    return Finding(told.kind, (), sentences.nearly(told.text), factor=factor)


def _plausible(measurements: Measurements, fitted: Distorted) -> bool:
    """Tell whether a distortion is one that a sensor may have: five beacons often agree with some other."""
    gain = np.abs(np.linalg.eigvalsh(fitted.distortion[0]))
    whitened = measurements.filled_T[0] / measurements.sigma_T[0][:, None]
    silent = (whitened**2).sum(axis=0) < SILENT**2 * measurements.known.sum()
    return bool(gain.max() < MOST_UNEQUAL * gain.min() or silent.any())


def _starts(constellation: Constellation, measurements: Measurements, poses: Fit) -> tuple[FloatArray, FloatArray]:
    """Return positions and attitudes to start from: those given, and the best by any factor of all fields."""
    repeated = measurements.take(np.zeros(len(FACTORS), dtype=np.intp))
    scaled = repeated.of_fields(repeated.field_T / FACTORS[:, None, None], 1.0 / FACTORS[:, None])
    position, rotation = constellation.starts(scaled)
    rough = fit_distorted(
        constellation.model,
        measurements,
        position,
        rotation,
        basis=DISTORTIONS[:1],
        model_error=ROUGHNESS,
        iterations=ROUGH_ITERATIONS,
    ).best(STARTS)
    position, rotation = _given(poses)
    return np.concatenate([rough.position_m, position]), np.concatenate([rough.rotation, rotation])


def _given(poses: Fit) -> tuple[FloatArray, FloatArray]:
    """Return positions and attitudes of the first of some poses."""
    some = np.flatnonzero(np.isfinite(poses.cost))[:STARTS]
    return poses.position_m[some], poses.rotation[some]


def _rival(measurements: Measurements, fitted: Distorted, unknowns: int, tried: int) -> SensorRival | None:
    """Judge a fit: None if it does not explain the epoch."""
    freedom = np.maximum(measurements.freedom - unknowns, 0)
    if not probability(fitted.cost, freedom)[0] > EXPLAINS:
        return None
    cost = float(fitted.cost[0])
    score = cost + float(chdtri(float(unknowns), BY_CHANCE / tried))
    return SensorRival(_named(fitted.distortion[0], unknowns, tried), cost, score)


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
    if abs(np.log(factor / GAUSS)) < ABOUT_GAUSS:
        return Finding(Explanation.UNITS, (), sentences.gauss(factor), factor=factor)
    for unit, size in UNITS.items():
        # Radii in the same units: the field goes with 1/length; radii in metres: with 1/length^3.
        for power, what in ((1, "positions and radii"), (3, "positions")):
            for said, real in ((unit, "metres"), ("metres", unit)):
                scale = size**power if said == "metres" else size**-power
                if abs(np.log(factor / scale)) < SAME_FACTOR:
                    return Finding(Explanation.UNITS, (), sentences.units(what, said, real, factor), factor=factor)
    return Finding(Explanation.STRENGTH, (), sentences.strength(factor), factor=factor)
