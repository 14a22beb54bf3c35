"""Which beacons share a code: as few decibels of interference as can be found for so many codes.

The worst level within any group of beacons that share a code is to be small: a bottleneck colouring. For a limit,
beacons are given groups one by one, first the one that has the fewest groups left in which nothing exceeds the limit
(Brelaz, 1979); the smallest limit for which that succeeds is found by bisection, and moves of single beacons and of
pairs then lower the worst level further. Nobody proves the result to be the best; `bound` says what no plan can be
better than.

A pattern that repeats itself, as that of a lattice would, makes two places sound alike. Where it does, groups are
given once more, with a limit that is a little higher: among those that are left each beacon then takes one by which the
fewest of its neighbours would be confused with those of another place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.types import FloatArray

BISECTIONS = 14
"""Limits that are tried: to 1/16,384 of the range of the levels, in decibels."""
MOVES = 20_000
"""Most moves by which a colouring is improved, over the number of beacons."""
MOST_STARTS, WORK = 40, 400
"""How often the best limit is looked for at most, and that times the number of beacons: small sites cost nothing."""
EXCHANGES = 16
"""Most beacons that are asked, in a move, to make place for another one."""
SLACKS_DB = (0.0, 1.0, 2.0, 3.0, 4.5, 6.0)
"""By how much the limit is raised, one after the other, while two places sound too much alike."""
FLOOR = 1e-12
"""Levels below it, -240 dB, are alike: far below everything that is measured."""

SAME = 1e-3
"""Limits nearer to each other, 0.01 dB, are not told apart."""

Groups = NDArray[np.int32]


class Colouring:
    """Beacons in groups, while they are being put there.

    Parameters
    ----------
    ratio : ndarray, shape (n, n)
        Symmetric; what two beacons do to each other if they share a code.
    together : ndarray of bool, shape (n, n)
        Whether two beacons are used at one place.
    count : int
        Groups that there are.

    Attributes
    ----------
    group : ndarray of int32, shape (n,)
        -1: none yet.
    cost : ndarray, shape (n, count)
        The worst of a beacon and those in a group.
    """

    def __init__(self, ratio: FloatArray, together: NDArray[np.bool_], count: int) -> None:
        self._ratio = ratio
        self._near = [np.flatnonzero(row) for row in together]
        self.group: Groups = np.full(len(ratio), -1, dtype=np.int32)
        self.cost = np.zeros((len(ratio), count), order="F")
        self._members: list[list[int]] = [[] for _ in range(count)]

    def put(self, beacon: int, group: int) -> None:
        """Put a beacon, which is in no group, in one."""
        self.group[beacon] = group
        self._members[group].append(beacon)
        np.maximum(self.cost[:, group], self._ratio[:, beacon], out=self.cost[:, group])

    def take(self, beacon: int) -> None:
        """Take a beacon out of its group."""
        group = int(self.group[beacon])
        self.group[beacon] = -1
        self._members[group].remove(beacon)
        self.cost[:, group] = self._ratio[:, self._members[group]].max(axis=1, initial=0.0)

    def alike(self, beacon: int) -> NDArray[np.intp]:
        """Return for each group how many neighbours of a beacon and of one in that group have the same groups."""
        shared = np.zeros(len(self.group), dtype=np.intp)
        for neighbour in self._near[beacon].tolist():
            if self.group[neighbour] < 0:
                continue
            for twin in self._members[self.group[neighbour]]:
                if twin != neighbour:
                    shared[self._near[twin]] += 1
        result = np.zeros(self.cost.shape[1], dtype=np.intp)
        told = np.flatnonzero((self.group >= 0) & (shared > 0))
        np.maximum.at(result, self.group[told], shared[told])
        return result

    def most_alike(self) -> int:
        """Return the most neighbours that have the same groups at two places; 0 where no group has two beacons."""
        return max((int(self.alike(one)[group]) for one, group in enumerate(self.group.tolist())), default=0)

    def worst(self) -> float:
        """Return the worst level of two beacons in one group."""
        return float(self.cost[np.arange(len(self.group)), self.group].max(initial=0.0))

    def fill(self, limit: float, random: np.random.Generator, *, unlike: bool = False, anyhow: bool = False) -> bool:
        """Put all beacons into groups in which nothing exceeds a limit; tells whether that succeeded.

        With ``unlike`` a beacon takes a group by which few of its neighbours would be confused with others, with
        ``anyhow`` any that is left.
        """
        left = np.full(len(self.group), self.cost.shape[1])
        first = random.permutation(len(self.group))
        for _ in range(len(self.group)):
            waiting = first[self.group[first] < 0]
            beacon = int(waiting[left[waiting].argmin()])
            open_groups = np.flatnonzero(self.cost[beacon] <= limit)
            if not len(open_groups):
                return False
            if unlike:
                alike = self.alike(beacon)[open_groups]
                open_groups = open_groups[alike == alike.min()]
            # The one that is already the worst for it is taken: what is left open stays so for others.
            rank = random.random(len(open_groups)) if anyhow else self.cost[beacon, open_groups]
            group = int(open_groups[rank.argmax()])
            was = self.cost[:, group] <= limit
            self.put(beacon, group)
            left -= was & (self.cost[:, group] > limit)
        return True

    def improve(self) -> None:
        """Lower the worst level by moves of one or two beacons, until none helps."""
        for _ in range(MOVES // len(self.group)):
            own = self.cost[np.arange(len(self.group)), self.group]
            worst = float(own.max(initial=0.0))
            if worst <= FLOOR or not any(self._moved(int(one), worst) for one in np.flatnonzero(own >= worst)):
                return

    def _moved(self, beacon: int, worst: float) -> bool:
        """Move a beacon to where it is below a level, another making place for it if need be."""
        origin = int(self.group[beacon])
        self.take(beacon)
        target = int(self.cost[beacon].argmin())
        if self.cost[beacon, target] < worst:
            self.put(beacon, target)
            return True
        tries = EXCHANGES
        for other in np.argsort(-self._ratio[beacon]).tolist():
            group = int(self.group[other])
            if tries == 0 or self._ratio[beacon, other] < worst:
                break
            if other == beacon or group == origin or self._others(beacon, group, other) >= worst:
                continue
            tries -= 1
            self.take(other)
            self.put(beacon, group)
            place = int(self.cost[other].argmin())
            if self.cost[other, place] < worst:
                self.put(other, place)
                return True
            self.take(beacon)
            self.put(other, group)
        self.put(beacon, origin)
        return False

    def _others(self, beacon: int, group: int, but: int) -> float:
        return max((float(self._ratio[beacon, one]) for one in self._members[group] if one != but), default=0.0)


def coloured(ratio: FloatArray, together: NDArray[np.bool_], count: int, *, few: int = 4, seed: int = 1) -> Groups:
    """Return a group for each beacon, shape (n,), 0 to ``count`` - 1, such that the worst level within one is small.

    Parameters
    ----------
    ratio, together : ndarray, shape (n, n)
        As for `Colouring`.
    count : int
        Groups that there are.
    few : int
        Neighbours of a beacon that may have the groups of those of another one; where it takes more, the worst level
        may be some decibels larger for it (`SLACKS_DB`).
    seed : int
        The seed of the order in which beacons are taken that are equally pressed.

    Examples
    --------
    Four beacons in a row, two codes: neighbours differ.

    >>> level = np.array([[0, 9, 2, 1], [9, 0, 9, 2], [2, 9, 0, 9], [1, 2, 9, 0]], dtype=float)
    >>> coloured(level, level > 5, 2).tolist() in ([0, 1, 0, 1], [1, 0, 1, 0])
    True
    """
    if len(ratio) <= count:
        return np.arange(len(ratio), dtype=np.int32)
    random = np.random.default_rng(seed)
    starts = max(1, min(MOST_STARTS, WORK // len(ratio)))
    tried = (_start(ratio, together, count, random, anyhow=start % 2 == 1) for start in range(starts))
    best = min(tried, key=Colouring.worst)
    limit, least = best.worst(), best.most_alike()
    for slack_dB in SLACKS_DB:
        if least <= few:
            break
        trial = Colouring(ratio, together, count)
        if trial.fill(limit * 10.0 ** (slack_dB / 20.0), random, unlike=True) and (alike := trial.most_alike()) < least:
            best, least = trial, alike
    return best.group


def _start(
    ratio: FloatArray, together: NDArray[np.bool_], count: int, random: np.random.Generator, *, anyhow: bool
) -> Colouring:
    """Return the colouring of the smallest limit that bisection finds, improved."""
    positive = ratio[ratio > FLOOR]
    best = Colouring(ratio, together, count)
    best.fill(np.inf, random)
    high = float(np.log(max(best.worst(), FLOOR)))
    low = float(np.log(positive.min())) - 1.0 if len(positive) else high
    for _ in range(BISECTIONS):
        if high - low <= SAME:
            break
        middle = 0.5 * (low + high)
        trial = Colouring(ratio, together, count)
        if trial.fill(float(np.exp(middle)), random, anyhow=anyhow):
            best, high = trial, min(middle, float(np.log(max(trial.worst(), FLOOR))))
        else:
            low = middle
    best.improve()
    return best


def bound(ratio: FloatArray, count: int, centres: int = 64) -> float:
    """Return a level that every choice of so many groups reaches: of any ``count`` + 1 beacons two share one.

    Taken are the beacons that do the most to each of some, and of those the best set; 0 where all may differ.
    """
    if len(ratio) <= count:
        return 0.0
    best = 0.0
    for centre in np.unique(np.linspace(0, len(ratio) - 1, centres).astype(int)).tolist():
        rank = ratio[centre].copy()
        rank[centre] = np.inf
        chosen = np.argpartition(-rank, count)[: count + 1]
        among = ratio[np.ix_(chosen, chosen)]
        np.fill_diagonal(among, np.inf)
        best = max(best, float(among.min()))
    return best
