"""Whether an epoch of a moving sensor agrees with the site: the tests of `goldfield.locate` on an observation.

An epoch is judged by itself: of what was known before it only the motion is believed (velocity, turn rate and ambient
field), not the pose. A fault that lasts draws the track with it and would hide behind its own past; so it does not.
With that belief the residuals are S nu, nu the innovations and S the inverse of their covariance, and a fault of one
beacon adds a constant vector to its field: r = S nu and the columns F of the three components give its part of the
cost, (F'r)' (F'SF)^-1 (F'r), chi-square with three degrees of freedom. It does not depend on other epochs, so that
histories of it may be added up (`goldfield.track.witness`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.chances import chdtri
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
    separation_m, separation_cov_m2 : ndarray, shapes (n, 3) and (n, 3, 3)
        The epoch's position by itself less that without the beacon, and the covariance of this.
    hidden : ndarray of bool, shape (n,)
        Whether some fault of the beacon cannot show.
    score, information : ndarray, shapes (n, 3) and (n, 3, 3)
        F'r and F'SF, of fields in tesla in the sensor's frame.
    observation, state, prior
        What was judged, where, and with what belief.
    field_T, gradient_T_m : ndarray, shapes (n, 3) and (n, 3, 3)
        The beacons' fields and gradients that the site lets expect there, as `Observation.linearised` returns them.
    """

    beacons: tuple[str, ...]
    cost: float
    freedom: int
    drop: FloatArray
    drop_freedom: NDArray[np.intp]
    separation_m: FloatArray
    separation_cov_m2: FloatArray
    hidden: NDArray[np.bool_]
    score: FloatArray
    information: FloatArray
    observation: Observation
    state: State
    prior: Belief
    field_T: FloatArray
    gradient_T_m: FloatArray
    _columns: FloatArray
    _half: FloatArray
    _rest: FloatArray

    @cached_property
    def strength(self) -> tuple[float, float]:
        """Part of the cost that one factor in all fields takes away, of one degree of freedom, and the factor.

        The factor is by what the fields are larger than the site says, as far as the epoch tells.
        """
        way = self._ways(_SYMMETRIC[:3].sum(axis=0, keepdims=True))[0]
        through = self._half @ way
        shown, found, whole = float(way @ way - through @ through), float(way @ self._rest), float(way @ way)
        if shown <= DETECTABLE * (whole if whole > 0.0 else 1.0):
            return 0.0, 1.0
        return found**2 / shown, 1.0 + found / shown

    @cached_property
    def distortion(self) -> float:
        """Part of the cost that a distortion by the sensor takes away, of six degrees of freedom."""
        ways = self._ways(_SYMMETRIC)
        through = ways @ self._half.T
        shown, found = ways @ ways.T - through @ through.T, ways @ self._rest
        size = np.sqrt((ways * ways).sum(axis=1))
        size = np.where(size > 0.0, size, 1.0)
        gain, vector = np.linalg.eigh(shown / np.outer(size, size))
        seen = gain > DETECTABLE
        along = vector.T @ (found / size)
        return float((np.where(seen, along, 0.0) ** 2 / np.where(seen, gain, 1.0)).sum())

    def _ways(self, matrices: FloatArray) -> FloatArray:
        """Return what distortions by symmetric matrices, shape (k, 3, 3), add to the numbers, shape (k, 3 r)."""
        changed = self.field_T @ matrices  # (k, n, 3)
        return np.asarray(changed.reshape(len(matrices), -1) @ self._columns.reshape(-1, self._columns.shape[2]))

    @property
    def alarm(self) -> bool:
        """Whether the epoch does not agree with the site, at the rate of false alarms of `locate`."""
        limit = _limits(self.freedom, int((self.drop_freedom > 0).sum()))
        return (
            self.cost > limit.whole
            or bool((self.drop > limit.single[self.drop_freedom]).any())
            # These are parts of the cost and take time: they are not asked for where the whole is no more
            or (self.cost > limit.strength and self.strength[0] > limit.strength)
            or (self.cost > limit.sensor and self.distortion > limit.sensor)
        )

    @property
    def residuals(self) -> dict[str, float]:
        """Normalised residual of each beacon that can be judged, near 1 if it is as the site says."""
        told = zip(self.beacons, self.drop.tolist(), self.drop_freedom.tolist(), strict=True)
        return {name: math.sqrt(drop / freedom) for name, drop, freedom in told if freedom}

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
    residual, jacobian, field, gradient = observation.linearised(state)
    before = prior.state
    motion = [
        state.velocity_m_s - before.velocity_m_s,
        state.rate_rad_s - before.rate_rad_s,
        state.ambient_T - before.ambient_T,
    ]
    root, inverse, half = _belief(prior, jacobian)
    innovation = residual + jacobian[:, UNKNOWNS:] @ np.concatenate(motion)
    rest = innovation - half.T @ (half @ innovation)
    columns = _columns(observation)  # (n, 3, rows)
    through = columns @ half.T  # (n, 3, m)
    information = columns @ columns.swapaxes(1, 2) - through @ through.swapaxes(1, 2)
    score = columns @ rest

    size = np.sqrt((columns * columns).sum(axis=2))
    measured = size > 0.0
    size[~measured] = 1.0
    gain, vector = np.linalg.eigh(information / (size[:, :, None] * size[:, None, :]))
    seen = gain > DETECTABLE
    degrees = seen.sum(axis=1)
    # The eigenvectors over the roots of their eigenvalues, none where nothing shows
    scaled = vector * np.where(seen, 1.0 / np.sqrt(np.where(seen, gain, 1.0)), 0.0)[:, None]
    along = ((score / size)[:, None] @ scaled)[:, 0]
    influence = (root[:3] @ inverse.T) @ through.swapaxes(1, 2) / size[:, None]  # (n, 3, c)
    move = influence @ scaled
    return Judgement(
        beacons=tuple(beacon.id for beacon in observation.model.beacons),
        cost=float(innovation @ rest),
        freedom=observation.count - UNKNOWNS,
        drop=(along * along).sum(axis=1),
        drop_freedom=degrees,
        separation_m=(move @ along[:, :, None])[:, :, 0],
        separation_cov_m2=move @ move.swapaxes(1, 2),
        hidden=(degrees < measured.sum(axis=1)) | ~measured.any(),
        score=score,
        information=information,
        observation=observation,
        state=state,
        prior=prior,
        field_T=field,
        gradient_T_m=gradient,
        _columns=columns,
        _half=half,
        _rest=rest,
    )


def _belief(prior: Belief, jacobian: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the root of what is believed of the state, and what makes S = I - half' half of it.

    With the spread H root of the numbers by the state, half is L^-1 spread' and L L' = I + spread' spread; the second
    matrix is L^-1.
    """
    root = np.zeros((SIZE, UNKNOWNS + prior.root.shape[1]))
    root.flat[: UNKNOWNS * root.shape[1] : root.shape[1] + 1] = VAGUE_POSE
    root[UNKNOWNS:, UNKNOWNS:] = prior.root[UNKNOWNS:]
    spread = jacobian @ root
    square = spread.T @ spread
    square.flat[:: len(square) + 1] += 1.0
    inverse = np.linalg.inv(np.linalg.cholesky(square))
    return root, inverse, inverse @ spread.T


def _columns(observation: Observation) -> FloatArray:
    """Return what a constant field of each beacon adds to the numbers, by component, shape (n, 3, 3 r)."""
    beacons, nodes = len(observation.model), len(observation.times_s)
    rows = observation.seen.shape[1]
    constant = observation.seen[:, :, : beacons * nodes].reshape(3, rows, beacons, nodes).sum(axis=3)
    columns = np.zeros((beacons, 3, 3, rows))
    for axis in range(3):
        columns[:, axis, axis] = constant[axis].T
    flat = columns.reshape(beacons, 3, 3 * rows)
    return flat if observation.mixing is None else flat @ observation.mixing.T


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
