"""Epochs of a walk that only a map of metal explains, in places where nobody walked.

The fields of an epoch that went wrong as a whole (a sensor without sync, beacons that were just switched on) fit no
pose of the room. Polynomials grow outside of the room with up to the fifth power of the distance, so that far out they
explain any fields at all: one such epoch of 600 then counts as sound there, bends the map of the room, and stretches
the room in which poses are believed. So before a map is made these epochs are looked for, with the freest map that
there is, and left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.site import Site
from goldfield.survey.data import Free, Outlier, SurveyData, SurveyResult
from goldfield.survey.metal import no_metal, polynomials_around
from goldfield.survey.outcome import Solution
from goldfield.survey.procedure import Progress, solve

STRAY = 1.5
"""An epoch strays if its pose is further from the middle of the walk than this by the radius that holds 95 % of it."""
ROUNDS = 3
"""How often a map is made to find more."""


@dataclass(frozen=True, eq=False)
class Gathered:
    """A walk without its strays.

    Attributes
    ----------
    data : SurveyData
        Without the epochs that stray and their known points.
    kept : ndarray of bool, shape (e,)
        The epochs of the walk that ``data`` has.
    strays : tuple of Outlier
        The others.
    """

    data: SurveyData
    kept: NDArray[np.bool_]
    strays: tuple[Outlier, ...]

    def all_told(self, result: SurveyResult) -> SurveyResult:
        """Return a result of ``data`` with no pose for each stray, which is among its outliers."""
        position = np.full((len(self.kept), 3), np.nan)
        rotation = np.full((len(self.kept), 3, 3), np.nan)
        position[self.kept], rotation[self.kept] = result.position_m, result.rotation
        outliers = tuple(sorted((*self.strays, *result.outliers), key=lambda outlier: outlier.epoch))
        return replace(result, outliers=outliers, position_m=position, rotation=rotation)


def gathered(site: Site, data: SurveyData, free: frozenset[Free], tell: Progress) -> Gathered:
    """Leave out the epochs that stray, without metal and with the freest map.

    Raises
    ------
    UserError, SystemFailure
        As in `goldfield.survey.procedure.solve`.
    """
    tell("epochs that stray", 0.0)
    plain = solve(site, data, free, metal=no_metal(len(site.beacons)), judged=False)
    kept = np.ones(len(data.epochs), dtype=bool)
    freedom = np.maximum(plain.problem.readings.count - 6.0, 1.0)
    residual = np.sqrt(plain.squares / freedom)
    found = plain
    for _ in range(ROUNDS):
        astray = _astray(found)
        if found is not plain and not astray.any():
            break
        kept[np.flatnonzero(kept)[astray]] = False
        some, state = data.of_epochs(kept), plain.state.of_epochs(kept)
        metal = polynomials_around(state.sensor_m, len(site.beacons))
        found = solve(site, some, free, metal=metal, start=state, judged=False)
    strays = tuple(Outlier(data.epochs[row].epoch, (), float(residual[row])) for row in np.flatnonzero(~kept))
    return Gathered(data.of_epochs(kept), kept, strays)


def _astray(solution: Solution) -> NDArray[np.bool_]:
    """Tell which epochs have their pose far from where the others were, or none, shape (e,)."""
    place = polynomials_around(solution.state.sensor_m, 0)
    away = np.linalg.norm(solution.state.sensor_m - place.centre_m, axis=1)
    return np.asarray(~(away <= STRAY * place.radius_m))
