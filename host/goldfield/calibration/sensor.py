"""Calibration of a sensor that was turned by hand: gains and directions of its axes, and its offset.

The sensor reads A S R' B of a field B: A, upper triangular, are its axes times their gains, R its attitude, and S what
its turning leaves of a cycle's mean (`turn.smear`). The triangle fixes the sensor's frame: z is the third axis, and the
second lies in the plane of y and z. Where the site tells axes already, the frame is theirs: they are A0 Q with Q a
rotation, and A Q is found. Unknown are A, the offset, the earth's field, what the site says wrongly of its
beacons (within its declared deviations), and the pose of every cycle; the poses are eliminated cycle by cycle (Schur),
the rest is solved by Levenberg and Marquardt. The earth's field tells offset and axes up to a scale, the beacons the
scale, as far as their currents and places are known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import rq
from scipy.spatial.transform import Rotation

from goldfield.calibration.adjustment import Adjustment, State, adjustment_of
from goldfield.calibration.turn import Turn
from goldfield.errors import UserError, counted
from goldfield.locate import Locator
from goldfield.site import Site
from goldfield.types import FloatArray

START_GAIN_SD, START_AXIS_SD_RAD = 0.03, 0.03
"""How far an axis may be off while the poses are sought with which the adjustment starts."""
FEWEST_CYCLES = 20
OUTLIER = 12.0
"""A cycle is left out whose residuals, in deviations of its chi-square, are this many too large."""
BAD_FIT = 3.0
"""Largest ratio of the residuals to the noise with which a calibration is still one."""
DEAD = 0.02
"""Gain of an axis, over that of the best, below which it is no axis: a sensor is known to a few per cent before."""
ENOUGH = 5e-3
"""Standard deviation of an axis beyond which the calibration is called weak."""
UPPER = np.triu_indices(3)
"""Rows and columns of the six elements of A."""
GAINS, LEANS = [0, 3, 5], [1, 2, 4]
NAMES = ("gain of x", "lean of x toward y", "lean of x toward z", "gain of y", "lean of y toward z", "gain of z")


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """What was found.

    Attributes
    ----------
    axes : ndarray, shape (3, 3)
        Axis j reads ``axes[j] @ B`` of a field B in the sensor's frame; upper triangular unless the site has ``axes``.
    axes_sd : ndarray, shape (3, 3)
        Standard deviation of each element; 0 below the diagonal of a triangle.
    covariance : ndarray, shape (6, 6)
        Covariance of the elements of the triangle A, row by row.
    relative_sd : float
        Standard deviation of the gains among each other: what the common gain, which the site limits, leaves out.
    offset_T, offset_sd_T : ndarray, shape (3,), or None
        What the axes read where there is no field; None if the recording has no mean fields.
    earth_T : float or None
        Magnitude of the constant field that was found beside the beacons.
    residual : float
        Root mean square of the residuals over their noise.
    cycles, used : int
        Cycles with a pose, and those of them that were used.
    outliers : tuple of int
        Epochs that were left out as they do not fit.
    weak : str or None
        What is known badly, and what to do; None: nothing.
    """

    axes: FloatArray
    axes_sd: FloatArray
    covariance: FloatArray
    relative_sd: float
    offset_T: FloatArray | None
    offset_sd_T: FloatArray | None
    earth_T: float | None
    residual: float
    cycles: int
    used: int
    outliers: tuple[int, ...]
    weak: str | None

    @property
    def gain_sd(self) -> float:
        """Root mean square of the deviations of the gains: for a site's ``gain_sd``."""
        return float(np.sqrt(np.mean(np.diag(self.covariance)[GAINS])))

    @property
    def axis_sd_rad(self) -> float:
        """Root mean square of the deviations of the leaning: for a site's ``axis_sd_rad``, which means six angles."""
        return float(np.sqrt(0.5 * np.mean(np.diag(self.covariance)[LEANS])))


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # the poses of fields that are wrong can run away
def calibrate_sensor(site: Site, turn: Turn) -> SensorCalibration:
    """Calibrate a sensor from the recording of it being turned.

    Parameters
    ----------
    site : Site
        Its deviations say how far the beacons may be off.
    turn : Turn

    Raises
    ------
    UserError
        If there are too few cycles with a pose, or no sensor of three axes explains the recording.
    """
    triangle, frame = _triangle(site.sensor.axes)
    turn, state = _start(site, turn, triangle, frame)
    adjustment = adjustment_of(site, turn, triangle)
    for _ in range(2):  # the second time with the rates of better attitudes
        adjustment = adjustment.at_rates(state.rotation)
        state = adjustment.solve(state, robust=True)
    kept = _fitting(adjustment, state)
    outliers = tuple(turn.epoch[~kept].tolist())
    adjustment, state = adjustment.take(kept), state.take(kept)
    if len(state.rotation) < FEWEST_CYCLES:
        raise UserError(
            f"only {len(state.rotation)} of {len(turn)} cycles fit one sensor: check site file and sensor, record anew"
        )
    adjustment = adjustment.with_mean_noise(state)
    state = adjustment.solve(state, robust=False)
    _check_fit(adjustment.residual(state))
    adjustment = adjustment.with_constants(state)
    state = adjustment.solve(state, robust=False)
    return _result(adjustment, state, frame, len(turn), outliers)


def _triangle(axes: FloatArray | None) -> tuple[FloatArray, FloatArray]:
    """Return the axes that a site tells as an upper triangle and a rotation, ``triangle @ rotation``."""
    if axes is None:
        return np.eye(3), np.eye(3)
    if len(axes) < 3:
        raise UserError(f"a sensor of {counted(len(axes), 'axes')} cannot be calibrated by turning it: it takes three")
    triangle, rotation = rq(axes)
    sign = np.sign(np.diag(triangle))
    sign[0] *= np.linalg.det(rotation) * np.prod(sign)  # left-handed axes: x is negative, and the rotation is none else
    return np.asarray(triangle * sign, dtype=np.float64), np.asarray(sign[:, None] * rotation, dtype=np.float64)


def _start(site: Site, turn: Turn, triangle: FloatArray, frame: FloatArray) -> tuple[Turn, State]:
    """Return the cycles with a pose, and the poses."""
    sensor = replace(
        site.sensor,
        gain_sd=max(site.sensor.gain_sd, START_GAIN_SD),
        axis_sd_rad=max(site.sensor.axis_sd_rad, START_AXIS_SD_RAD),
    )
    poses = Locator(replace(site, sensor=sensor)).locate_many(turn.fields(site))
    found = np.array([bool(np.isfinite(pose.position_m).all()) for pose in poses], dtype=bool)
    if found.sum() < FEWEST_CYCLES:
        raise UserError(
            f"{int(found.sum())} cycles of the recording have a pose, and a calibration needs {FEWEST_CYCLES}: turn "
            "the sensor by hand for a minute where it hears its beacons"
        )
    located = [pose for pose, sound in zip(poses, found, strict=True) if sound]
    rotation = Rotation.from_quat([pose.orientation_xyzw for pose in located]).as_matrix()
    position_m = np.array([pose.position_m for pose in located])
    state = State.at_poses(triangle, position_m, rotation @ frame.T, len(site.beacons))
    return turn.take(found), state.with_earth(turn.take(found).mean_T)


def _fitting(adjustment: Adjustment, state: State) -> NDArray[np.bool_]:
    """Tell of each cycle whether it fits as well as most do, or as well as the noise lets expect."""
    chi2, count = adjustment.chi_squares(state)
    ratio = chi2 / count
    usual = max(1.0, float(np.median(ratio)))
    return np.asarray(ratio < usual * (1.0 + OUTLIER * np.sqrt(2.0 / count)))


def _check_fit(residual: float) -> None:
    """Refuse a fit that leaves too much, before constant parts of the fields could explain it."""
    if residual > BAD_FIT:
        raise UserError(
            f"the best fit leaves {residual:.1f} times the noise: something else is wrong than the sensor's axes (a "
            "beacon that was moved, metal near by, a site file of another room); see goldfield doctor"
        )


def _result(
    adjustment: Adjustment, state: State, frame: FloatArray, cycles: int, outliers: tuple[int, ...]
) -> SensorCalibration:
    residual = adjustment.residual(state)
    size = np.linalg.norm(state.axes, axis=1)
    if not size.min() > DEAD * size.max():
        raise UserError(
            f"axis {'xyz'[int(np.argmin(size))]} of the sensor reads almost nothing of any field: check its wiring"
        )
    covariance = adjustment.covariance(state) * max(1.0, residual) ** 2
    of_axes = covariance[:6, :6]
    effects = np.zeros((3, 3, 6))  # each element of the result by each of the triangle
    for number, (row, column) in enumerate(zip(*UPPER, strict=True)):
        effects[row, :, number] = frame[column]
    axes_sd = np.sqrt(np.einsum("ijp,pq,ijq->ij", effects, of_axes, effects))
    differ = np.eye(3) - 1.0 / 3.0
    relative = differ @ of_axes[np.ix_(GAINS, GAINS)] @ differ
    knows = adjustment.knows_mean
    return SensorCalibration(
        axes=state.axes @ frame,
        axes_sd=axes_sd,
        covariance=of_axes,
        relative_sd=math.sqrt(float(np.trace(relative)) / 3.0),
        offset_T=state.offset_T if knows else None,
        offset_sd_T=np.sqrt(np.diag(covariance)[6:9]) if knows else None,
        earth_T=float(np.linalg.norm(state.earth_T)) if knows else None,
        residual=residual,
        cycles=cycles,
        used=len(state.rotation),
        outliers=outliers,
        weak=_weakness(np.sqrt(np.diag(of_axes)), relative, knows),
    )


def _weakness(sd: FloatArray, relative: FloatArray, knows_mean: bool) -> str | None:
    if math.sqrt(float(np.trace(relative)) / 3.0) > ENOUGH or sd[LEANS].max() > ENOUGH:
        worst = int(np.argmax(sd))
        return (
            f"the {NAMES[worst]} is known to {100.0 * sd[worst]:.2g} % only: turn the sensor further, so that each "
            "axis points up, down and to all sides"
        )
    if sd[GAINS].max() > ENOUGH:
        return (
            f"the common gain is known to {100.0 * sd[GAINS].mean():.2g} % only, as the site's currents and places "
            "are: survey the site, or measure the currents"
        )
    return None if knows_mean else "the offset is not known: a table of fields has no mean fields, a recording has"
