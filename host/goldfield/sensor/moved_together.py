"""Anchors that were moved together: of the pairs of beacons whose fields have changed, which move explains all.

What stands on one mast, or was carried as one, sees no change among itself, and neither do the others: all changes are
between the two sides. The anchors see how the sides moved against each other and not which of them did. Where one side
is smaller, it is taken for the one that was moved.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from goldfield.types import Explanation, Finding

LEAST_TOGETHER = 2
"""A single beacon is not named here but by the changes themselves (`anchors.CLEAR`): its metal and its current show so,
too."""


def sides(changed: NDArray[np.bool_]) -> tuple[list[int], list[int]] | None:
    """Split beacons so that all changes are between the sides.

    Parameters
    ----------
    changed : ndarray of bool, shape (n, n)
        Whether the field of one beacon has changed where the other one is: of each pair one order is enough.

    Returns
    -------
    tuple of two lists of int, or None
        The rows of both sides, the smaller first; None if there is no such split, or more than one. Beacons whose pairs
        are all unchanged are on neither side.
    """
    pairs = changed | changed.T
    touched = np.flatnonzero(pairs.any(axis=1))
    if not len(touched):
        return None
    side = {int(touched[0]): 0}
    waiting = [int(touched[0])]
    while waiting:
        row = waiting.pop()
        for other in np.flatnonzero(pairs[row]).tolist():
            if other not in side:
                side[other] = 1 - side[row]
                waiting.append(other)
            elif side[other] == side[row]:
                return None
    if len(side) < len(touched):
        return None
    first, second = ([row for row in sorted(side) if side[row] == which] for which in (0, 1))
    return (first, second) if len(first) <= len(second) else (second, first)


def moved_together(changed: NDArray[np.bool_], names: Sequence[str]) -> Finding | None:
    """Say what changes mean that no single beacon explains; None if there are none.

    The finding is ``moved`` with the smaller side, which is then left out. Otherwise it is ``unknown`` with all beacons
    whose pairs have changed: no pose that rests on them can be relied on.
    """

    def told(rows: Sequence[int]) -> str:
        ids = [names[row] for row in rows]
        return ids[0] if len(ids) == 1 else f"{', '.join(ids[:-1])} and {ids[-1]}"

    split = sides(changed)
    if split is not None and LEAST_TOGETHER <= len(split[0]) < len(split[1]):
        smaller, larger = split
        text = f"anchors see that {told(smaller)} were moved together, or {told(larger)}: survey them anew"
        return Finding(Explanation.MOVED, tuple(names[row] for row in smaller), text)
    touched = np.flatnonzero((changed | changed.T).any(axis=1)).tolist()
    if not touched:
        return None
    if split is not None:
        text = f"anchors see that {told(split[0])} moved against {told(split[1])}, and not which of them: check both"
    else:
        text = f"anchors see changes at {told(touched)} that the move of none explains: check where they stand"
    return Finding(Explanation.UNKNOWN, tuple(names[row] for row in touched), text)
