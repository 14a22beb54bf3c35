"""Balls of metal: solid spheres, each as dipoles inside it that make the field on its surface right.

Outside a ball the field that it adds is harmonic, so that sources inside can make it, and an error on the surface is
the largest anywhere (the method of fundamental solutions). On copper or aluminium the currents of a chip stay in the
skin and no field enters: its normal part vanishes. On iron that is laminated or powdered, so that no eddy currents
flow, a field ends at right angles: its tangential part vanishes, as for an infinite permeability (relative 100: 3 % of
what is added less). `hil_sim.world.sphere` has the exact series, by which this is checked. Solid steel lies between
the two, and answers otherwise at each frequency: it is not covered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

MATERIALS = ("conductor", "iron")
PLACES, DIPOLES = 240, 60
"""Points on the surface at which the field is made right, and points inside with three dipoles each."""
DEPTH = 0.5
"""Distance of the dipoles from the centre, in radii: further out they need more places, further in more digits."""


@dataclass(frozen=True, eq=False)
class Ball:
    """A solid sphere of metal.

    Attributes
    ----------
    centre_m : ndarray, shape (3,)
    radius_m : float
    material : str
        One of `MATERIALS`.
    """

    centre_m: FloatArray
    radius_m: float
    material: str = MATERIALS[0]

    def fields(self, positions_m: FloatArray) -> FloatArray:
        """Return B of dipoles of one A m^2 along each axis; see `hil_sim.world.metal.Body`."""
        away = positions_m - (self.centre_m + DEPTH * self.radius_m * spread(DIPOLES))[:, None]
        distance = np.linalg.norm(away, axis=2)[..., None, None]
        along = away[..., :, None] * away[..., None, :]
        field = 1e-7 * (3.0 * along / distance**5 - np.eye(3) / distance**3)
        return np.asarray(np.moveaxis(field, 2, 1).reshape(3 * DIPOLES, len(positions_m), 3))

    def conditions(self) -> tuple[FloatArray, FloatArray]:
        """Return points on the surface with the normal, or two tangents; see `hil_sim.world.metal.Body`."""
        normal = spread(PLACES)
        places = self.centre_m + self.radius_m * normal
        if self.material == "conductor":
            return places, normal
        away = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
        first = np.cross(normal, away)
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        return np.tile(places, (2, 1)), np.concatenate([first, np.cross(normal, first)])


def spread(count: int) -> FloatArray:
    """Return unit vectors that are spread evenly over all directions, shape (count, 3): a spiral of equal areas."""
    number = np.arange(count) + 0.5
    height = 1.0 - 2.0 * number / count
    turn = math.pi * (1.0 + math.sqrt(5.0)) * number
    level = np.sqrt(1.0 - height**2)
    return np.stack([level * np.cos(turn), level * np.sin(turn), height], axis=1)
