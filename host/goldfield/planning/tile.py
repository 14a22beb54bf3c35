"""The figures of one tile: the unit of work, which any process of any machine computes alike."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from goldfield.access.of_site import SiteAccess
from goldfield.field import FieldModel
from goldfield.locate.poses import WEAK_ATTITUDE_RAD, WEAK_POSITION
from goldfield.locate.site_errors import errors_of
from goldfield.locate.uncertainty import gauss_newton_covariance
from goldfield.planning.codes import conflicts_of_tile
from goldfield.planning.grid import Tile
from goldfield.planning.images import Neighbourhood, ambiguous
from goldfield.planning.information import (
    ORIENTATIONS,
    Joint,
    gram,
    joint_covariance,
    pose_columns,
    turned_distortions,
)
from goldfield.planning.maps import Figures
from goldfield.planning.neighbours import FEWEST, Ranking, ranked
from goldfield.planning.request import Request
from goldfield.planning.single_beacons import best_of, contributions, protection
from goldfield.site import Site
from goldfield.types import FloatArray


@dataclass(frozen=True, eq=False)
class TileResult:
    """What is computed at a tile: figures of its points, shape (e,), and conflicts between beacons there."""

    tile: Tile
    figures: Figures
    conflicts: dict[tuple[int, int], float]


def noise_of(site: Site) -> FloatArray:
    """Return the standard deviation of each beacon's separated components, T, shape (n,), for a whole cycle.

    With Gold codes it is the noise of a sample over the root of the number of chips, as for
    `goldfield.locate.uncertainty.cramer_rao_bound`.
    """
    if site.access == "cdma":
        return np.full(len(site.beacons), site.sensor.noise_T / np.sqrt(site.chips))
    return np.sqrt(np.diag(SiteAccess(site).covariance_T2))


class TileEngine:
    """Computes the tiles of a request.

    Parameters
    ----------
    request : Request
    """

    def __init__(self, request: Request) -> None:
        self._request = request
        site = request.site
        self.model, self._sigma = FieldModel(site.beacons), noise_of(site)
        self._errors = errors_of(site.beacons, site.sensor)
        exact = self._errors is None or not (self._errors.gain_sd or self._errors.sensor_axis_sd_rad)
        self._distortions = (
            [None]
            if exact or self._errors is None
            else [turned_distortions(self._errors, rotation) for rotation in ORIENTATIONS]
        )

    @np.errstate(all="ignore")  # inside a wire nothing is finite, and the figures say so
    def compute(self, tile: Tile) -> TileResult:
        """Compute a tile."""
        point, settings = self._request.grid.points(tile), self._request.settings
        ranking = ranked(self.model, self._sigma, point.min(axis=0), point.max(axis=0))
        near, field, column, joint, truncation = self._told(point, ranking)
        information = gram(column)
        influence, weight = contributions(column, joint.covariance)
        best = best_of(weight, settings.best)
        position, attitude, spread = self._bounds(information, joint)
        bound = joint.covariance[:, :3, :3] + joint.free[:, :3, :3]
        broken = ~np.isfinite(field).all(axis=(0, 2))
        level, beacon = np.full(len(point), np.inf), np.zeros(len(point), dtype=np.intp)
        whole = np.flatnonzero(~broken)
        if len(whole):
            level[whole], beacon[whole] = protection(column[whole], influence[whole], weight[whole], bound[whole])
        places = np.full((len(point), settings.best), -1, dtype=np.int32)
        places[:, : best.shape[1]] = ranking.order[best]
        figures = Figures(
            position_sd_m=np.where(broken, np.inf, position),
            attitude_sd_rad=np.where(broken, np.inf, attitude),
            protection_m=level,
            protection_beacon=ranking.order[beacon].astype(np.int32),
            dilution_m_T=np.where(broken, np.inf, self._dilution(near, point)),
            best=places,
            best_position_sd_m=np.where(broken, np.inf, self._of_best(column, best)),
            weak=broken | self._weak(near, point, joint),
            ambiguous=~broken & ambiguous(near, point, field, weight),
            truncation=np.where(broken, 0.0, truncation),
            orientation_spread=np.where(broken, 1.0, spread),
        )
        ratio = 10.0 ** (-settings.conflict_dB / 20.0)
        return TileResult(tile, figures, conflicts_of_tile(field[:, whole], ranking, best[whole], ratio))

    def _told(
        self, point: FloatArray, ranking: Ranking
    ) -> tuple[Neighbourhood, FloatArray, FloatArray, Joint, FloatArray]:
        """Return the beacons that are computed, their fields and columns, the joint covariance, the truncation."""
        most, tolerance = len(ranking), self._request.settings.truncation
        probes = np.linspace(0, len(point) - 1, PROBES).astype(np.intp)
        count = most if tolerance == 0.0 else self._count(point[probes], ranking, min(FEWEST, most))
        while True:
            near = self.near(ranking, count)
            field, column, _ = near.columns(point)
            joint = joint_covariance(gram(column), near.distortion)
            truncation = ranking.error_with(count, point, joint.covariance)
            worst = np.flatnonzero(truncation > tolerance)
            if count == most or not len(worst):
                return near, field, column, joint, truncation
            count = self._count(point[worst[[truncation[worst].argmax()]]], ranking, min(most, count + 4))

    def near(self, ranking: Ranking, count: int) -> Neighbourhood:
        """Return the first beacons of a ranking."""
        rows = ranking.order[:count]
        errors = None if self._errors is None else self._errors.subset(rows)
        half_space = self._request.site.half_space
        return Neighbourhood(self.model.subset(rows), self._sigma[rows], errors, self._distortions[0], half_space)

    def _count(self, point: FloatArray, ranking: Ranking, count: int) -> int:
        """Return how many beacons points need, at least ``count``, until what the others tell is within tolerance."""
        while count < len(ranking):
            near = self.near(ranking, count)
            joint = joint_covariance(gram(near.columns(point)[1]), near.distortion)
            told = np.asarray(np.isfinite(joint.covariance).all(axis=(1, 2)))  # not inside a wire
            if not joint.free[told].any():
                error = ranking.error(point[told], joint.covariance[told])
                enough = (error <= self._request.settings.truncation).all(axis=0)
                return max(count, int(enough.argmax()) + 1)
            count = min(len(ranking), 2 * count)
        return count

    def _bounds(self, information: FloatArray, joint: Joint) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the bounds on position and attitude, rms over the orientations, and largest over rms of the first."""
        joints = [joint, *(joint_covariance(information, other) for other in self._distortions[1:])]
        variance = np.stack([np.einsum("ekk->ek", one.covariance[:, :6, :6] + one.free) for one in joints])
        place, turn = variance[..., :3].sum(axis=2), variance[..., 3:].sum(axis=2)
        if self._errors is not None:
            turn = turn + 3.0 * self._errors.common_turn_rad2
        mean = place.mean(axis=0)
        return np.sqrt(mean), np.sqrt(turn.mean(axis=0)), np.sqrt(place.max(axis=0) / mean)

    def _weak(self, near: Neighbourhood, point: FloatArray, joint: Joint) -> NDArray[np.bool_]:
        """Tell where the bound alone makes a pose weak, by the locator's limits."""
        covariance = joint.covariance[:, :6, :6] + joint.free
        told = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
        covariance = np.where(told[:, None, None], covariance, np.eye(6))
        shift = np.sqrt(np.linalg.eigvalsh(covariance[:, :3, :3])[:, 2])
        turn2 = np.linalg.eigvalsh(covariance[:, 3:, 3:])[:, 2]
        if self._errors is not None:
            turn2 = turn2 + self._errors.common_turn_rad2
        nearest = np.linalg.norm(point[:, None] - near.model.centre_m, axis=2).min(axis=1)
        return np.asarray(~told | (shift > WEAK_POSITION * nearest) | (turn2 > WEAK_ATTITUDE_RAD**2))

    def _of_best(self, column: FloatArray, best: NDArray[np.intp]) -> FloatArray:
        """Return the bound on the position from the best-K sets alone."""
        information = gram(np.take_along_axis(column, best[:, :, None, None], axis=1))
        return self._bounds(information, joint_covariance(information, self._distortions[0]))[0]

    @staticmethod
    def _dilution(near: Neighbourhood, point: FloatArray) -> FloatArray:
        """Return `goldfield.locate.uncertainty.dilution_of_precision` of the beacons that are computed."""
        column = pose_columns(*near.model.evaluate(point.T)).transpose(2, 3, 1, 0)
        return np.asarray(np.sqrt(np.einsum("ekk->e", gauss_newton_covariance(gram(column))[:, :3, :3])))


PROBES = 9
"""Points of a tile by which the number of its beacons is chosen; the truncation error is then that of every point."""

_engines: WeakKeyDictionary[Request, TileEngine] = WeakKeyDictionary()


def compute_tile(request: Request, tile: Tile) -> TileResult:
    """Compute a tile of a request; what its tiles have in common is kept as long as the request."""
    if request not in _engines:
        _engines[request] = TileEngine(request)
    return _engines[request].compute(tile)
