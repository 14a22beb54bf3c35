"""A track block by block: poses at the times that were asked for, and one at the end of each code cycle.

Blocks of chips come 330 times a second and say when they ended, on the sensor's clock. What follows the sensor
(`Follower`) has its state in the middle of the latest block, so a time within that block is never further away than
half of it, 1.5 ms, and its pose is given out with the block. A time of which no block came is extrapolated from the
blocks before, as soon as the next one is there, for at most `GAP_S`; in a longer gap there are no poses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

from goldfield.link.reports import Report
from goldfield.sensor.block_times import NEAR, BlockTimes
from goldfield.site import Site
from goldfield.types import Block, Pose

GAP_S = 1.0
"""The longest time over which poses are extrapolated while no block comes."""

CYCLES_KEPT = 8
"""Cycles whose last pose is kept until their reports are there, which may be late by two."""


class Follower(Protocol):
    """What follows one sensor by its blocks, as `goldfield.track.blocks.BlockFilter` does."""

    def update(
        self, block: Block, without: Sequence[str] = (), ratio: Mapping[str, float] | None = None
    ) -> Pose | None:
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
        Makes what follows the sensor on a site: at the begin, and when the sensor's clock begins again.
    rate_hz : float, optional
        Poses a second (`BlockTimes`); None: only those at the ends of the cycles (`of_cycle`).

    Raises
    ------
    UserError
        If the sensor cannot be followed on the site by its blocks.
    """

    def __init__(self, site: Site, make: Callable[[Site], Follower], rate_hz: float | None = None) -> None:
        self._site = site
        self._make = make
        self._times = BlockTimes(site, rate_hz)
        self._of_cycles: dict[int, Pose] = {}
        self._last: Block | None = None
        self._skips = False
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
            self._last = None
            self._follower = self._make(self._site)
        duration_s = self._times.duration_s(block)
        begin_s = block.time_s - duration_s
        if abs(begin_s - self.time_s) < 0.5 * duration_s:
            begin_s = self.time_s
        poses = self._bridged(block, begin_s)
        pose = self._follower.update(block, without, ratio)
        if pose is None:  # as if it had been lost: the next one bridges it, too
            return []
        self._last, self._skips = block, False
        poses += [self._at(time_s, pose) for time_s in self._times.due(block, begin_s, block.time_s)]
        for cycle, end_s in self._times.ends(block, begin_s, block.time_s):
            self._keep(cycle, self._at(end_s, pose))
        return poses

    def skip(self) -> None:
        """Let no pose at the rate be due up to the next block: those before it were let go, not lost."""
        self._skips = True

    def finish(self) -> list[Pose]:
        """Return nothing: a pose is out as soon as its block is there."""
        return []

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
        for cycle, end_s in self._times.ends(last, last.time_s, begin_s):
            self._keep(cycle, self._at(end_s))
        return [] if self._skips else [self._at(time_s) for time_s in self._times.due(block, last.time_s, begin_s)]

    def _at(self, time_s: float, pose: Pose | None = None) -> Pose:
        """Return the pose at a time, which is the pose at the end of the latest block if that is its time."""
        assert self._last is not None
        if pose is not None and abs(time_s - self._last.time_s) < NEAR * self._site.cycle_s:
            return pose
        return replace(self._follower.pose_at(time_s), epoch=self._times.cycle_at(self._last, time_s))

    def _keep(self, cycle: int, pose: Pose) -> None:
        self._of_cycles[cycle] = pose
        if len(self._of_cycles) > CYCLES_KEPT:
            del self._of_cycles[next(iter(self._of_cycles))]
