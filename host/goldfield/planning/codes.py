"""Which beacons may share a code: who disturbs whom where it matters, and a colouring of that graph.

Two beacons of one code are heard as one. That does no harm where the second is weak beside the first, as far as the
first is used: the field of the second is added to it, so the level of the conflict is the error of the used field.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.planning.maps import Conflicts
from goldfield.planning.neighbours import Ranking
from goldfield.types import FloatArray


def conflicts_of_tile(
    field_T: FloatArray, ranking: Ranking, best: NDArray[np.intp], least_ratio: float
) -> dict[tuple[int, int], float]:
    """Return the pairs of beacons that are in conflict at a tile's points, with the disturbing over the used field.

    Parameters
    ----------
    field_T : ndarray, shape (3, e, n)
        Fields of the beacons that are computed, in the order of the ranking.
    ranking : Ranking
        Beacons that are not computed count with the upper bounds of their fields.
    best : ndarray of int, shape (e, K)
        Columns of the best-K sets.
    least_ratio : float
        Ratio of fields from which on there is a conflict.
    """
    strength = np.sqrt((field_T * field_T).sum(axis=0))
    count = strength.shape[1]
    found: dict[tuple[int, int], float] = {}
    for used in np.unique(best):
        rows = np.flatnonzero((best == used).any(axis=1))
        own = strength[rows, used]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.append((strength[rows] / own[:, None]).max(axis=0), ranking.field_T[count:] / own.min())
        ratio[used] = 0.0
        for other in np.flatnonzero(ratio >= least_ratio):
            found[int(ranking.order[used]), int(ranking.order[other])] = float(ratio[other])
    return found


def keep_worst(worst: dict[tuple[int, int], float], part: dict[tuple[int, int], float]) -> None:
    """Add the conflicts of a tile to those of the tiles before it, in place: the worst ratio of each pair counts.

    Tiles are not collected, as a grid has thousands of them and each has thousands of pairs, nearly always the same.
    """
    for pair, ratio in part.items():
        if ratio > worst.get(pair, 0.0):
            worst[pair] = ratio


def listed(worst: dict[tuple[int, int], float]) -> Conflicts:
    """Return the conflicts in the order of their beacons, with the disturbing over the used field in decibels."""
    pairs = sorted(worst)
    level = 20.0 * np.log10(np.array([worst[pair] for pair in pairs], dtype=float))
    return Conflicts(np.array(pairs, dtype=np.int32).reshape(-1, 2), level)


def shared_codes(conflicts: Conflicts, count: int) -> NDArray[np.int32]:
    """Give beacons numbers, shape (count,), such that no two of one number are in conflict; few, not the fewest.

    The beacon that sees the most numbers among those that it is in conflict with comes first (Brelaz, 1979).

    Examples
    --------
    Three beacons in a row, of which the outer ones do not disturb each other:

    >>> shared_codes(Conflicts(np.array([[0, 1], [1, 2]], dtype=np.int32), np.zeros(2)), 3).tolist()
    [1, 0, 1]
    """
    neighbours: list[set[int]] = [set() for _ in range(count)]
    for first, second in conflicts.pair.tolist():
        neighbours[first].add(second)
        neighbours[second].add(first)
    degree = np.array([len(near) for near in neighbours])
    seen: list[set[int]] = [set() for _ in range(count)]
    saturation, number = np.zeros(count, dtype=np.intp), np.full(count, -1, dtype=np.int32)
    for _ in range(count):
        rank = np.where(number < 0, saturation * (count + 1) + degree, -1)
        chosen = int(rank.argmax())
        number[chosen] = next(value for value in range(count) if value not in seen[chosen])
        for other in neighbours[chosen]:
            seen[other].add(int(number[chosen]))
            saturation[other] = len(seen[other])
    return number
