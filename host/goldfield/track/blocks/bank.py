"""A bank of filters of different agility that take the same blocks (docs/blocks.md): gates, probabilities, mixing.

The seam to the C version: `goldfield.track.blocks.kernel` has a class ``CBank`` with the constructor, the methods and
the attributes of `Bank`, everything in SI units and NumPy arrays, and raises UserError in its constructor for coils
that it does not serve (``serves(model)`` tells). `BlockFilter` takes either:

    bank = Bank(model)                      # a FieldModel: n beacons
    bank.start(start)                       # a Start: the pose at the middle of a block, and its covariance
    bank.resume(known)                      # an Estimate in its place
    bank.update(form, seconds)              # a NormalForm; seconds since the middle of the last block or the start;
                                            # False: refused by all filters, the block is predicted over
                                            # (in NumPy also linearised elsewhere: `Bank.update`)
    bank.predict(seconds)                   # nothing came: the middle goes on by so many seconds
    bank.output(seconds)                    # an Estimate, so many seconds after the middle; 0: at the middle
    bank.mismatch                           # -2 log likelihood of the blocks taken since the start: lower is better
    bank.refused                            # blocks in a row that all filters have refused
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.chances import chdtri
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.state import AMBIENT, OFFSET, RATE, SIZE, VELOCITY, Motion, added, onward
from goldfield.track.blocks.update import Reference, observed, reference, taken_by
from goldfield.types import FloatArray

AGILITIES: FloatArray = np.array([[0.01, 0.02], [0.05, 0.08], [0.25, 0.3], [0.5, 1.0], [2.0, 4.0], [8.0, 15.0]])
"""Agilities of acceleration and turn, m/s^2 and rad/s^2 per root hertz."""

FILTERS = 4
"""Filters of a bank at most: the last has the greatest agility, the others those that are next to the likeliest one."""

BEGIN = 2
"""The least agility with which a track begins, by its place in `AGILITIES`: nobody knows yet how the sensor moves."""

LIKELY, CERTAIN = 0.4, 0.5
"""Probability of the two most agile filters from which on it is asked whether more agility is wanted, and of the least
agile one from which on it is asked whether less is enough."""

KEPT_S = 0.5
"""Mean time for which a sensor keeps its agility."""

MIXED_S = 0.012
"""The filters are mixed after this time, every fourth block: the agility does not change oftener, and it costs time."""

LEAST = 1e-9
"""Least probability of an agility."""

GATE = 1e-5
"""A block less likely than this is refused by a filter."""

START_VELOCITY_M_S, START_RATE_RAD_S, START_OFFSET_T = 3.0, 4.0, 5e-6
"""Standard deviations of what a start does not know, each axis."""

WIDENED = 2.0
"""The deviations of the located pose are doubled: they are too small at ill-conditioned points (maths.md, 3)."""

REMEMBERED = 64
"""Distances in time whose noise is kept."""


@dataclass(frozen=True, eq=False)
class Start:
    """What a track begins with, at the middle of a block.

    Attributes
    ----------
    position_m : ndarray, shape (3,)
    rotation : ndarray, shape (3, 3)
    pose_cov : ndarray, shape (6, 6)
        Covariance of position (m) and a small rotation (rad) in the site's frame.
    ambient_T : ndarray, shape (3,)
        In the site's frame.
    ambient_cov_T2 : ndarray, shape (3, 3)
    blocks : tuple of NormalForm
        The blocks that the pose was located by, the last of them that of the start; none if it was not by blocks.
    spacing_s : float
        Time from the middle of one of them to that of the next.
    """

    position_m: FloatArray
    rotation: FloatArray
    pose_cov: FloatArray
    ambient_T: FloatArray
    ambient_cov_T2: FloatArray
    blocks: tuple[NormalForm, ...] = ()
    spacing_s: float = 0.0

    @property
    def known(self) -> Estimate:
        """The whole state, with what is not known of it."""
        nothing = np.zeros(3)
        covariance = np.zeros((SIZE, SIZE))
        covariance[:6, :6] = self.pose_cov
        covariance[VELOCITY, VELOCITY] = START_VELOCITY_M_S**2 * np.eye(3)
        covariance[RATE, RATE] = START_RATE_RAD_S**2 * np.eye(3)
        covariance[AMBIENT, AMBIENT] = self.ambient_cov_T2
        covariance[OFFSET, OFFSET] = START_OFFSET_T**2 * np.eye(3)
        motion = Motion(self.position_m, self.rotation, nothing, nothing, self.ambient_T, nothing)
        return Estimate(motion, covariance)


@dataclass(frozen=True, eq=False)
class Estimate:
    """A motion with its uncertainty.

    Attributes
    ----------
    motion : Motion
    covariance : ndarray, shape (18, 18)
        Covariance of the errors in the order of `goldfield.track.blocks.state`.
    """

    motion: Motion
    covariance: FloatArray

    @property
    def state(self) -> Motion:
        """The motion, by the name that `goldfield.track.report` knows."""
        return self.motion


class Bank:
    """Filters of different agility with the probability of each: interacting multiple models (Blom, Bar-Shalom 1988).

    Parameters
    ----------
    model : FieldModel
    agilities : ndarray, shape (k, 2)
        The last is the greatest.

    Attributes
    ----------
    mismatch : float
        -2 log likelihood of the blocks that were taken since the start.
    refused : int
        Blocks in a row that all filters have refused.
    """

    def __init__(self, model: FieldModel, agilities: FloatArray = AGILITIES) -> None:
        self._model, self._all = model, agilities
        self.mismatch, self.refused = 0.0, 0
        self._count = min(len(agilities), FILTERS)
        self._least = self._first = min(BEGIN, len(agilities) - self._count)
        self._probability = np.full(self._count, 1.0 / self._count)
        self._unmixed_s = 0.0
        self._merged: Estimate | None = None
        self._added: dict[float, FloatArray] = {}

    def start(self, start: Start) -> None:
        """Begin a track; what was known before is forgotten."""
        self.resume(start.known)

    def resume(self, known: Estimate) -> None:
        """Begin a track with a motion that is known so well, at the middle of a block."""
        count, motion = self._count, known.motion
        self._least = self._first
        self._motion = Motion(
            np.tile(motion.position_m, (count, 1)),
            np.tile(motion.rotation, (count, 1, 1)),
            np.tile(motion.velocity_m_s, (count, 1)),
            np.tile(motion.rate_rad_s, (count, 1)),
            np.tile(motion.ambient_T, (count, 1)),
            np.tile(motion.offset_T, (count, 1)),
        )
        self._covariance = np.tile(known.covariance, (count, 1, 1))
        self._probability[:] = 1.0 / count
        self.mismatch, self.refused, self._unmixed_s, self._merged = 0.0, 0, 0.0, None

    def expect(self, agility: FloatArray) -> None:
        """Let the filters have the agilities next to one that is known, as `Bank.agility` tells it."""
        nearest = int(np.searchsorted(self._all[:, 0], agility[0]))
        self._least = min(max(nearest - 1, 0), len(self._all) - self._count)

    def update(self, form: NormalForm, seconds: float, around: Reference | None = None) -> bool:
        """Go on by some seconds to the middle of a block and take it; False if all filters refuse it.

        The block is linearised around a reference that is given, or where the likeliest filter has the sensor.
        """
        self.predict(seconds)
        block = observed(form, around or reference(self._model, self._motion.taken(self._best)))
        update = taken_by(self._motion, self._covariance, block)
        agrees = update.surprise <= _gate(block.rank)
        if not agrees.any():
            self.refused += 1
            return False
        self.refused = 0
        self._weigh(-0.5 * (update.surprise + update.log_spread))
        self._motion = self._motion.moved(np.where(agrees[:, None], update.change, 0.0))
        gain = np.where(agrees[:, None, None], update.gain, 0.0)
        self._covariance -= gain @ gain.swapaxes(1, 2)
        return True

    @property
    def _best(self) -> int:
        return int(self._probability.argmax())

    def _weigh(self, likelihood: FloatArray) -> None:
        """Multiply the probabilities by the likelihoods, given as logarithms."""
        greatest = float(likelihood.max())
        joint = self._probability * np.exp(likelihood - greatest)
        total = float(joint.sum())
        self.mismatch -= 2.0 * (greatest + math.log(total))
        self._probability = np.maximum(joint / total, LEAST)

    def predict(self, seconds: float) -> None:
        """Go on by some seconds without a block."""
        self._merged = None
        self._unmixed_s += abs(seconds)
        if self._unmixed_s >= MIXED_S:
            self._mix()
        self._motion, transition = onward(self._motion, seconds)
        self._covariance = transition @ self._covariance @ transition.swapaxes(1, 2) + self._noise(seconds)

    @property
    def _which(self) -> NDArray[np.intp]:
        """Which agilities the filters have, shape (k,): all but the last have every (k - 1)-th of the rest, in turn."""
        followers = self._count - 1
        return np.append(self._least + (np.arange(followers) - self._least) % followers, len(self._all) - 1)

    def _follow(self) -> None:
        """Let all filters but the last have the agilities next to the likeliest one.

        If that is likely to be the greatest of theirs or beyond, the filter with the least takes the next above them;
        if it is certain to be the least, the other way round. It goes on with what it knows.
        """
        order = np.argsort(self._which)  # by their agility
        probability, above = self._probability[order], self._least + self._count - 1
        if probability[-2:].sum() > LIKELY and above < len(self._all) - 1:
            self._least += 1
        elif probability[0] > CERTAIN and self._least > 0:
            self._least -= 1

    def _mix(self) -> None:
        """Let the sensor change its agility: each filter goes on from what all of them believe."""
        self._follow()
        count = self._count
        changes = (1.0 - math.exp(-self._unmixed_s / KEPT_S)) / max(count - 1, 1)
        self._unmixed_s = 0.0
        joint = (changes + (1.0 - count * changes) * np.eye(count)) * self._probability
        self._probability = joint.sum(axis=1)
        share = joint / self._probability[:, None]  # (to, from)
        base = self._motion.taken(self._best)
        error = self._motion.minus(base)
        mean = share @ error
        rest = error - mean[:, None]
        inner = (share @ self._covariance.reshape(count, -1)).reshape(count, SIZE, SIZE)
        mixed = inner + (share[:, :, None] * rest).swapaxes(1, 2) @ rest
        self._covariance = 0.5 * (mixed + mixed.swapaxes(1, 2))  # rounding does not add up
        self._motion = base.squared().moved(mean)

    @property
    def agility(self) -> FloatArray:
        """The agility that the sensor seems to have, shape (2,), in the units of `AGILITIES`."""
        return np.asarray(np.sqrt(self._probability @ self._all[self._which] ** 2))

    def _noise(self, seconds: float) -> FloatArray:
        """Return what time adds to the covariances; blocks mostly come at the same distance."""
        if seconds not in self._added:
            if len(self._added) > REMEMBERED:
                self._added.clear()
            self._added[seconds] = added(self._all, seconds)
        return self._added[seconds][self._which]

    def output(self, seconds: float = 0.0) -> Estimate:
        """Return what is believed of the moment so many seconds after the middle of the last block."""
        if self._merged is None:
            self._merged = self._merge()
        merged = self._merged
        if not seconds:
            return merged
        motion, transition = onward(merged.motion, seconds)
        noise = (self._probability @ self._noise(seconds).reshape(self._count, -1)).reshape(SIZE, SIZE)
        return Estimate(motion, transition @ merged.covariance @ transition.T + noise)

    def _merge(self) -> Estimate:
        """Return what all filters together believe of the middle of the last block."""
        base = self._motion.taken(self._best)
        error = self._motion.minus(base)
        mean = self._probability @ error
        rest = error - mean
        covariance = (self._probability @ self._covariance.reshape(len(rest), -1)).reshape(SIZE, SIZE)
        covariance = covariance + (self._probability[:, None] * rest).T @ rest
        return Estimate(base.moved(mean), covariance)


@cache
def _gate(rank: int) -> float:
    """Return the surprise that a block which is as described exceeds with the probability `GATE`."""
    return float(chdtri(rank, GATE)) if rank else 0.0
