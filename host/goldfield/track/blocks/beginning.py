"""The first blocks of a track, fitted all together until they tell the pose well (docs/blocks.md, "A vague start").

One block beside a coil fixes the position to a fifth of the distance to it, over which the fields are far from linear.
A filter that takes such blocks one after the other linearises each where it believes the sensor then, and takes how the
linearisations differ for knowledge: it is sure of a wrong place. So while a track is vague its blocks are kept and
fitted together (Gauss and Newton's iteration by a filter and a smoother; Bell, 1994), with the slopes of the fields at
one place for all of them, so that what they do not tell they do not seem to tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.track.blocks.backward import Step, smoothed
from goldfield.track.blocks.bank import WIDENED, Bank, Estimate, Start
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.state import AMBIENT, POSITION, TURN, Motion
from goldfield.track.blocks.update import reference
from goldfield.types import FloatArray

VAGUE = 0.03
"""A pose is vague if its deviation is more than this part of the distance to the nearest coil: over a thirtieth of it
the field of a dipole changes by a tenth."""

VAGUE_RAD = 0.1
"""So it is if its attitude has a larger deviation."""

CURVATURE = 6.0
"""The second order of a dipole's field, over the field, by an error of its distance: half of 3 times 4."""

SECOND = 3.0
"""So it is, too, if what its errors change in the field of a coil by their second order is more than so many times the
noise of that field in a block: the less noise, the less of that may be taken for knowledge."""

MOST = 33
"""So many blocks are kept, 0.1 s: the time that they take grows with the square of their number."""

GROWTH = 1.25
"""All blocks are fitted anew when there are so many times as many as at the last time: each time costs all of them."""

STARTS = 8
"""A start that took more blocks is left as it is: the sensor has moved while they came, and the fit was not better."""

WORK = 33
"""All passes of one fit take so many blocks, or there is one: many passes while hardly anything is known, then one."""

SETTLED = 0.1
"""There is no more of them once one has moved the pose by less than so many of its standard deviations."""

PRIOR, PRIOR_AMBIENT_T = 10.0, 50e-6
"""The pose of a start is told to the fit with so many times its deviation, and its ambient field with the earth's: its
own blocks are among those fitted."""

POSE = 6
"""Numbers of a pose, the first of a state's errors."""


def is_vague(model: FieldModel, known: Estimate, noise_T: float, axes: int = 3, widened: float = 1.0) -> bool:
    """Tell whether the fields are far from linear over the errors of a pose, whose deviations are widened by a factor.

    ``noise_T`` is that of a field in a block. The turn about the only one of a sensor's axes is free and does not
    count.
    """
    near_m = float(model.nearest_m(known.motion.position_m[None])[0])
    turns = np.linalg.eigvalsh(known.covariance[TURN, TURN])
    position_sd_m = float(np.sqrt(np.trace(known.covariance[POSITION, POSITION]))) / widened
    turn_sd_rad = float(np.sqrt(turns[: 2 if axes == 1 else 3].sum())) / widened
    linear = position_sd_m <= VAGUE * near_m and turn_sd_rad <= VAGUE_RAD
    return not (linear and _second_order_T(model, known, position_sd_m, turn_sd_rad) <= SECOND * noise_T)


def _second_order_T(model: FieldModel, known: Estimate, position_sd_m: float, turn_sd_rad: float) -> float:
    """Return what errors of such deviations change in the field of a coil by their second order, the most of all."""
    place = known.motion.position_m
    field, _ = kernel.evaluate(model, place)
    away2 = np.maximum(np.square(model.centre_m - place).sum(axis=1), np.square(model.reach_m))
    part = CURVATURE * position_sd_m**2 / away2 + 0.5 * turn_sd_rad**2
    return float((part * np.linalg.norm(field, axis=0)).max())


def _noise_T(form: NormalForm) -> float:
    """Return the noise of a field in a block."""
    return float(1.0 / np.sqrt(np.diag(form.weight).max() * form.gram[-1, -1]))


def begun(model: FieldModel, start: Start) -> Beginning | None:
    """Return the beginning of a track that a start leaves vague; None if the track can go on block by block."""
    axes = int(start.blocks[-1].axes.sum()) if start.blocks else 3
    if len(start.blocks) > STARTS:
        return None
    noise_T = _noise_T(start.blocks[-1]) if start.blocks else math.inf
    return Beginning(model, start) if is_vague(model, start.known, noise_T, axes, WIDENED) else None


@dataclass(frozen=True, eq=False)
class _Kept:
    """A block, the time from the middle of the one before, and where the block is linearised."""

    form: NormalForm
    seconds: float
    at: Motion


class Beginning:
    """The blocks of a track that began vague.

    Parameters
    ----------
    model : FieldModel
    start : Start

    Attributes
    ----------
    known : Estimate
        What all blocks tell of the middle of the last one.
    mismatch : float
        -2 log likelihood of those that came after the start's.
    over : bool
        The track can go on from here block by block.
    """

    def __init__(self, model: FieldModel, start: Start) -> None:
        self._model, self._bank = model, Bank(model)
        self._start, self._count = start, len(start.blocks)
        self.known, self.mismatch, self.over = start.known, 0.0, False
        before_s = start.spacing_s * max(self._count - 1, 0)
        first = self.known.motion.after(-before_s)
        self._prior = Estimate(first, _hardly_known(self.known) if self._count else self.known.covariance)
        self._kept = [
            _Kept(form, start.spacing_s if k else 0.0, first.after(k * start.spacing_s))
            for k, form in enumerate(start.blocks)
        ]
        self._fitted, self._wait_s = 0, 0.0
        self._slopes: FloatArray = np.empty(0)

    def wait(self, seconds: float) -> None:
        """Let time pass without a block."""
        self._wait_s += seconds

    def add(self, form: NormalForm, seconds: float) -> bool:
        """Take a block, so long after the one before; tell whether it agrees with those before."""
        seconds, self._wait_s = seconds + self._wait_s, 0.0
        before = self.known.motion if self._fitted else self._prior.motion
        self._kept.append(_Kept(form, seconds, before.after(seconds)))
        later = len(self._kept) - self._count
        full = later >= MOST
        try:
            if full or later > int(GROWTH * self._fitted):
                self._fitted, agrees = later, self._fit()
            else:
                agrees = self._take(self._kept[-1])
                self.known, self.mismatch = self._bank.output(), self._bank.mismatch
        except np.linalg.LinAlgError:  # Nothing that could be computed with is known of the pose.
            self.over = True
            return False
        self.over = full or not is_vague(self._model, self.known, _noise_T(form), int(form.axes.sum()))
        return agrees

    def _fit(self) -> bool:
        """Fit all blocks that are kept; tell whether the last one agrees."""
        agrees = False
        for _ in range(max(WORK // len(self._kept), 1)):
            self._slopes = reference(self._model, self._kept[-1].at).jacobian
            steps, agrees = self._forward()
            self.known, self.mismatch = steps[-1].known, self._bank.mismatch
            moved = self.known.motion.minus(self._kept[-1].at)[:POSE]
            path = smoothed(steps)
            self._kept = [replace(one, at=there.motion) for one, there in zip(self._kept, path, strict=True)]
            if moved @ np.linalg.solve(self.known.covariance[:POSE, :POSE], moved) < SETTLED**2:
                break
        return agrees

    def _forward(self) -> tuple[list[Step], bool]:
        """Take all blocks one after the other; tell whether the last one agrees."""
        bank, steps, time_s, sound, agrees = self._bank, [], 0.0, True, True
        bank.resume(self._prior)
        for place, one in enumerate(self._kept, 1):
            agrees = self._take(one)
            sound, time_s = sound and agrees, time_s + one.seconds
            if place == self._count:  # What led to the start says nothing of which of two starts is right.
                bank.resume(bank.output() if sound else self._start.known)
            steps.append(Step(0, time_s, bank.output(), bank.agility, None))
        return steps, agrees

    def _take(self, one: _Kept) -> bool:
        """Take a block with the slopes of all of them; tell whether it agrees."""
        return self._bank.update(one.form, one.seconds, replace(reference(self._model, one.at), jacobian=self._slopes))


def _hardly_known(known: Estimate) -> FloatArray:
    """Return the covariance of a start of which hardly anything is known."""
    covariance = known.covariance.copy()
    covariance[:POSE, :POSE] *= (PRIOR / WIDENED) ** 2
    covariance[AMBIENT, AMBIENT] = PRIOR_AMBIENT_T**2 * np.eye(3)
    return covariance
