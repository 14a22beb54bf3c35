"""The result of a plan: figures of each point of the grid, and of the room as a whole."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield.planning.grid import Grid, Tile
from goldfield.types import FloatArray


@dataclass(frozen=True, eq=False)
class Figures:
    """Figures of points; arrays of the grid's shape (nx, ny, nz), of a tile's points (e,) while they are computed.

    Attributes
    ----------
    position_sd_m : ndarray of float
        Cramer-Rao bound on the position: root of the sum of the three variances; infinite inside a wire.
    attitude_sd_rad : ndarray of float
        The same of a small rotation about three axes.
    protection_m : ndarray of float
        Protection level of a typical epoch (`goldfield.locate.protection`); infinite if a fault could not show.
    protection_beacon : ndarray of int32
        Index of the beacon whose fault could hide the most.
    dilution_m_T : ndarray of float
        Bound on the position over the noise of a component if nothing but noise is wrong, m/T.
    best : ndarray of int32, shape (..., K)
        Indices of the beacons that have the largest part in the position, the largest first; -1 where there are fewer.
    best_position_sd_m : ndarray of float
        Bound on the position from these beacons alone.
    weak : ndarray of bool
        Whether the locator would call a pose here ``weak``.
    ambiguous : ndarray of bool
        Whether a second pose fits the fields as well (`goldfield.planning.images`).
    truncation : ndarray of float
        Bound on the part by which the standard deviations are too large for want of the beacons that were left out.
    orientation_spread : ndarray of float
        Largest over rms bound on the position among the orientations; 1 where the orientation does not matter.
    """

    position_sd_m: FloatArray
    attitude_sd_rad: FloatArray
    protection_m: FloatArray
    protection_beacon: NDArray[np.int32]
    dilution_m_T: FloatArray
    best: NDArray[np.int32]
    best_position_sd_m: FloatArray
    weak: NDArray[np.bool_]
    ambiguous: NDArray[np.bool_]
    truncation: FloatArray
    orientation_spread: FloatArray

    @classmethod
    def empty(cls, shape: tuple[int, ...], best: int) -> Figures:
        """Return figures that are still to be filled in."""
        kinds: dict[str, Any] = {"protection_beacon": np.int32, "best": np.int32, "weak": bool, "ambiguous": bool}
        return cls(
            **{
                part.name: np.zeros((*shape, best) if part.name == "best" else shape, kinds.get(part.name, float))
                for part in fields(cls)
            }
        )

    def put(self, tile: Tile, other: Figures) -> None:
        """Fill in the figures of a tile's points, in place."""
        for part in fields(self):
            target = getattr(self, part.name)[tile]
            target[...] = getattr(other, part.name).reshape(target.shape)


@dataclass(frozen=True, eq=False)
class Conflicts:
    """Pairs of beacons that cannot share a code.

    Attributes
    ----------
    pair : ndarray of int32, shape (m, 2)
        The beacon that is used, and the one that would disturb it.
    level_dB : ndarray, shape (m,)
        The disturbing field over the used one where that is worst.
    """

    pair: NDArray[np.int32]
    level_dB: FloatArray


@dataclass(frozen=True, eq=False)
class Maps:
    """A computed plan.

    Attributes
    ----------
    grid : Grid
    figures : Figures
    conflicts : Conflicts
    shared_code : ndarray of int32, shape (n,)
        A number for each beacon of the site such that beacons with one number may share a code; from 0.
    beacon_ids : tuple of str
    beacon_position_m : ndarray, shape (n, 3)
    """

    grid: Grid
    figures: Figures
    conflicts: Conflicts
    shared_code: NDArray[np.int32]
    beacon_ids: tuple[str, ...]
    beacon_position_m: FloatArray

    def summary(self) -> dict[str, Any]:
        """Return the figures of the whole room under the keys of ``goldfield plan --json``; infinite is None."""
        figures = self.figures
        return {
            "points": len(self.grid),
            "beacons": len(self.beacon_ids),
            "position_m": _spread(figures.position_sd_m),
            "attitude_rad": _spread(figures.attitude_sd_rad),
            "protection_m": _spread(figures.protection_m),
            "dilution_m_T": _spread(figures.dilution_m_T),
            "best_position_m": _spread(figures.best_position_sd_m),
            "ambiguous": float(figures.ambiguous.mean()),
            "weak": float(figures.weak.mean()),
            "codes": int(self.shared_code.max(initial=-1)) + 1,
            "conflicts": len(self.conflicts.level_dB),
            "truncation": _finite(float(figures.truncation.max())),
            "orientation_spread": _finite(float(figures.orientation_spread.max())),
        }

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything under the keys of the NPZ file."""
        tables = {part.name: getattr(self.figures, part.name) for part in fields(self.figures)}
        return {
            "x_m": self.grid.x_m,
            "y_m": self.grid.y_m,
            "z_m": self.grid.z_m,
            **tables,
            "conflict_pair": self.conflicts.pair,
            "conflict_dB": self.conflicts.level_dB,
            "shared_code": self.shared_code,
            "beacon_id": np.array(self.beacon_ids),
            "beacon_position_m": self.beacon_position_m,
        }


def _spread(values: FloatArray) -> dict[str, float | None]:
    """Return median, 95 % and worst of a map; a quantile is a value that so many points do not exceed."""
    ordered = np.sort(values, axis=None)
    last = len(ordered) - 1
    return {
        "median": _finite(float(ordered[math.ceil(0.5 * last)])),
        "p95": _finite(float(ordered[math.ceil(0.95 * last)])),
        "worst": _finite(float(ordered[last])),
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
