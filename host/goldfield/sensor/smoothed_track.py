"""A track by blocks whose poses come some time later, made of what came after them, too: for recordings."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from goldfield.link.reports import Report
from goldfield.sensor.block_times import NEAR, BlockTimes
from goldfield.site import Site
from goldfield.types import Block, Pose


class Smoother(Protocol):
    """What smooths the track of one sensor, as `goldfield.track.blocks.BlockSmoother` does."""

    def update(self, block: Block, without: Sequence[str] = (), ratio: Mapping[str, float] | None = None) -> list[Pose]:
        """Take the next block; return the poses that are now ready, each at the end of a block."""
        ...

    def finish(self) -> list[Pose]:
        """Return the poses that are kept; the smoother is then empty."""
        ...


class SmoothedTrack:
    """Follows one sensor as `BlockTrack` does; its poses are late, and more accurate.

    Between the ends of two successive blocks a pose is interpolated; where more blocks were lost than the smoother
    bridges there are none.

    Parameters
    ----------
    site : Site
    make : callable
        Makes what smooths the track on a site.
    rate_hz : float, optional
        Poses a second (`BlockTimes`); None: at the ends of the cycles.
    """

    def __init__(self, site: Site, make: Callable[[Site], Smoother], rate_hz: float | None = None) -> None:
        self._site, self._make = site, make
        self._times = BlockTimes(site, rate_hz)
        self._at_ends = rate_hz is None
        self._smoother = make(site)
        self._last: Block | None = None
        self._before: Pose | None = None

    @property
    def time_s(self) -> float:
        """End of the latest block, on the sensor's clock; minus infinity before there was one."""
        return -math.inf if self._last is None else self._last.time_s

    def update(self, block: Block, without: Sequence[str] = (), ratio: Mapping[str, float] | None = None) -> list[Pose]:
        """Take the next block; return the poses that are now due, oldest first. See `BlockTrack.update`."""
        poses: list[Pose] = []
        if block.time_s <= self.time_s:
            poses = self.finish()
            self._smoother = self._make(self._site)
        self._last = block
        return [*poses, *self._due(self._smoother.update(block, without, ratio))]

    def skip(self) -> None:
        """Do nothing: there are no poses where blocks were lost, or let go."""

    def finish(self) -> list[Pose]:
        """Return the poses that are left when no further block comes."""
        poses = list(self._due(self._smoother.finish()))
        self._before = None
        return poses

    def of_cycle(self, report: Report) -> Pose | None:
        """Return the latest pose at hand, which is older than the cycle's end by the lag; None if there is none."""
        return self._before

    def pose_at(self, time_s: float) -> Pose | None:
        """Return None: what has a lag knows no pose of now."""
        return None

    def _due(self, ready: Sequence[Pose]) -> Iterator[Pose]:
        for pose in ready:
            before, self._before = self._before, pose
            yield from self._between(before, pose)

    def _between(self, before: Pose | None, pose: Pose) -> Iterator[Pose]:
        """Yield the poses due behind one smoothed pose and up to the next."""
        assert self._last is not None
        block_s = self._times.duration_s(self._last)
        near_s = block_s * (0.5 / self._last.chips if self._at_ends else NEAR)
        begin_s = pose.time_s - block_s if before is None else before.time_s
        follows = pose.time_s - begin_s < 1.5 * block_s
        here = replace(self._last, time_s=pose.time_s)  # the blocks before it end at the same distances
        if self._at_ends:
            times = [end_s for _, end_s in self._times.ends(self._last, begin_s, pose.time_s)]
        else:
            times = list(self._times.due(here, begin_s, pose.time_s))
        for time_s in times:
            if abs(time_s - pose.time_s) < near_s:
                yield pose
            elif before is not None and follows:
                cycle = self._times.cycle_at(self._last, time_s)
                yield replace(_interpolated(before, pose, time_s), epoch=cycle)


def _interpolated(before: Pose, behind: Pose, time_s: float) -> Pose:
    """Return the pose at a time between two; what is told of its worth is that of the later one."""
    share = (time_s - before.time_s) / (behind.time_s - before.time_s)
    quaternion = (1.0 - share) * before.orientation_xyzw + share * behind.orientation_xyzw
    return replace(
        behind,
        time_s=time_s,
        position_m=(1.0 - share) * before.position_m + share * behind.position_m,
        orientation_xyzw=quaternion / np.linalg.norm(quaternion),
        position_cov_m2=(1.0 - share) * before.position_cov_m2 + share * behind.position_cov_m2,
        attitude_cov_rad2=(1.0 - share) * before.attitude_cov_rad2 + share * behind.attitude_cov_rad2,
    )
