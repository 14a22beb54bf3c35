"""Poses from blocks some time later, when those that follow have told more: for recordings.

The filter's steps are kept. Rauch, Tung and Striebel's recursion runs back over them from time to time, with the
agility that the filter found the sensor to have, and every step goes out once it is older than the lag.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from goldfield.errors import UserError
from goldfield.site import Site
from goldfield.track.blocks.backward import Step, smoothed
from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.filter import BlockFilter
from goldfield.track.blocks.state import added, onward
from goldfield.track.continuity import Hemisphere
from goldfield.track.report import Reporter
from goldfield.types import Block, Pose, Status

LAG_S = 0.05
"""Time after which a pose goes out: an agile filter forgets within it, so that later blocks tell hardly more."""

BRIDGED_S = 0.05
"""Longest time between two blocks in which those between them have poses, too, though they were lost."""

AT_ONCE = 8
"""Steps that go out together: the recursion runs over the lag once for all of them."""


class BlockSmoother:
    """Smooths the track of one sensor: every pose of `BlockFilter` comes out once, in order, later and more accurate.

    So do poses at the ends of blocks that were lost, if no more than `BRIDGED_S` passed without one.

    Parameters
    ----------
    site : Site
    lag_s : float
        Time by which the poses are late at least; up to eight blocks more.

    Raises
    ------
    UserError
        If the lag is not positive, or the site is of a kind that no block filter can follow.
    """

    def __init__(self, site: Site, lag_s: float = LAG_S) -> None:
        if not lag_s > 0.0:
            raise UserError(f"the lag is {lag_s:g} s; it must be above 0")
        self._site = site
        self._filter = BlockFilter(site, kernel=False)
        self._reporter, self._hemisphere = Reporter(site), Hemisphere()
        self._lag_s = lag_s
        self._kept: deque[tuple[Pose, Step]] = deque()

    def update(self, block: Block, without: Sequence[str] = (), ratio: Mapping[str, float] | None = None) -> list[Pose]:
        """Take a block as `BlockFilter.update` does; return the poses that are now ready, oldest first."""
        bridged = self._bridged(block)
        pose = self._filter.update(block, without, ratio)
        if pose is None:
            return []
        step = self._filter.step
        ready: list[Pose] = []
        if self._kept and (step is None or step.track != self._kept[-1][1].track):
            ready = self.finish()  # nothing is carried over: what is kept can gain no more
        if step is None:
            return [*ready, self._hemisphere.follow(pose)]
        if self._kept:
            self._kept += bridged
        self._kept.append((pose, step))
        old = sum(kept.middle_s <= step.middle_s - self._lag_s for _, kept in self._kept)
        if old >= AT_ONCE:
            ready += self._smoothed()[:old]
            for _ in range(old):
                self._kept.popleft()
        return [self._hemisphere.follow(one) for one in ready]

    def finish(self) -> list[Pose]:
        """Return the poses of all blocks that are kept; the smoother is then empty."""
        ready = [self._hemisphere.follow(pose) for pose in self._smoothed()]
        self._kept.clear()
        return ready

    def poses(self, blocks: Iterable[Block]) -> Iterator[Pose]:
        """Yield the smoothed pose of every block that holds data."""
        for block in blocks:
            yield from self.update(block)
        yield from self.finish()

    def _bridged(self, block: Block) -> list[tuple[Pose, Step]]:
        """Return what is expected at the ends of the blocks that were lost before this one: steps without a block."""
        if not self._kept:
            return []
        pose, step = self._kept[-1]
        gap_s = block.time_s - pose.time_s
        if not 0.0 < gap_s < BRIDGED_S:
            return []
        count = round(gap_s / (block.chips * self._site.chip_period_s))
        steps: list[tuple[Pose, Step]] = []
        for number in range(1, count):
            seconds = number * gap_s / count
            motion, transition = onward(step.known.motion, seconds)
            covariance = transition @ step.known.covariance @ transition.T + added(step.agility, seconds)
            last = block.chip + block.chips * (1 + number - count) - 1
            expected = replace(
                self._filter.pose_at(pose.time_s + seconds), epoch=block.cycle + last // self._site.chips
            )
            known = Estimate(motion, covariance)
            steps.append((expected, Step(step.track, step.middle_s + seconds, known, step.agility, step.bias)))
        return steps

    def _smoothed(self) -> list[Pose]:
        """Return the poses of all that is kept, by all that is kept."""
        steps = [step for _, step in self._kept]
        return [self._told(pose, step, known) for (pose, step), known in zip(self._kept, smoothed(steps), strict=True)]

    def _told(self, pose: Pose, step: Step, known: Estimate) -> Pose:
        """Return a pose at the end of its block as it is now known; its status and reason stay."""
        seconds = pose.time_s - step.middle_s
        motion, transition = onward(known.motion, seconds)
        covariance = transition @ known.covariance @ transition.T + added(step.agility, seconds)
        if step.bias is not None:
            covariance[:6, :6] += step.bias
        told = self._reporter.again(pose, motion, covariance)
        # An alternative is not smoothed: it goes out as it was
        return replace(told, alternative=pose.alternative) if pose.status is Status.AMBIGUOUS else told
