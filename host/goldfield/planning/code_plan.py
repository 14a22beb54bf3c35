"""Codes for the beacons of a site: balanced ones first, the same one again where it is far away, and what that costs.

Any two of the codes 0 to N have the product -1 in a cycle, whatever beacons they are on; what a beacon that is not
reported leaks into another is the inverse of N, more between two codes whose chips do not cancel, less otherwise
(`leak`). Code N + 1 leaks much into some others, and no sensor looks for it: no beacon gets it. A code that runs ahead
by some chips, which boards can drive, is no further code: a sensor looks for all codes as they begin at chip 0, and
the same code with an offset is to it noise from 1/16 of the field on.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from goldfield.access.gold import code_matrix
from goldfield.errors import UserError, counted
from goldfield.planning.code_colours import Colouring, Groups, bound, coloured
from goldfield.planning.code_levels import Heard, Levels, Places, levels_of
from goldfield.planning.grid import Grid
from goldfield.site import Site
from goldfield.types import FloatArray

FEW_ALIKE = 3
"""One in so many of the codes that a sensor hears may be heard together at another place, too."""


@dataclass(frozen=True, eq=False)
class Interference:
    """The worst error of a used field, over that field, anywhere; levels are ratios, not decibels.

    Attributes
    ----------
    same : float
        By beacons of the same code: the sum of their fields over the used one.
    leak : float
        By beacons of other codes that the sensor does not report: the sum of what they leak. Those that it reports are
        separated exactly.
    total : float
        By both at one place.
    beacon : int
        Index of the used beacon where the total is worst.
    point_m : ndarray, shape (3,)
        That place.
    """

    same: float
    leak: float
    total: float
    beacon: int
    point_m: FloatArray


@dataclass(frozen=True, eq=False)
class CodePlan:
    """Codes for all beacons, and what they cost.

    Attributes
    ----------
    code : ndarray of int, shape (n,)
    interference : Interference
    bound : float
        No choice of so many codes makes the field of the same code smaller than this, over the used one.
    alike : int
        The most beacons around one whose codes are also those of beacons around another one of its code.
    places : int
        Places at which it was computed.
    seconds : float
        What it took.
    """

    code: NDArray[np.intp]
    interference: Interference
    bound: float
    alike: int
    places: int
    seconds: float


def usable_codes(degree: int) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return the codes that beacons may have, balanced ones first, and the sums of the chips of all, by code.

    Examples
    --------
    >>> code, total = usable_codes(10)
    >>> len(code), int((total[code] == -1).sum()), code[:3].tolist(), sorted(set(total[code].tolist()))
    (1024, 768, [2, 3, 4], [-65, -1, 63])
    """
    total = code_matrix(degree, range(1 << degree)).sum(axis=0, dtype=np.int64)
    return np.argsort(total != -1, kind="stable"), total


def leak(total: FloatArray, other: FloatArray, chips: int) -> FloatArray:
    """Return what a unit of one code adds to the field of another one that is separated without it.

    Parameters
    ----------
    total, other : ndarray
        Sums of the chips of the code that is separated and of the other.
    chips : int
        Chips in a cycle.
    """
    return np.asarray(np.abs(-1.0 - total * other / chips) / (chips - total * total / chips))


def planned(site: Site, grid: Grid, strongest: int, told: Callable[[str], None] = lambda _: None) -> CodePlan:
    """Choose a code for each beacon.

    Parameters
    ----------
    site : Site
        The codes that it has do not count.
    grid : Grid
        The places where sensors go.
    strongest : int
        How many beacons a sensor reports: those that it hears best (`Options.strongest`).
    told : callable, optional
        Is called with what is done now.

    Raises
    ------
    UserError
        If a sensor hears no beacon at any of the places.
    """
    begin_s = time.perf_counter()
    places, count = Places(site, grid, strongest), len(site.beacons)
    told(f"fields of {counted(count, 'beacons')} at {counted(len(grid), 'places')}")
    levels = levels_of(places, count)
    if not levels.ratio.any() and count > 1:
        raise UserError(f"no beacon of the site {site.name} is heard anywhere in the box: check places and currents")
    usable, total = usable_codes(site.degree)
    balanced = int((total[usable] == -1).sum())
    best: CodePlan | None = None
    for codes in [balanced, *([len(usable)] if count > balanced else [])]:
        told(f"codes for {counted(count, 'beacons')} out of {codes}")
        groups = coloured(levels.ratio, levels.together, codes, few=max(2, strongest // FEW_ALIKE))
        code = _codes_of(groups, levels, usable[:codes], balanced)
        worst = interference(places, code, total)
        if best is None or worst.total < best.interference.total:
            kept = Colouring(levels.ratio, levels.together, codes)
            for beacon, group in enumerate(groups.tolist()):
                kept.put(beacon, group)
            best = CodePlan(code, worst, bound(levels.ratio, codes), kept.most_alike(), len(grid), 0.0)
    assert best is not None
    return replace(best, seconds=time.perf_counter() - begin_s)


def _codes_of(groups: Groups, levels: Levels, codes: NDArray[np.intp], balanced: int) -> NDArray[np.intp]:
    """Return the code of each beacon: groups take codes in the order of their first beacons.

    The groups that need a code whose chips do not cancel are those that do least to each other.
    """
    names, first = np.unique(groups, return_index=True)
    spare = len(names) - balanced
    between = np.zeros((len(names), len(names)))
    poor: list[int] = []
    if spare > 0:
        member = [np.flatnonzero(groups == name) for name in names]
        to_group = np.stack([levels.ratio[:, rows].max(axis=1) for rows in member], axis=1)
        between = np.stack([to_group[rows].max(axis=0) for rows in member])
        np.fill_diagonal(between, 0.0)
        worst = np.zeros(len(names))
        while len(poor) < spare:
            rank = np.where(np.isin(np.arange(len(names)), poor), np.inf, worst)
            chosen = int(rank.argmin())
            poor.append(chosen)
            worst = np.maximum(worst, between[chosen])
    last = np.isin(np.arange(len(names)), poor)
    order = np.lexsort((first, last))
    code_of = np.empty(len(names), dtype=np.intp)
    code_of[order] = codes[: len(names)]
    return np.asarray(code_of[np.searchsorted(names, groups)])


def interference(places: Places, code: NDArray[np.intp], total: NDArray[np.int64]) -> Interference:
    """Return the worst that beacons with these codes do to each other.

    Fields are added as if all pointed the same way, so that no place and no attitude of a sensor has more.

    Parameters
    ----------
    places : Places
    code : ndarray of int, shape (n,)
    total : ndarray of int
        Sums of the chips of all codes, by code.
    """
    order = np.argsort(code, kind="stable")
    first = np.flatnonzero(np.diff(code[order], prepend=-1))
    group = np.unique(code, return_inverse=True)[1]
    kinds, kind = np.unique(total[code], return_inverse=True)
    leaks = leak(kinds[:, None].astype(float), kinds[None, :].astype(float), len(total) - 1)
    found = Interference(0.0, 0.0, 0.0, 0, np.full(3, np.nan))
    for heard in places.heard():
        known = (heard.used >= 0) & ~np.isinf(heard.field_T).any(axis=1, keepdims=True)  # nobody is inside a wire
        field = np.where(np.isinf(heard.field_T), 0.0, heard.field_T)
        own = np.where(known, np.take_along_axis(field, heard.used, axis=1), np.inf)
        of_group = np.add.reduceat(field[:, order], first, axis=1)
        same = np.take_along_axis(of_group, group[heard.used], axis=1) - own
        reported = np.zeros((len(field), len(first) + 1), dtype=np.bool_)  # the last column is that of none
        np.put_along_axis(reported, np.where(known, group[heard.used], len(first)), True, axis=1)
        unheard = np.where(reported[:, group], 0.0, field)
        of_kind = np.stack([unheard[:, kind == one].sum(axis=1) for one in range(len(kinds))], axis=1)
        leaked = np.einsum("ek,ejk->ej", of_kind, leaks[kind[heard.used]])
        same, leaked = (np.where(known, np.maximum(part, 0.0) / own, 0.0) for part in (same, leaked))
        found = _worse(found, heard, same, leaked)
    return found


def _worse(found: Interference, heard: Heard, same: FloatArray, leaked: FloatArray) -> Interference:
    """Return the worst of what was found so far and what is at the places of a tile, shape (e, K)."""
    both = same + leaked
    row, column = np.unravel_index(int(both.argmax()), both.shape)
    result = replace(found, same=max(found.same, float(same.max())), leak=max(found.leak, float(leaked.max())))
    if both[row, column] <= found.total:
        return result
    beacon = int(heard.used[row, column])
    return replace(result, total=float(both[row, column]), beacon=beacon, point_m=heard.point_m[row])
