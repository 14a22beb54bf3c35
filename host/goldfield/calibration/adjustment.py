"""The least squares behind a sensor's calibration: sensor, earth's field, beacons' errors, and a pose a cycle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.calibration.turn import Turn, smear
from goldfield.field import FieldModel
from goldfield.locate.rotations import orthonormal, skew, turned
from goldfield.locate.site_errors import SiteErrors, effects_of_beacons
from goldfield.site import Site
from goldfield.types import FloatArray

AXES_SD = 0.3
"""Standard deviation of each element of the sensor's matrix before anything was measured."""
OF_BEACON = 10
"""Errors of a beacon: place (3), turn (3), current, in standard deviations of the site's survey; then what is added to
its field all the time (3), in `Adjustment.constant_T`."""
SENSOR = 12
"""Unknowns that are no beacon's and no cycle's: six of the axes, the offset, the earth's field."""
PROBE_T = 1e-9
"""Unit in which the size of constant parts is sought; it stands for no size of its own."""
ROUNDS, TOLERANCE = 30, 1e-4
"""Most steps, and the gain in chi-square below which they end."""
CHUNK = 100
"""Cycles whose Jacobians are in memory at once."""
UPPER = np.triu_indices(3)


@dataclass(frozen=True, eq=False)
class State:
    """All unknowns: k cycles, n beacons.

    Attributes
    ----------
    axes : ndarray, shape (3, 3)
        Upper triangular.
    offset_T, earth_T : ndarray, shape (3,)
        Sensor's and site's frame.
    beacons : ndarray, shape (n, 10)
        Errors in standard deviations, as of `effects_of_beacons`, then those of the constant part.
    position_m : ndarray, shape (k, 3)
    rotation : ndarray, shape (k, 3, 3)
    """

    axes: FloatArray
    offset_T: FloatArray
    earth_T: FloatArray
    beacons: FloatArray
    position_m: FloatArray
    rotation: FloatArray

    @staticmethod
    def at_poses(axes: FloatArray, position_m: FloatArray, rotation: FloatArray, beacons: int) -> State:
        """Return a start from poses, with the sensor as it is known, and an exact site."""
        return State(axes, np.zeros(3), np.zeros(3), np.zeros((beacons, OF_BEACON)), position_m, rotation)

    def with_earth(self, mean_T: FloatArray) -> State:
        """Return the state with offset and earth's field from the cycles' means, shape (k, 3), NaN where unknown."""
        known = np.isfinite(mean_T).all(axis=1)
        if not known.any():
            return self
        seen = self.axes @ np.swapaxes(self.rotation[known], 1, 2)
        columns = np.concatenate([seen, np.tile(np.eye(3), (known.sum(), 1, 1))], axis=2)
        solution = np.linalg.lstsq(columns.reshape(-1, 6), mean_T[known].ravel(), rcond=None)[0]
        return replace(self, earth_T=solution[:3], offset_T=solution[3:])

    def take(self, rows: NDArray[np.bool_]) -> State:
        """Return the state of some of the cycles."""
        return replace(self, position_m=self.position_m[rows], rotation=self.rotation[rows])

    def stepped(self, common: FloatArray, each: FloatArray) -> State:
        """Return the state after a step of the common unknowns, and of each pose: place, then turn, shape (k, 6)."""
        axes = self.axes.copy()
        axes[UPPER] += common[:6]
        return State(
            axes,
            self.offset_T + common[6:9],
            self.earth_T + common[9:12],
            self.beacons + common[SENSOR:].reshape(-1, OF_BEACON),
            self.position_m + each[:, :3],
            orthonormal(turned(self.rotation, each[:, 3:])),
        )


@dataclass(frozen=True, eq=False)
class _Normal:
    """The normal equations, the poses eliminated: cost, and what back-substitution needs."""

    cost: float
    common: FloatArray
    right: FloatArray
    pose: FloatArray
    mixed: FloatArray
    pose_right: FloatArray


@dataclass(frozen=True, eq=False)
class Adjustment:
    """The residuals of a recording, and their minimum; `adjustment_of` makes one.

    Attributes
    ----------
    model : FieldModel
    errors : SiteErrors
        Deviations of the beacons.
    axes : ndarray, shape (3, 3)
        About what the sensor's matrix is.
    turn : Turn
        Each cycle with a pose.
    smear : ndarray, shape (k, 3, 3)
        What turning leaves of the mean of each cycle.
    constant_T : float
        Standard deviation of what is added to each component of a beacon's field all the time, in the site's frame.
        The mains do it where a cycle is a whole number of their periods: what they leave in a beacon's correlation is
        then the same in each cycle, and looks like another gain.
    """

    model: FieldModel
    errors: SiteErrors
    axes: FloatArray
    turn: Turn
    smear: FloatArray
    constant_T: float = 0.0

    @property
    def knows_mean(self) -> bool:
        """Whether the recording tells the mean field of its cycles."""
        return bool(np.isfinite(self.turn.mean_T).all(axis=1).any())

    def at_rates(self, rotation: FloatArray) -> Adjustment:
        """Return the adjustment with the angular rates that attitudes, shape (k, 3, 3), tell."""
        return replace(self, smear=smear(self.turn, rotation))

    def take(self, rows: NDArray[np.bool_]) -> Adjustment:
        """Return the adjustment of some of the cycles."""
        return replace(self, turn=self.turn.take(rows), smear=self.smear[rows])

    def with_mean_noise(self, state: State) -> Adjustment:
        """Return the adjustment with the noise that the means have: other fields than the earth's are in them, too."""
        if not self.knows_mean:
            return self
        residual = np.concatenate([self._residuals(state, rows)[0][:, -1] for rows in self._chunks(state)])
        larger = max(1.0, float(np.sqrt(np.nanmean(residual**2))))
        return replace(self, turn=replace(self.turn, mean_sigma_T=self.turn.mean_sigma_T * larger))

    def with_constants(self, state: State) -> Adjustment:
        """Return the adjustment with the size of constant parts that the residuals of a solution without them tell.

        Let s be the derivative of half the cost by the constant parts of one unit, and K its covariance for white
        noise, all else unknown eliminated. With constant parts of deviation d it is K + d^2 K K, so that s' K^-1 s has
        the mean rank + d^2 trace K, the noise being that of the residuals.
        """
        probe = replace(self, constant_T=PROBE_T)
        normal = probe._normal(state, robust=False)
        reduced, right, _ = probe._reduced(normal, 0.0)
        size = len(right)
        constant = (np.arange(size) >= SENSOR) & ((np.arange(size) - SENSOR) % OF_BEACON >= OF_BEACON - 3)
        reduced[constant, constant] -= 1.0  # the prior of the probe
        scale = 1.0 / np.sqrt(np.maximum(np.diag(reduced), 1e-300))
        unit, right = scale[:, None] * reduced * scale, scale * right
        across = unit[np.ix_(constant, ~constant)] @ np.linalg.pinv(unit[np.ix_(~constant, ~constant)], rcond=1e-12)
        known = unit[np.ix_(constant, constant)] - across @ unit[np.ix_(~constant, constant)]
        score = right[constant] - across @ right[~constant]
        value, vector = np.linalg.eigh(known)
        some = value > 1e-6
        noise2 = max(1.0, self.residual(state)) ** 2
        excess = float(((vector.T @ score)[some] ** 2 / value[some]).sum()) / noise2 - int(some.sum())
        information = float((value[some] @ (vector[:, some] ** 2).T / scale[constant] ** 2).sum())
        return replace(self, constant_T=PROBE_T * float(np.sqrt(max(excess, 0.0) / information)))

    # ---- Residuals ----

    def _chunks(self, state: State) -> list[slice]:
        return [slice(first, first + CHUNK) for first in range(0, len(state.rotation), CHUNK)]

    def _residuals(self, state: State, rows: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return whitened residuals, shape (k, n + 1, 3), and their derivatives by common unknowns and by poses.

        The last row of a cycle is that of its mean. A value that was not measured has zeros.
        """
        turn, beacons = self.turn, len(self.model)
        position = state.position_m[rows]
        evaluated = self.model.evaluate(position.T)
        effect, field = effects_of_beacons(self.model, self.errors, position, evaluated)
        constant = np.broadcast_to(self.constant_T * np.eye(3), (*effect.shape[:2], 3, 3))
        effect = np.concatenate([effect, constant], axis=3)
        gradient = evaluated[1].transpose(2, 3, 0, 1)
        field = field + np.einsum("kncs,ns->knc", effect, state.beacons)
        field = np.concatenate([field, np.broadcast_to(state.earth_T, (len(field), 1, 3))], axis=1)
        to_sensor = np.swapaxes(state.rotation[rows], 1, 2)
        smeared = self.smear[rows] @ to_sensor
        seen = np.einsum("kij,knj->kni", smeared, field)
        reading = seen @ state.axes.T
        reading[:, -1] += state.offset_T
        measured = np.concatenate([turn.field_T[rows], turn.mean_T[rows, None]], axis=1)
        sigma = np.concatenate([turn.sigma_T[rows], np.full((len(field), 1), turn.mean_sigma_T)], axis=1)[..., None]
        known = np.isfinite(measured) & np.isfinite(sigma)
        weight = np.where(known, 1.0 / sigma, 0.0)
        residual = np.where(known, measured - reading, 0.0) * weight

        whole = state.axes @ smeared
        common = np.zeros((*reading.shape, SENSOR + OF_BEACON * beacons))
        for number, (row, column) in enumerate(zip(*UPPER, strict=True)):
            common[..., row, number] = seen[..., column]
        common[:, -1, :, 6:9] = np.eye(3)
        common[:, -1, :, 9:12] = whole
        of_beacons = np.einsum("kij,knjs->knis", whole, effect)
        for beacon in range(beacons):
            begin = SENSOR + OF_BEACON * beacon
            common[:, beacon, :, begin : begin + OF_BEACON] = of_beacons[:, beacon]
        pose = np.zeros((*reading.shape, 6))
        pose[:, :-1, :, :3] = np.einsum("kij,knjc->knic", whole, gradient)
        pose[..., 3:] = np.einsum("kij,knjc->knic", whole, skew(field))  # R turned by w: R' B changes by R' [B]x w
        return residual, common * weight[..., None], pose * weight[..., None]

    def chi_squares(self, state: State) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the sum of squares of each cycle, shape (k,), and its number of values beyond the pose's six."""
        parts = [self._residuals(state, rows)[0] for rows in self._chunks(state)]
        squares = np.concatenate([(part**2).sum(axis=(1, 2)) for part in parts])
        measured = np.isfinite(self.turn.field_T).sum(axis=(1, 2)) + np.isfinite(self.turn.mean_T).sum(axis=1)
        return squares, np.maximum(measured - 6, 1)

    def residual(self, state: State) -> float:
        """Return the root mean square of the residuals over their noise."""
        chi2, count = self.chi_squares(state)
        return float(np.sqrt(chi2.sum() / count.sum()))

    # ---- Solution ----

    def _normal(self, state: State, robust: bool) -> _Normal:
        size = SENSOR + OF_BEACON * len(self.model)
        common, right = np.zeros((size, size)), np.zeros(size)
        cost, poses, mixeds, rights = 0.0, [], [], []
        for rows in self._chunks(state):
            residual, by_common, by_pose = self._residuals(state, rows)
            count = len(residual)
            residual = residual.reshape(count, -1)
            by_common, by_pose = by_common.reshape(count, -1, size), by_pose.reshape(count, -1, 6)
            chi2 = (residual**2).sum(axis=1)
            scale = 2.0 * residual.shape[1]
            # The weight and cost of Cauchy's loss of a whole cycle.
            weight = 1.0 / (1.0 + chi2 / scale) if robust else np.ones(count)
            cost += float((scale * np.log1p(chi2 / scale) if robust else chi2).sum())
            root = np.sqrt(weight)[:, None, None]
            by_common, by_pose, residual = root * by_common, root * by_pose, root[..., 0] * residual
            flat = by_common.reshape(-1, size)
            common += flat.T @ flat
            right += flat.T @ residual.ravel()
            across = np.swapaxes(by_pose, 1, 2)
            poses.append(across @ by_pose)
            mixeds.append(across @ by_common)
            rights.append((across @ residual[..., None])[..., 0])
        prior, pull = self._prior(state)
        cost += float(pull @ (prior * pull))
        np.fill_diagonal(common, np.diag(common) + prior)
        parts = (np.concatenate(part) for part in (poses, mixeds, rights))
        pose, mixed, pose_right = parts
        return _Normal(cost, common, right - prior * pull, pose, mixed, pose_right)

    def _prior(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Return the weights of the common unknowns before anything was measured, and how far they are from it."""
        off = np.concatenate([(state.axes - self.axes)[UPPER], state.offset_T, state.earth_T, state.beacons.ravel()])
        weight = np.ones_like(off)
        weight[:6] = 1.0 / AXES_SD**2
        weight[6:SENSOR] = 0.0 if self.knows_mean else 1.0
        return weight, off

    def solve(self, state: State, *, robust: bool) -> State:
        """Return the state of least cost, from a start near it."""
        normal, damping = self._normal(state, robust), 1e-6
        for _ in range(ROUNDS):
            common, each = self._step(normal, damping)
            if not (np.isfinite(common).all() and np.isfinite(each).all()):
                break
            trial = state.stepped(common, each)
            after = self._normal(trial, robust)
            if after.cost <= normal.cost:
                gained = normal.cost - after.cost
                state, normal, damping = trial, after, max(0.1 * damping, 1e-12)
                if gained < TOLERANCE:
                    break
            elif damping > 1e6 or float(np.abs(common).max()) < 1e-12:
                break
            else:
                damping = max(10.0 * damping, 1e-4)
        return state

    def _reduced(self, normal: _Normal, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the equations of the common unknowns, their right side, and the inverses of the poses' blocks."""
        diagonal = np.einsum("kii->ki", normal.pose)
        damped = normal.pose + damping * diagonal[:, :, None] * np.eye(6)
        inverse = np.linalg.pinv(damped, rcond=1e-13, hermitian=True)
        solved = inverse @ normal.mixed
        size = normal.common.shape[0]
        left = normal.common + damping * np.diag(np.diag(normal.common))
        reduced = left - normal.mixed.reshape(-1, size).T @ solved.reshape(-1, size)
        right = normal.right - np.einsum("kpg,kp->g", solved, normal.pose_right)
        return reduced, right, inverse

    def _step(self, normal: _Normal, damping: float) -> tuple[FloatArray, FloatArray]:
        """Return the step of the common unknowns and of the poses; NaN where the equations have overflowed."""
        reduced, right, inverse = self._reduced(normal, damping)
        if not np.isfinite(reduced).all():
            return np.full_like(right, np.nan), np.full_like(normal.pose_right, np.nan)
        size = np.sqrt(np.maximum(np.diag(normal.common), 1e-300))
        common = np.linalg.lstsq(reduced / np.outer(size, size), right / size, rcond=1e-14)[0] / size
        rest = normal.pose_right - normal.mixed @ common
        return common, np.asarray((inverse @ rest[..., None])[..., 0])

    def covariance(self, state: State) -> FloatArray:
        """Return the covariance of axes (6), offset (3) and earth's field (3), all else unknown too."""
        reduced, _, _ = self._reduced(self._normal(state, robust=False), 0.0)
        size = np.sqrt(np.maximum(np.diag(reduced), 1e-300))
        inverse = np.linalg.pinv(reduced / np.outer(size, size), rcond=1e-14, hermitian=True)
        return np.asarray((inverse / np.outer(size, size))[:SENSOR, :SENSOR])


def adjustment_of(site: Site, turn: Turn, axes: FloatArray) -> Adjustment:
    """Return the adjustment of a recording on a site, with axes of about this matrix, at rest in each cycle."""
    surveys = [beacon.survey for beacon in site.beacons]
    errors = SiteErrors(
        np.array([survey.position_sd_m for survey in surveys]),
        np.array([survey.axis_sd_rad for survey in surveys]),
        np.array([survey.current_sd for survey in surveys]),
        0.0,
        0.0,
    )
    return Adjustment(FieldModel(site.beacons), errors, axes, turn, np.tile(np.eye(3), (len(turn), 1, 1)))
