"""How much the ambient field has changed, and by how much whatever did it may bend the fields of the beacons.

Soft iron bends all fields alike: what changes the ambient field by a hundredth of it may change those of the beacons by
a hundredth, in a way that a pose follows (docs/blocks.md, "Uneven field"). The beacons tell the least of it, and the
ambient field, which is some thirty times as strong, the most. Of a magnet the same is taken, though it bends nothing:
the ambient field does not tell one from the other.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from goldfield.site.model import AMBIENT_GRADIENT_T_M
from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.kernel import double
from goldfield.track.blocks.state import OFFSET, TURN, Motion, crosses
from goldfield.types import FloatArray

EVEN_T = 2e-6
"""A change that says nothing: indoors the ambient field differs by as much from place to place."""

SETTLING_T_S = 1e-7
"""What becomes usual of a change in a second of a sensor at rest."""

FASTEST_M_S = 5.0
"""A higher speed is an error of the track."""

CERTAIN, LIKELY = 4.0, 2.5
"""A change is said beyond so many of its standard deviations, and widens the covariance beyond so many."""

BETTER = 2.0
"""What is usual is taken anew where the attitude tells it with so many times less variance: a track begins vaguely."""


class Limits(NamedTuple):
    """What `Evenness` goes by: ``gf_even_limits_t`` of even.h."""

    even_T: float
    gradient_T_m: float
    settling_T_s: float = SETTLING_T_S
    fastest_m_s: float = FASTEST_M_S
    certain: float = CERTAIN
    likely: float = LIKELY
    better: float = BETTER


class Evenness:
    """Holds the ambient field against what it was.

    Parameters
    ----------
    even_T : float
        A change that says nothing; infinite: no change does.
    gradient_T_m : float
        What is usual besides, for each metre that the sensor moves.

    Attributes
    ----------
    change_T : float
        By how much the ambient field has changed for certain, beyond what says nothing.
    share : float
        By which part of themselves all fields may be bent, for all that is known of the change; 0: it is usual.
    """

    def __init__(self, even_T: float = EVEN_T, gradient_T_m: float = AMBIENT_GRADIENT_T_M) -> None:
        self._limits = Limits(even_T, gradient_T_m)
        self.forget()

    def forget(self) -> None:
        """Begin anew: the ambient field is what it will be."""
        self._usual = np.full(double.USUAL, np.nan)
        self.change_T = self.share = 0.0

    def update(self, seen_T: FloatArray, by_beacons: Estimate, seconds: float) -> None:
        """Take the ambient field that a sensor sees, shape (3,), in its own frame, and its motion by the beacons.

        What is usual follows, by so much as the sensor has moved since the last time.
        """
        motion, covariance = by_beacons.motion, by_beacons.covariance
        step = double.even if double.ready() else even_in_numpy
        told = step(self._limits, motion, covariance, seen_T, seconds, self._usual)
        if told is not None:
            self.change_T, self.share = told


def even_in_numpy(
    limits: Limits, motion: Motion, covariance: FloatArray, seen_T: FloatArray, seconds: float, usual: FloatArray
) -> tuple[float, float] | None:
    """Hold the ambient field against what is usual, which follows: the reference of the version in C.

    Parameters
    ----------
    limits : Limits
    motion, covariance
        By the beacons alone.
    seen_T : ndarray, shape (3,)
        The ambient field in the sensor's frame.
    seconds : float
        Time since the last time.
    usual : ndarray, shape (21,)
        Ambient field with the sensor's offset, attitude, and what the attitude's errors make of the field; NaN at
        first. It is changed.

    Returns
    -------
    change_T, share : float
        As of `Evenness`; None if there is no field at all.
    """
    seen = motion.rotation @ seen_T
    field = seen - motion.rotation @ motion.offset_T
    cross = crosses(field)
    by_attitude = cross @ covariance[TURN, TURN] @ cross.T
    now = np.concatenate([seen, motion.rotation.ravel(), by_attitude.ravel()])
    if np.isnan(usual[0]):
        usual[:] = now
    turned, doubt = usual[3:12].reshape(3, 3), usual[12:].reshape(3, 3)
    moved = motion.rotation - turned
    change = seen - usual[:3] - moved @ motion.offset_T  # by the offset as it is now known
    # The errors of both attitudes turn the fields; that of the sensor's offset shows as far as the sensor turned.
    variance = by_attitude + doubt + moved @ covariance[OFFSET, OFFSET] @ moved.T
    whole, size = (float(np.linalg.norm(vector)) for vector in (field, change))
    ways = [vector / length for vector, length in ((field, whole), (change, size)) if length]
    if not ways:
        return None
    # The attitude's errors make no change along the field.
    sizes = np.array([abs(float(way @ change)) for way in ways])
    errors = np.sqrt([max(float(way @ variance @ way), 0.0) for way in ways])
    change_T = max(float((sizes - limits.certain * errors).max()) - limits.even_T, 0.0)
    beyond = float((sizes**2 - (limits.likely * errors) ** 2).max()) - limits.even_T**2
    share = math.sqrt(max(beyond, 0.0)) / max(whole, size)
    if not change_T and limits.better * np.trace(by_attitude) < np.trace(doubt):
        usual[:] = now
        return change_T, share
    speed = min(float(np.linalg.norm(motion.velocity_m_s)), limits.fastest_m_s)
    step = (limits.settling_T_s + limits.gradient_T_m * speed) * seconds
    part = min(step / size, 1.0) if size else 1.0
    usual[:12] += part * (now[:12] - usual[:12])
    return change_T, share
