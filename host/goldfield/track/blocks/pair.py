"""Two banks that take the same blocks: one believes that the ambient field is even, one knows nothing of it.

Iron that passes changes the ambient field by tens of microteslas within a tenth of a second. A bank that takes it for
even makes a turn of that, with a covariance that knows nothing of it. What it has the sensor at is held against what
the beacons alone have it at (docs/blocks.md, "Uneven field"): where both are apart by more than chance the beacons
count, and in between both count, with a covariance that spans them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from goldfield.field import FieldModel
from goldfield.track.blocks.bank import Bank, Estimate, Start
from goldfield.track.blocks.beginning import Beginning, begun
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.kernel import CBank, double
from goldfield.track.blocks.state import AMBIENT, OFFSET, POSITION, TURN, Motion
from goldfield.types import FloatArray

POSE = 6
MOVED = 12
"""Numbers of the pose, and of the pose and its velocities."""

EVEN_ODDS = 14.0
"""Both banks weigh the same where the squared distance of their poses, chi-square of six numbers, is this: 1e-3."""

APART = 30.0
"""The bank that believes in an even field begins anew from the other where the squared distance is this: 5e-7."""

LEAST_SHARE = 0.25
"""The banks' agilities differ, so that one may seem to know no more than the other: the variance of their distance is
at least this part of that of the beacons alone."""

LEAST_WEIGHT = 0.01
"""Less of the beacons alone is none, which saves time."""

COMPARED = 2
"""With every so manieth block the banks are held against each other, and with each while the beacons alone count: it
takes a quarter of a block's time."""

PROBATION_S = 0.1
"""A bank that has begun anew does not count for this time."""

JUMPED = 6
"""It begins anew with a block that the beacons alone take, too, if it has refused so many in a row: a magnet, perhaps.
Before that it is asked whether a beacon is at fault (`goldfield.track.blocks.filter.DOUBTED`)."""

AFRESH_T = 50e-6
"""Deviation of the ambient field then: nothing is known of it, the next block tells."""

VAGUE_M, VAGUE_RAD = 0.3, 0.3
"""Where the beacons alone tell no more than this they are not asked."""


@dataclass(frozen=True, eq=False)
class _Apart:
    """Where the beacons alone have the sensor, less where it is by an even field, and the squared distance."""

    seeing: Estimate
    alone: Estimate
    error: FloatArray
    distance2: float


class Pair:
    """Two banks with the constructor's ``make``, and the methods and attributes of one.

    Parameters
    ----------
    make : callable
        Makes a `Bank` or a `CBank`.
    model : FieldModel

    Attributes
    ----------
    broken : bool
        The numbers of a bank are none any more: its precision did not do (docs/blocks.md).
    """

    def __init__(self, make: Callable[[], Bank | CBank], model: FieldModel) -> None:
        self._seeing, self._alone = make(), make()
        self._model = model
        self._beginning: Beginning | None = None
        self._before = 0.0
        self._probation_s = 0.0
        self._weight = 0.0
        self._blocks = 0
        self._apart: _Apart | None = None
        self.broken = False

    @property
    def mismatch(self) -> float:
        """-2 log likelihood of the blocks that were taken since the start."""
        return self._before + self._seeing.mismatch

    @property
    def refused(self) -> int:
        """Blocks in a row that were refused."""
        return self._seeing.refused

    @property
    def alone(self) -> float:
        """By how much the beacons alone count, 0 to 1."""
        return self._weight

    @property
    def agility(self) -> FloatArray:
        """The agility that the sensor seems to have, shape (2,)."""
        shares = np.array([1.0 - self._weight, self._weight])
        return np.asarray(np.sqrt(shares @ np.array([self._seeing.agility, self._alone.agility]) ** 2))

    def start(self, start: Start) -> None:
        """Begin a track."""
        self._seeing.start(start)
        self._alone.start(start)
        self._probation_s = self._weight = self._before = 0.0
        self._apart = None
        self._beginning = begun(self._model, start)

    def predict(self, seconds: float) -> None:
        """Go on by some seconds without a block."""
        self._seeing.predict(seconds)
        self._alone.predict(seconds)
        self._apart = None
        if self._beginning is not None:
            self._beginning.wait(seconds)

    def update(self, form: NormalForm, seconds: float) -> bool:
        """Go on by some seconds to the middle of a block and take it; False if all filters refuse it."""
        took = self._take(form, seconds)
        if self._beginning is None:
            return took
        return self._fitted(self._beginning, form, seconds) or took

    def _fitted(self, beginning: Beginning, form: NormalForm, seconds: float) -> bool:
        """Fit the first blocks of a vague track with one more; tell whether the banks go on from there."""
        agrees = beginning.add(form, seconds)
        if agrees:
            self._seeing.resume(beginning.known)
            self._alone.resume(beginning.known)
            self._before, self._probation_s, self._weight, self._apart = beginning.mismatch, 0.0, 0.0, None
            self.broken = False
        if beginning.over:
            self._beginning = None
        return agrees

    def _take(self, form: NormalForm, seconds: float) -> bool:
        """Do what `update` does, block by block."""
        self._probation_s = max(self._probation_s - abs(seconds), 0.0)
        self._apart = None
        if self._seeing.update(form, seconds):
            self._alone.update(form.beacons_alone, seconds)
            self._blocks += 1
            due = self._weight > 0.0 or self._blocks % COMPARED == 0
            self._compare(due and self._beginning is None)
            return True
        jumped = self._seeing.refused >= JUMPED and self._beginning is None
        if jumped and self._alone.update(form.beacons_alone, seconds):
            seeing, alone = self._seeing.output(), self._alone.output()
            self.broken = not (_sound(seeing) and _sound(alone))
            if not self.broken:
                self._begin_anew(seeing, alone)
            return True
        if not jumped:  # a block that is refused has passed all the same
            self._alone.predict(seconds)
        return False

    def in_numpy(self) -> Pair:
        """Go on in NumPy: for blocks that the banks in C do not serve."""
        self._seeing, self._alone = (
            bank.in_numpy() if isinstance(bank, CBank) else bank for bank in (self._seeing, self._alone)
        )
        return self

    def output(self, seconds: float = 0.0) -> Estimate:
        """Return what is believed of the moment so many seconds after the middle of the last block."""
        if not seconds and self._apart is not None:
            return _between(self._apart, self._weight) if self._weight else self._apart.seeing
        seeing = self._seeing.output(seconds)
        if not self._weight:
            return seeing
        alone = self._alone.output(seconds)
        return _between(_Apart(seeing, alone, _error(seeing, alone), math.nan), self._weight)

    @property
    def by_beacons(self) -> Estimate | None:
        """What the beacons alone tell of the middle of the last block, if the banks were held against each other then.

        The offset is that of the other bank.
        """
        if self._apart is None:
            return None
        seeing, alone = self._apart.seeing, self._apart.alone
        covariance = alone.covariance.copy()
        covariance[OFFSET, OFFSET] = seeing.covariance[OFFSET, OFFSET]
        return Estimate(replace(alone.motion, offset_T=seeing.motion.offset_T), covariance)

    def _compare(self, due: bool) -> None:
        """Look whether the banks' numbers are sound, and hold them against each other if that is due."""
        seeing = self._seeing.output()
        self.broken = not (math.isfinite(self._seeing.mismatch) and _sound(seeing))
        if due and not self.broken:
            alone = self._alone.output()
            try:
                self._weigh(seeing, alone)
            except np.linalg.LinAlgError:
                self.broken = True

    def _weigh(self, seeing: Estimate, alone: Estimate) -> None:
        """Compare the banks, and say by how much the beacons alone count from now on."""
        if _vague(alone):
            self._alone.resume(seeing)
            self._weight, self._probation_s = 0.0, 0.0
            return
        apart = self._apart = _apart(seeing, alone)
        if apart.distance2 > APART:
            self._begin_anew(seeing, alone)
        else:
            doubted = self._probation_s > 0.0
            weight = 1.0 if doubted else 1.0 / (1.0 + math.exp(0.5 * (EVEN_ODDS - apart.distance2)))
            self._weight = weight if weight > LEAST_WEIGHT else 0.0

    def _begin_anew(self, seeing: Estimate, alone: Estimate) -> None:
        """Let the bank that believes in an even field begin where the beacons alone have the sensor."""
        self._seeing.resume(_afresh(seeing, alone))
        self._probation_s, self._weight = PROBATION_S, 1.0


def _apart(seeing: Estimate, alone: Estimate) -> _Apart:
    """Hold two estimates of one moment against each other.

    One of them knows all that the other does, and more: the covariance of their difference is that of their
    covariances (Hausman, 1978).

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is none.
    """
    if double.ready():
        found = double.apart(seeing.motion, seeing.covariance, alone.motion, alone.covariance, LEAST_SHARE)
        if found is not None:
            return _Apart(seeing, alone, *found)
    return apart_in_numpy(seeing, alone)


def _error(seeing: Estimate, alone: Estimate) -> FloatArray:
    """Return by how much the beacons alone have the sensor elsewhere: nothing of what only the other bank knows."""
    error = alone.motion.minus(seeing.motion)
    error[MOVED:] = 0.0
    return error


def apart_in_numpy(seeing: Estimate, alone: Estimate) -> _Apart:
    """Compute what `_apart` returns: the reference of the version in C."""
    error = _error(seeing, alone)
    inverse = np.linalg.inv(np.linalg.cholesky(alone.covariance[:POSE, :POSE]))
    values, vectors = np.linalg.eigh(inverse @ seeing.covariance[:POSE, :POSE] @ inverse.T)
    if not values[0] > 0.0:
        raise np.linalg.LinAlgError("the covariance of a pose is not positive definite")
    along = vectors.T @ (inverse @ error[:POSE])
    distance2 = float((along**2 / np.maximum(1.0 - values, LEAST_SHARE)).sum())
    return _Apart(seeing, alone, error, distance2)


def _between(apart: _Apart, weight: float) -> Estimate:
    """Return what both banks say together if the beacons alone count by a weight."""
    if double.ready():
        seeing, alone = apart.seeing, apart.alone
        return Estimate(
            *double.between(seeing.motion, seeing.covariance, alone.motion, alone.covariance, apart.error, weight)
        )
    return between_in_numpy(apart, weight)


def between_in_numpy(apart: _Apart, weight: float) -> Estimate:
    """Compute what `_between` returns: the reference of the version in C."""
    covariance = (1.0 - weight) * apart.seeing.covariance
    covariance[:MOVED, :MOVED] += weight * apart.alone.covariance[:MOVED, :MOVED]
    covariance[MOVED:, MOVED:] += weight * apart.seeing.covariance[MOVED:, MOVED:]
    covariance += weight * (1.0 - weight) * np.outer(apart.error, apart.error)
    return Estimate(apart.seeing.motion.moved(weight * apart.error), covariance)


def _afresh(seeing: Estimate, alone: Estimate) -> Estimate:
    """Return where the beacons alone have the sensor, with an ambient field of which nothing is known."""
    motion = alone.motion
    covariance = np.zeros_like(alone.covariance)
    covariance[:MOVED, :MOVED] = alone.covariance[:MOVED, :MOVED]
    covariance[AMBIENT, AMBIENT] = AFRESH_T**2 * np.eye(3)
    covariance[OFFSET, OFFSET] = seeing.covariance[OFFSET, OFFSET]
    return Estimate(
        Motion(
            motion.position_m,
            motion.rotation,
            motion.velocity_m_s,
            motion.rate_rad_s,
            seeing.motion.ambient_T,
            seeing.motion.offset_T,
        ),
        covariance,
    )


def _sound(known: Estimate) -> bool:
    """Tell whether the covariances of position and attitude are some: finite, and all leading minors above zero.

    In plain numbers, since a block has no time for a decomposition.
    """
    for part in (POSITION, TURN):
        (a, b, c), (_, d, e), (_, _, f) = known.covariance[part, part].tolist()
        second = a * d - b * b
        third = f * second - a * e * e - d * c * c + 2.0 * b * c * e
        if not (0.0 < a < math.inf and 0.0 < second < math.inf and 0.0 < third < math.inf):
            return False
    return True


def _vague(known: Estimate) -> bool:
    """Tell whether an estimate is too vague to be held against another."""
    variances = np.diag(known.covariance)
    return bool(variances[POSITION].sum() > VAGUE_M**2 or variances[TURN].sum() > VAGUE_RAD**2)
