"""A magnet or a piece of steel that is magnetised, at rest or passing: a dipole of which the codes know nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import magpylib
import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

bodies: Any = magpylib.misc  # magpylib carries no types


@dataclass(frozen=True, eq=False)
class Magnet:
    """A dipole that is there from a moment on and may move on a line.

    Attributes
    ----------
    moment_A_m2 : ndarray, shape (3,)
        Magnetic moment, site's frame. A loudspeaker's magnet has some 10 A m2, a car some 300.
    position_m : ndarray, shape (3,)
        Where it is at its first moment.
    velocity_m_per_s : ndarray, shape (3,)
    start_s, stop_s : float
        Virtual times between which it is there; before and after it has no field.
    """

    moment_A_m2: FloatArray
    position_m: FloatArray
    velocity_m_per_s: FloatArray
    start_s: float = 0.0
    stop_s: float = math.inf

    @property
    def still(self) -> bool:
        """Whether its field at a place does not change while it is there."""
        return not self.velocity_m_per_s.any()

    def present(self, time_s: float) -> bool:
        """Tell whether it is there at a virtual time."""
        return self.start_s <= time_s < self.stop_s

    def field_T(self, positions_m: FloatArray, times_s: FloatArray) -> FloatArray:
        """Return its field at positions of shape (n, 3) at times of shape (n,), shape (n, 3), as if it were there."""
        since_s = times_s - self.start_s
        away = positions_m - self.position_m - since_s[:, None] * self.velocity_m_per_s
        return np.asarray(bodies.Dipole(moment=self.moment_A_m2).getB(away), dtype=np.float64).reshape(-1, 3)
