"""What later blocks tell of the steps of a track: Rauch, Tung and Striebel's recursion, backward over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.state import added, onward
from goldfield.types import FloatArray


@dataclass(frozen=True, eq=False)
class Step:
    """What a filter believed at the middle of a block, with the block: all that a smoother needs.

    Attributes
    ----------
    track : int
        Number of the track: steps of different tracks know nothing of each other.
    middle_s : float
        Middle of the block.
    known : Estimate
        Without what the errors of the site do to it.
    agility : ndarray, shape (2,)
        The sensor's agility until this step, as `goldfield.track.blocks.bank.AGILITIES`.
    bias : ndarray, shape (6, 6), or None
        Covariance of the pose by the errors of the site.
    """

    track: int
    middle_s: float
    known: Estimate
    agility: FloatArray
    bias: FloatArray | None


def smoothed(steps: Sequence[Step]) -> list[Estimate]:
    """Return what all steps of one track together tell of each of them."""
    if not steps:
        return []
    back = [steps[-1].known]
    for step, later in zip(steps[-2::-1], steps[:0:-1], strict=True):
        seconds = later.middle_s - step.middle_s
        predicted, transition = onward(step.known.motion, seconds)
        covariance = step.known.covariance
        before = transition @ covariance @ transition.T + added(later.agility, seconds)
        gain = _divided(covariance @ transition.T, before)
        after = back[-1]
        change = gain @ after.motion.minus(predicted)
        back.append(Estimate(step.known.motion.moved(change), covariance + gain @ (after.covariance - before) @ gain.T))
    return back[::-1]


def _divided(left: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return left times the inverse of a covariance whose rows have different units."""
    scale = 1.0 / np.sqrt(np.diag(covariance))
    return np.asarray(np.linalg.solve(covariance * np.outer(scale, scale), (left * scale).T).T * scale)
