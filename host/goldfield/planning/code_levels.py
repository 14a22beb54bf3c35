"""How strong one beacon is where another one is used: what decides which of them may have the same code."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.access.epoch import ENTERS
from goldfield.field import FieldModel
from goldfield.field.constants import MU0_OVER_4PI
from goldfield.planning.grid import Grid
from goldfield.site import Site
from goldfield.types import FloatArray

FAR = 30.0
"""A coil farther than this many of its radii counts as its dipole: within 0.2 % of its field, 0.02 dB."""


@dataclass(frozen=True, eq=False)
class Heard:
    """What a sensor hears at some places.

    Attributes
    ----------
    point_m : ndarray, shape (e, 3)
    field_T : ndarray, shape (e, n)
        Magnitude of the field of each beacon.
    used : ndarray of int, shape (e, K)
        The beacons that the sensor reports: up to the K strongest, and none that is too weak; -1 where there are fewer.
    """

    point_m: FloatArray
    field_T: FloatArray
    used: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Levels:
    """The worst that beacons do to each other, over all places.

    Attributes
    ----------
    ratio : ndarray, shape (n, n)
        For two beacons, where one of them is used: the other one's field over the used one's, the worse way round.
        0 where neither is used.
    together : ndarray of bool, shape (n, n)
        Whether two beacons are used at one place.
    """

    ratio: FloatArray
    together: NDArray[np.bool_]


class Places:
    """All places of a grid, tile by tile, with what a sensor hears there that reports the strongest beacons.

    Parameters
    ----------
    site : Site
    grid : Grid
    strongest : int
        Most beacons that the sensor reports.
    """

    def __init__(self, site: Site, grid: Grid, strongest: int) -> None:
        self._grid, self._strongest = grid, min(strongest, len(site.beacons))
        self._least_T = ENTERS * site.sensor.noise_T / math.sqrt(site.chips)
        self._model = FieldModel(site.beacons)
        moment = self._model.moment_A_m2
        self._strength = MU0_OVER_4PI * np.linalg.norm(moment, axis=1)
        self._axis = moment / np.linalg.norm(moment, axis=1)[:, None]
        self._far_m = FAR * self._model.reach_m

    def heard(self) -> Iterator[Heard]:
        """Yield what is heard at the places of each tile."""
        for tile in self._grid.tiles():
            point = self._grid.points(tile)
            field = self._fields(point)
            best = np.argpartition(-field, self._strongest - 1, axis=1)[:, : self._strongest]
            weak = np.take_along_axis(field, best, axis=1) <= self._least_T
            yield Heard(point, field, np.where(weak, -1, best))

    def _fields(self, point: FloatArray) -> FloatArray:
        """Return the magnitudes of all fields: of near coils exactly, of far ones as dipoles'."""
        centre, low, high = self._model.centre_m, point.min(axis=0), point.max(axis=0)
        range2, along = np.zeros((len(point), len(centre))), np.zeros((len(point), len(centre)))
        for axis in range(3):
            offset = point[:, axis, None] - centre[:, axis]
            range2 += offset * offset
            along += offset * self._axis[:, axis]
        with np.errstate(divide="ignore", invalid="ignore"):
            cosine2 = along * along / range2
            field = self._strength * np.sqrt(1.0 + 3.0 * cosine2) / (range2 * np.sqrt(range2))
        near = np.flatnonzero(np.linalg.norm(centre - np.clip(centre, low, high), axis=1) < self._far_m)
        if len(near):
            exact = self._model.subset(near).field(point)
            field[:, near] = np.linalg.norm(exact, axis=-1)
        return np.asarray(np.nan_to_num(field, nan=np.inf))


def levels_of(places: Places, beacons: int, told: Callable[[int], None] = lambda _: None) -> Levels:
    """Return how strong each beacon is where another is used.

    Parameters
    ----------
    places : Places
    beacons : int
        Beacons of the site.
    told : callable, optional
        Is called with the number of places that are done.
    """
    ratio = np.zeros((beacons, beacons))
    together = np.zeros((beacons, beacons), dtype=np.bool_)
    for heard in places.heard():
        for used in np.unique(heard.used[heard.used >= 0]).tolist():
            rows = np.flatnonzero((heard.used == used).any(axis=1))
            own = heard.field_T[rows, used]
            with np.errstate(invalid="ignore"):  # inside two wires
                worst = (heard.field_T[rows] / own[:, None]).max(axis=0)
            ratio[used] = np.fmax(ratio[used], worst)
            others = heard.used[rows]
            together[used, others[others >= 0]] = True
        told(len(heard.point_m))
    np.fill_diagonal(ratio, 0.0)
    np.fill_diagonal(together, False)
    return Levels(np.maximum(ratio, ratio.T), together)
