"""The poses of a day held to the truth: where the sensor was in each cycle, what was lost, and why."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from goldfield.sensor.pipeline import Epoch
from goldfield.types import Status
from hil_sim.world.motion import Motion
from tests.bench.day_faults import UNCOVERED, Struck, is_of
from tests.campaign.stage import CYCLE_S
from tests.campaign.trial import LATE_CYCLES, SNAP_S, SURE, TRANSFER_S, words

CYCLES = 1 << 20
"""Cycles are numbered modulo this."""
KEPT = 1000
"""Cycles of which it is known when they were."""
NEAR = 100
"""A number so near to the last one, and then to the first, has wrapped between them."""


@dataclass(frozen=True)
class Seen:
    """A pose with the virtual times at which the host had it and its last message came, and what was struck then."""

    now_s: float
    came_s: float
    epoch: Epoch
    struck: Struck | None


@dataclass
class Judge:
    """Holds poses to the truth; `judge` takes them by the dozen, in order.

    Attributes
    ----------
    motion : Motion
        The sensor's.
    cycles : int
        Cycles that the wire told so far.
    poses : Counter
        Poses by status.
    lost : Counter
        Cycles without a pose, by the kind of the fault; "" is none.
    wrong : list of str
        Poses whose error is more than they promise, as sentences.
    beyond : Counter
        Those of kinds that no protection level covers, by kind.
    not_plain : Counter
        What poses say outside of faults.
    sound : int
        Poses outside of faults.
    worst_m : float
        Largest error of a pose that is ok.
    wraps : int
        How often the number of the cycle began again from 0 behind the last one.
    renumbered : int
        How often the cycles were numbered anew.
    """

    motion: Motion
    cycles: int = 0
    poses: Counter[str] = field(default_factory=Counter)
    lost: Counter[str] = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    beyond: Counter[str] = field(default_factory=Counter)
    not_plain: Counter[str] = field(default_factory=Counter)
    sound: int = 0
    worst_m: float = 0.0
    worst_said: str = ""
    wraps: int = 0
    renumbered: int = 0
    _numbers: deque[int] = field(default_factory=lambda: deque(maxlen=KEPT))
    _middles_s: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))
    _offsets: list[int] = field(default_factory=list)
    _waiting: list[Seen] = field(default_factory=list)
    _latest: int | None = None
    _latest_epoch: int = 0

    def judge(self, seen: list[Seen], cycles: list[tuple[int, float, float]]) -> None:
        """Take poses, and the cycles that the wire has told since the last call; both may be none.

        A pose waits until the wire has told when its cycle was: while nobody drives it, it tells nothing.
        """
        self._numbers.extend(number for number, _, _ in cycles)
        self._middles_s.extend(middle_s for _, middle_s, _ in cycles)
        self.cycles += len(cycles)
        self._waiting += seen
        told_s = self._middles_s[-1] if self._middles_s else 0.0
        ready = [one for one in self._waiting if one.came_s <= told_s]
        self._waiting = self._waiting[len(ready) :]
        if not ready:
            return
        middles_s = list(self._middles_s)
        times_s = np.array([self._middle_s(one, middles_s) for one in ready])
        places = self.motion.poses(times_s)[0]
        for one, time_s, place in zip(ready, times_s, places, strict=True):
            self._hold(one, float(time_s), place)

    def _middle_s(self, one: Seen, middles_s: list[float]) -> float:
        """Return the virtual time of the middle of a pose's cycle, and count the cycles that are lost before it.

        On a sound link the arrival of its last message tells which it was. While a fault is on, a cycle may come late:
        then its number does, with what the numbers differed by from the wire's cycles before, unless the cycles were
        numbered anew, or two drove the wire. No cycle comes before it was, and one that comes much later, as a board
        had kept it, changes nothing for those behind it: so the last two differences count.
        """
        arrived_s = one.came_s - TRANSFER_S - 0.5 * CYCLE_S
        at = min(bisect_left(middles_s, arrived_s), len(middles_s) - 1)
        at = at - 1 if at > 0 and arrived_s - middles_s[at - 1] < middles_s[at] - arrived_s else at
        nearest = self._numbers[at]
        behind = self._behind((nearest - one.epoch.pose.epoch) % CYCLES, one)
        self._missed(nearest - behind, one)
        known = 0 <= at - behind < len(middles_s)
        snapped_s = middles_s[at - behind] if known else middles_s[at] - behind * CYCLE_S
        return snapped_s if behind or abs(snapped_s - arrived_s) < SNAP_S else arrived_s

    def _behind(self, offset: int, one: Seen) -> int:
        """Return by how many cycles a pose is late, whose number differs by an offset from that of its arrival."""
        if one.struck is not None and not one.struck.kind.by_arrival:
            for base in self._offsets:
                behind = (offset - base + CYCLES // 2) % CYCLES - CYCLES // 2
                if 0 <= behind <= LATE_CYCLES:
                    return behind
        self.renumbered += bool(self._offsets) and offset != self._offsets[0]
        self._offsets = [offset, *self._offsets[:1]]
        return 0

    def _missed(self, cycle: int, one: Seen) -> None:
        """Count the cycles between two poses, and the wraps of their numbers."""
        if self._latest is not None:
            missed = max(0, cycle - self._latest - 1)
            kind = "" if one.struck is None else one.struck.kind.name
            if missed:
                self.lost[kind] += missed
            self.wraps += self._latest_epoch > CYCLES - NEAR and one.epoch.pose.epoch < NEAR
        self._latest, self._latest_epoch = cycle, one.epoch.pose.epoch

    def _hold(self, one: Seen, time_s: float, place: NDArray[np.float64]) -> None:
        pose, kind = one.epoch.pose, None if one.struck is None else one.struck.kind
        self.poses[pose.status.value] += 1
        if kind is None:
            self.sound += 1
            said = words(one.epoch)
            if said:
                self.not_plain[said] += 1
        if pose.status not in SURE:
            return
        error_m = float(np.linalg.norm(pose.position_m - place))
        if not error_m <= pose.protection_m:
            if kind is not None and is_of(kind, UNCOVERED):
                self.beyond[kind.name] += 1
            else:
                self.wrong.append(
                    f"at {time_s:.2f} s {pose.status.value}, off by {1e3 * error_m:.0f} mm, promised "
                    f"{1e3 * pose.protection_m:.0f} mm, behind {kind.name if kind else 'no fault'}"
                )
        elif pose.status is Status.OK and error_m > self.worst_m:
            self.worst_m, self.worst_said = error_m, kind.name if kind else "no fault"
