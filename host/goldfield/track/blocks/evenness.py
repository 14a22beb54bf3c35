"""How much the ambient field has changed, and by how much whatever did it may bend the fields of the beacons.

Soft iron bends all fields alike: what changes the ambient field by a hundredth of it may change those of the beacons by
a hundredth, in a way that a pose follows (docs/blocks.md, "Uneven field"). The beacons tell the least of it, and the
ambient field, which is some thirty times as strong, the most. Of a magnet the same is taken, though it bends nothing:
the ambient field does not tell one from the other.
"""

from __future__ import annotations

import math

import numpy as np

from goldfield.site.model import AMBIENT_GRADIENT_T_M
from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.state import OFFSET, TURN, crosses
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
        self._even_T, self._gradient_T_m = even_T, gradient_T_m
        self.forget()

    def forget(self) -> None:
        """Begin anew: the ambient field is what it will be."""
        self._usual: tuple[FloatArray, FloatArray, FloatArray] | None = None
        self.change_T = self.share = 0.0

    def update(self, seen_T: FloatArray, by_beacons: Estimate, seconds: float) -> None:
        """Take the ambient field that a sensor sees, shape (3,), in its own frame, and its motion by the beacons.

        What is usual follows, by so much as the sensor has moved since the last time.
        """
        motion, covariance = by_beacons.motion, by_beacons.covariance
        seen = motion.rotation @ seen_T
        field = seen - motion.rotation @ motion.offset_T
        cross = crosses(field)
        by_attitude = cross @ covariance[TURN, TURN] @ cross.T
        if self._usual is None:
            self._usual = seen, motion.rotation, by_attitude
        usual, turned, doubt = self._usual
        moved = motion.rotation - turned
        change = seen - usual - moved @ motion.offset_T  # by the offset as it is now known
        # The errors of both attitudes turn the fields; that of the sensor's offset shows as far as the sensor turned.
        variance = by_attitude + doubt + moved @ covariance[OFFSET, OFFSET] @ moved.T
        whole, size = (float(np.linalg.norm(vector)) for vector in (field, change))
        ways = [vector / length for vector, length in ((field, whole), (change, size)) if length]
        if not ways:
            return
        # The attitude's errors make no change along the field.
        sizes = np.array([abs(float(way @ change)) for way in ways])
        errors = np.sqrt([max(float(way @ variance @ way), 0.0) for way in ways])
        self.change_T = max(float((sizes - CERTAIN * errors).max()) - self._even_T, 0.0)
        beyond = float((sizes**2 - (LIKELY * errors) ** 2).max()) - self._even_T**2
        self.share = math.sqrt(max(beyond, 0.0)) / max(whole, size)
        if not self.change_T and BETTER * np.trace(by_attitude) < np.trace(doubt):
            self._usual = seen, motion.rotation, by_attitude
            return
        speed = min(float(np.linalg.norm(motion.velocity_m_s)), FASTEST_M_S)
        step = (SETTLING_T_S + self._gradient_T_m * speed) * seconds
        part = min(step / size, 1.0) if size else 1.0
        self._usual = usual + part * (seen - usual), turned + part * moved, doubt
