"""Faults: what is true differs from what the site file and the sensor's description tell.

Systematic ones belong to the sensor, to all currents or to the site file; single ones to one beacon each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.site import Site
from tests.bench.integrity_coils import Coils
from tests.bench.locate_trials import CHIPS

FloatArray = NDArray[np.float64]
FOOT_M = 0.3048
HEARD = 20.0
"""A faulty beacon is one whose sound field is above this many standard deviations: of others nothing can be known."""


@dataclass(frozen=True)
class Systematic:
    """A fault of everything at once.

    Attributes
    ----------
    kind : str
        How the locator should name it: a value of its `Explanation`; empty: nothing is wrong.
    sensor : ndarray, shape (3, 3), or None
        The sensor's true matrix.
    currents : float
        Factor of all currents.
    unit : float
        Number that the site file gives for a length of one metre.
    radii : bool
        Whether the radii are in this unit, too, and not the positions alone.
    """

    kind: str
    sensor: FloatArray | None = None
    currents: float = 1.0
    unit: float = 1.0
    radii: bool = False

    def tells(self, site: Site) -> Site:
        """Return the site as its file has it, of the true one."""
        if self.unit == 1.0:
            return site
        return replace(
            site,
            beacons=tuple(
                replace(
                    beacon,
                    position_m=beacon.position_m * self.unit,
                    radius_m=(beacon.radius_m or 0.0) * (self.unit if self.radii else 1.0),
                )
                for beacon in site.beacons
            ),
        )


def _axes(*factors: float) -> FloatArray:
    return np.diag(factors)


def systematic() -> Mapping[str, Systematic]:
    """Return the systematic faults by name; the first is none."""
    found = {"sound": Systematic("")}
    for k, name in enumerate("xyz"):
        found[f"axis {name} reversed"] = Systematic("mirrored", np.diag(np.where(np.arange(3) == k, -1.0, 1.0)))
    for k, name in enumerate(("y and z", "x and z", "x and y")):
        order = np.arange(3)
        first, second = np.flatnonzero(order != k)
        order[[first, second]] = second, first
        found[f"axes {name} swapped"] = Systematic("mirrored", np.eye(3)[order])
    found["all coils reversed"] = Systematic("mirrored", currents=-1.0)
    for factor in (1.2, 0.8):
        found[f"sensor gain {factor - 1:+.0%}"] = Systematic("strength", factor * np.eye(3))
    for factor in (1.2, 0.8):
        found[f"all currents {factor - 1:+.0%}"] = Systematic("strength", currents=factor)
    for k, name in enumerate("xyz"):
        for factor in (1.2, 0.8):
            gains = np.where(np.arange(3) == k, factor, 1.0)
            found[f"gain of {name} {factor - 1:+.0%}"] = Systematic("axis_gain", _axes(*gains))
    for name, unit in (("feet", 1.0 / FOOT_M), ("cm", 100.0), ("mm", 1000.0)):
        found[f"positions in {name}"] = Systematic("units", unit=unit)
    for name, unit in (("feet", 1.0 / FOOT_M), ("cm", 100.0)):  # radii in mm are refused by the reader of site files
        found[f"all lengths in {name}"] = Systematic("units", unit=unit, radii=True)
    return found


Single = Callable[[Coils, np.ndarray, np.ndarray, np.random.Generator], Coils]


def _strength(factor: float) -> Single:
    def change(coils: Coils, epoch: np.ndarray, row: np.ndarray, rng: np.random.Generator) -> Coils:
        factors = np.ones(coils.radius_m.shape)
        factors[epoch, row] = factor
        return coils.scaled(factors)

    return change


def _moved(distance_m: float) -> Single:
    def change(coils: Coils, epoch: np.ndarray, row: np.ndarray, rng: np.random.Generator) -> Coils:
        direction = rng.normal(size=(len(epoch), 3))
        step = np.zeros(coils.position_m.shape)
        step[epoch, row] = distance_m * direction / np.linalg.norm(direction, axis=1)[:, None]
        return coils.moved(step)

    return change


SINGLE: Mapping[str, Single] = {
    "dead": _strength(0.0),
    "reversed": _strength(-1.0),
    "wrong code": _strength(-1.0 / CHIPS),
    "current +20%": _strength(1.2),
    "current -20%": _strength(0.8),
    "moved 2 cm": _moved(0.02),
    "moved 10 cm": _moved(0.10),
    "moved 30 cm": _moved(0.30),
}
"""Faults of one beacon: each changes the coils of some epochs, one row of each."""


def faulty_rows(field_T: FloatArray, sigma_T: float, count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Draw which beacons are at fault, shape (e, count): any that are heard well, else the strongest.

    Parameters
    ----------
    field_T : ndarray, shape (e, n, 3)
        Sound fields.
    """
    size = np.linalg.norm(field_T, axis=2) / sigma_T
    chance = rng.uniform(size=size.shape)
    rank = np.where(size > HEARD, 1.0 + chance, size / (1.0 + size.max(axis=1, keepdims=True)))
    return np.argsort(-rank, axis=1)[:, :count]


def with_faults(coils: Coils, rows: NDArray[np.intp], kinds: NDArray[np.str_], rng: np.random.Generator) -> Coils:
    """Return coils with faults of the kinds, shape (e, m), at the rows, shape (e, m)."""
    for column in range(rows.shape[1]):
        for kind in SINGLE:
            epoch = np.flatnonzero(kinds[:, column] == kind)
            if len(epoch):
                coils = SINGLE[kind](coils, epoch, rows[epoch, column], rng)
    return coils
