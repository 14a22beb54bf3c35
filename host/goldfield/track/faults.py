"""Whether an epoch of a moving sensor agrees with the site: the tests of `goldfield.locate` on an observation.

An epoch is judged by itself: of what was known before it only the motion is believed (velocity, turn rate and ambient
field), not the pose. A fault that lasts draws the track with it and would hide behind its own past; so it does not.
With that belief the residuals are S nu, nu the innovations and S the inverse of their covariance, and a fault of one
beacon adds a constant vector to its field: r = S nu and the columns F of the three components give its part of the
cost, (F'r)' (F'SF)^-1 (F'r), chi-square with three degrees of freedom. It does not depend on other epochs, so that
histories of it may be added up (`goldfield.track.witness`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from goldfield.locate.fault_statistics import DETECTABLE, FALSE_ALARM
from goldfield.locate.protection import level_of
from goldfield.track.estimate import Belief
from goldfield.track.motion import SIZE, Observation, State
from goldfield.types import FloatArray

UNKNOWNS = 6

WHOLE, SINGLE, SENSOR, STRENGTH = 0.1, 0.6, 0.2, 0.1
"""Parts of the permitted false alarms for the whole cost, for single beacons, for a sensor that distorts all fields
alike (gains and angles of its axes, iron beside it), and for one factor in all fields."""

_SYMMETRIC = np.array(
    [np.diag(row) for row in np.eye(3)]
    + [np.eye(3)[[i]].T @ np.eye(3)[[j]] + np.eye(3)[[j]].T @ np.eye(3)[[i]] for i, j in ((0, 1), (0, 2), (1, 2))]
)
"""The six ways to distort a vector that are no turns; the first three together are one factor."""

VAGUE_POSE = 100.0
"""Standard deviation, m and rad, of what is believed of the pose before the epoch: nothing."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """What an epoch says of each beacon.

    Attributes
    ----------
    beacons : tuple of str
        Ids, in the order of the observation's model.
    cost : float
        Whole cost, chi-square with ``freedom`` degrees of freedom if all beacons are as the site says.
    freedom : int
    drop : ndarray, shape (n,)
        Part of the cost that leaving out the beacon would take away.
    drop_freedom : ndarray of int, shape (n,)
        Its degrees of freedom; 0 where no fault of the beacon can show.
    distortion : tuple of float
        Parts of the cost that a distortion by the sensor, and one factor in all fields, take away; six degrees of
        freedom and one.
    factor : float
        By what the fields are larger than the site says, as far as the epoch tells.
    separation_m, separation_cov_m2 : ndarray, shapes (n, 3) and (n, 3, 3)
        The epoch's position by itself less that without the beacon, and the covariance of this.
    hidden : ndarray of bool, shape (n,)
        Whether some fault of the beacon cannot show.
    score, information : ndarray, shapes (n, 3) and (n, 3, 3)
        F'r and F'SF, of fields in tesla in the sensor's frame.
    observation, state, prior
        What was judged, where, and with what belief.
    """

    beacons: tuple[str, ...]
    cost: float
    freedom: int
    drop: FloatArray
    drop_freedom: NDArray[np.intp]
    distortion: tuple[float, float]
    factor: float
    separation_m: FloatArray
    separation_cov_m2: FloatArray
    hidden: NDArray[np.bool_]
    score: FloatArray
    information: FloatArray
    observation: Observation
    state: State
    prior: Belief

    @property
    def alarm(self) -> bool:
        """Whether the epoch does not agree with the site, at the rate of false alarms of `locate`."""
        limit = _limits(self.freedom, int((self.drop_freedom > 0).sum()))
        return (
            self.cost > limit.whole
            or bool((self.drop > limit.single[self.drop_freedom]).any())
            or self.distortion[0] > limit.sensor
            or self.distortion[1] > limit.strength
        )

    @property
    def residuals(self) -> dict[str, float]:
        """Normalised residual of each beacon that can be judged, near 1 if it is as the site says."""
        return {
            name: float(np.sqrt(drop / freedom))
            for name, drop, freedom in zip(self.beacons, self.drop, self.drop_freedom, strict=True)
            if freedom
        }

    def protection_m(self, position_cov_m2: FloatArray) -> float:
        """Return the radius that the error of a position of this covariance exceeds undetected only rarely.

        It is `goldfield.locate.protection` for the epoch's beacons by themselves: a track of the past protects from a
        new fault, but not from one that lasts. Only the part of the noise is that of the track.
        """
        level, _ = level_of(
            self.separation_m[None], self.separation_cov_m2[None], self.hidden[None], position_cov_m2[None]
        )
        return float(level[0])


def judged(observation: Observation, state: State, prior: Belief) -> Judgement:
    """Judge an epoch.

    Parameters
    ----------
    observation : Observation
    state : State
        The state at the epoch, near which the field is taken as linear.
    prior : Belief
        What was believed before it, of which the motion alone is used.
    """
    observation = observation.around(state)
    residual, jacobian, field = observation.linearised(state)
    before = prior.state
    motion = [
        state.velocity_m_s - before.velocity_m_s,
        state.rate_rad_s - before.rate_rad_s,
        state.ambient_T - before.ambient_T,
    ]
    root = np.zeros((SIZE, UNKNOWNS + prior.root.shape[1]))
    root[:UNKNOWNS, :UNKNOWNS] = VAGUE_POSE * np.eye(UNKNOWNS)
    root[UNKNOWNS:, UNKNOWNS:] = prior.root[UNKNOWNS:]
    spread = jacobian @ root
    factor = np.linalg.cholesky(spread.T @ spread + np.eye(spread.shape[1]))
    half = np.linalg.solve(factor, spread.T)  # S = I - half' half
    innovation = residual + jacobian[:, UNKNOWNS:] @ np.concatenate(motion)
    rest = innovation - half.T @ (half @ innovation)
    columns = _columns(observation)  # (n, 3, rows)
    through = columns @ half.T  # (n, 3, m)
    information = columns @ columns.swapaxes(1, 2) - through @ through.swapaxes(1, 2)
    score = columns @ rest

    size = np.sqrt(np.einsum("ncr,ncr->nc", columns, columns))
    measured = size > 0.0
    size = np.where(measured, size, 1.0)
    gain, vector = np.linalg.eigh(information / (size[:, :, None] * size[:, None, :]))
    seen = gain > DETECTABLE
    safe = np.where(seen, gain, 1.0)
    along = np.einsum("nck,nc->nk", vector, score / size)
    influence = root[:3] @ np.linalg.solve(factor.T, through.swapaxes(1, 2) / size[:, None, :])  # (n, 3, c)
    move = np.where(seen[:, None], influence @ vector / np.sqrt(safe)[:, None], 0.0)
    distortion, strength = _distortion(field, columns, half, rest)
    return Judgement(
        beacons=tuple(beacon.id for beacon in observation.model.beacons),
        cost=float(innovation @ rest),
        freedom=observation.count - UNKNOWNS,
        drop=np.where(seen, along**2 / safe, 0.0).sum(axis=1),
        drop_freedom=seen.sum(axis=1),
        distortion=distortion,
        factor=strength,
        separation_m=np.einsum("npk,nk->np", move, along / np.sqrt(safe)),
        separation_cov_m2=move @ move.swapaxes(1, 2),
        hidden=(seen.sum(axis=1) < measured.sum(axis=1)) | ~measured.any(),
        score=score,
        information=information,
        observation=observation,
        state=state,
        prior=prior,
    )


def _columns(observation: Observation) -> FloatArray:
    """Return what a constant field of each beacon adds to the numbers, by component, shape (n, 3, 3 r)."""
    beacons, nodes = len(observation.model), len(observation.times_s)
    axes, rows = observation.seen.shape[:2]
    constant = observation.seen[:, :, : beacons * nodes].reshape(axes, rows, beacons, nodes).sum(axis=3)
    columns = np.zeros((beacons, axes, axes, rows))
    for axis in range(axes):
        columns[:, axis, axis] = constant[axis].T
    flat = columns.reshape(beacons, axes, axes * rows)
    return flat if observation.mixing is None else flat @ observation.mixing.T


def _distortion(
    in_sensor: FloatArray, columns: FloatArray, half: FloatArray, rest: FloatArray
) -> tuple[tuple[float, float], float]:
    """Return the costs that a distorting sensor, and one factor, take away, and the factor.

    ``in_sensor``, shape (n, 3), are the beacons' fields in the sensor's frame.
    """
    changed = in_sensor @ _SYMMETRIC  # (6, n, 3): the matrices are their own transposes
    ways = changed.reshape(len(changed), -1) @ columns.reshape(-1, columns.shape[2])
    ways = np.vstack([ways, ways[:3].sum(axis=0)])
    through = ways @ half.T
    shown, found = ways @ ways.T - through @ through.T, ways @ rest
    size = np.sqrt((ways * ways).sum(axis=1))
    size = np.where(size > 0.0, size, 1.0)
    gain, vector = np.linalg.eigh((shown / np.outer(size, size))[:6, :6])
    seen = gain > DETECTABLE
    along = vector.T @ (found / size)[:6]
    of_sensor = float((np.where(seen, along, 0.0) ** 2 / np.where(seen, gain, 1.0)).sum())
    if shown[6, 6] <= DETECTABLE * size[6] ** 2:
        return (of_sensor, 0.0), 1.0
    return (of_sensor, float(found[6] ** 2 / shown[6, 6])), 1.0 + float(found[6] / shown[6, 6])


@dataclass(frozen=True)
class _Limits:
    """Chi-squares that sound epochs exceed at the permitted rates; ``single`` by the freedom of the beacon's part."""

    whole: float
    single: FloatArray
    sensor: float
    strength: float


@lru_cache(maxsize=256)
def _limits(freedom: int, beacons: int) -> _Limits:
    whole, single, sensor, strength = (share * FALSE_ALARM for share in (WHOLE, SINGLE, SENSOR, STRENGTH))
    return _Limits(
        float(chdtri(freedom, whole)) if freedom > 0 else np.inf,
        np.append(np.inf, chdtri(np.arange(1.0, 4.0), single / max(beacons, 1))),
        float(chdtri(6.0, sensor)),
        float(chdtri(1.0, strength)),
    )
