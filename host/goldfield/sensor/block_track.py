"""A track block by block: poses at the times that were asked for, and one at the end of each code cycle.

Blocks of chips come 330 times a second and say when they ended, on the sensor's clock. What follows the sensor
(`Follower`) has its state in the middle of the latest block, so a time within that block is never further away than
half of it, 1.5 ms, and its pose is given out with the block. A time of which no block came is extrapolated from the
blocks before, as soon as the next one is there, for at most `GAP_S`; in a longer gap there are no poses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from goldfield.link.reports import CYCLE_MODULUS, Report
from goldfield.site import Site
from goldfield.types import Block, Pose

GAP_S = 1.0
"""The longest time over which poses are extrapolated while no block comes."""

SAME_RATE = 0.01
"""A rate that differs from that of the blocks by a smaller share is theirs: each pose is that of a block's end."""

NEAR = 1e-6
"""Share of a step by which times that are the same differ by rounding. Where they differ because the sensor's clock
goes at another rate than the nominal one, half a block or half a chip is allowed for."""

CURRENT_CHANGED = 0.01
"""A measured current that differs by a larger share from the one in use is used from then on."""

CYCLES_KEPT = 8
"""Cycles whose last pose is kept until their reports are there, which may be late by two."""


class Follower(Protocol):
    """What follows one sensor by its blocks, as `goldfield.track.blocks.BlockFilter` does."""

    def update(self, block: Block, without: Sequence[str] = ()) -> Pose | None:
        """Take the next block; return the pose at its end, None if it told nothing."""
        ...

    def pose_at(self, time_s: float) -> Pose:
        """Return the pose at a time near that of the latest block."""
        ...


class BlockTrack:
    """Follows one sensor: give it every block in the order of time, it returns the poses that were asked for.

    Parameters
    ----------
    site : Site
    make : callable
        Makes what follows the sensor on a site: at the begin, when the sensor's clock begins again, and when the
        current of a beacon has changed.
    rate_hz : float, optional
        Poses a second, at whole multiples of its inverse on the sensor's clock, or at the ends of the blocks if it is
        their rate (`SAME_RATE`); None: only those at the ends of the cycles (`of_cycle`).

    Raises
    ------
    UserError
        If the sensor cannot be followed on the site by its blocks.
    """

    def __init__(self, site: Site, make: Callable[[Site], Follower], rate_hz: float | None = None) -> None:
        self._site = site
        self._chip_s = site.cycle_s / site.chips
        self._make = make
        self._rate_hz = rate_hz
        self._current = {beacon.id: 1.0 for beacon in site.beacons}
        self._of_cycles: dict[int, Pose] = {}
        self._last: Block | None = None
        self._follower = make(site)

    @property
    def time_s(self) -> float:
        """End of the latest block, on the sensor's clock; minus infinity before there was one."""
        return -math.inf if self._last is None else self._last.time_s

    def update(self, block: Block, without: Sequence[str] = (), ratio: Mapping[str, float] | None = None) -> list[Pose]:
        """Take the next block; return the poses at the asked rate that it makes due, oldest first.

        Parameters
        ----------
        block : Block
        without : sequence of str
            Ids of the beacons that are not to be believed.
        ratio : mapping of str to float, optional
            Measured current over the site's, of the beacons where they differ.
        """
        if block.time_s <= self.time_s:
            self._of_cycles.clear()
            self._begin()
        self._take_currents(ratio or {})
        duration_s = block.chips * self._chip_s
        begin_s = block.time_s - duration_s
        if abs(begin_s - self.time_s) < 0.5 * duration_s:
            begin_s = self.time_s
        poses = self._bridged(block, begin_s)
        pose = self._follower.update(block, without)
        if pose is None:
            return poses
        self._last = block
        poses += [self._at(time_s, pose) for time_s in self._due(block, begin_s, block.time_s)]
        for cycle, end_s in self._ends(block, begin_s, block.time_s):
            self._keep(cycle, self._at(end_s, pose))
        return poses

    def of_cycle(self, report: Report) -> Pose | None:
        """Return the pose at the end of a cycle; None if no block came within `GAP_S` of it."""
        end_s = report.time_s + 0.5 * self._site.cycle_s
        pose = self._of_cycles.pop(report.cycle, None)
        if pose is not None and not abs(pose.time_s - end_s) > 0.5 * self._site.cycle_s:
            return pose  # else it is of a cycle of the same number, before a restart
        if self._last is None:
            return None
        return self._at(end_s) if 0.0 < end_s - self._last.time_s <= GAP_S else None

    def pose_at(self, time_s: float) -> Pose | None:
        """Return the pose at any time near that of the latest block; None before there was one."""
        return None if self._last is None else self._at(time_s)

    # ---- The times ----

    def _bridged(self, block: Block, begin_s: float) -> list[Pose]:
        """Return the poses due between the block before and this one, from the former; keep those of cycles."""
        last = self._last
        if last is None or not 0.0 < begin_s - last.time_s <= GAP_S:
            return []
        for cycle, end_s in self._ends(last, last.time_s, begin_s):
            self._keep(cycle, self._at(end_s))
        return [self._at(time_s) for time_s in self._due(block, last.time_s, begin_s)]

    def _due(self, block: Block, after_s: float, until_s: float) -> Iterator[float]:
        """Yield the times at the asked rate behind one time and up to another; a block tells where blocks end."""
        if self._rate_hz is None:
            return
        step_s, one_s, near = 1.0 / self._rate_hz, 0.0, NEAR
        duration_s = block.chips * self._chip_s
        if abs(step_s / duration_s - 1.0) < SAME_RATE:
            step_s, one_s, near = duration_s, block.time_s, 0.5
        first = math.floor((after_s - one_s) / step_s + near) + 1
        last = math.floor((until_s - one_s) / step_s + near)
        yield from (one_s + number * step_s for number in range(first, last + 1))

    def _ends(self, block: Block, after_s: float, until_s: float) -> Iterator[tuple[int, float]]:
        """Yield the cycles that end behind one time and up to another, with their ends, counted from a block."""
        zero_s = block.time_s - (block.chip + block.chips) * self._chip_s  # the begin of the cycle of its first chip
        near = 0.5 / self._site.chips
        first = math.floor((after_s - zero_s) / self._site.cycle_s + near)
        last = math.floor((until_s - zero_s) / self._site.cycle_s + near)
        for number in range(first, last):
            yield (block.cycle + number) % CYCLE_MODULUS, zero_s + (number + 1) * self._site.cycle_s

    def _at(self, time_s: float, pose: Pose | None = None) -> Pose:
        """Return the pose at a time, which is the pose at the end of the latest block if that is its time."""
        assert self._last is not None
        if pose is not None and abs(time_s - self._last.time_s) < NEAR * self._site.cycle_s:
            return pose
        chips = self._last.chip + self._last.chips + (time_s - self._last.time_s) / self._chip_s
        cycle = self._last.cycle + math.ceil(chips / self._site.chips - NEAR) - 1
        return replace(self._follower.pose_at(time_s), epoch=cycle % CYCLE_MODULUS)

    def _keep(self, cycle: int, pose: Pose) -> None:
        self._of_cycles[cycle] = pose
        if len(self._of_cycles) > CYCLES_KEPT:
            del self._of_cycles[next(iter(self._of_cycles))]

    # ---- The currents ----

    def _take_currents(self, ratio: Mapping[str, float]) -> None:
        """Begin anew if a beacon has another current than the one in use: one block is enough to begin with."""
        measured = {name: ratio.get(name, 1.0) for name in self._current}
        if all(abs(measured[name] / used - 1.0) <= CURRENT_CHANGED for name, used in self._current.items()):
            return
        self._current = measured
        self._begin()

    def _begin(self) -> None:
        """Begin anew on the site as its currents are."""
        beacons = [replace(one, current_A=one.current_A * self._current[one.id]) for one in self._site.beacons]
        self._last = None
        self._follower = self._make(replace(self._site, beacons=tuple(beacons)))
