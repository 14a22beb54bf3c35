"""Poses between the reports of the cycles, of blocks of chips: the track of the host, or what the sensor sends.

What the boards say of themselves is judged once a cycle, with its report, and holds for the poses that follow.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial

from goldfield.errors import UserError, tell
from goldfield.link.reports import Report
from goldfield.sensor.amendment import amended_pose
from goldfield.sensor.anchors import left_out
from goldfield.sensor.block_track import CYCLES_KEPT, GAP_S, BlockTrack
from goldfield.sensor.guard import show_defect
from goldfield.sensor.location import Succession, with_finding
from goldfield.sensor.options import Method, Options
from goldfield.sensor.smoothed_track import SmoothedTrack
from goldfield.sensor.verdict import Verdict
from goldfield.site import Site
from goldfield.track.blocks import BlockFilter, BlockSmoother
from goldfield.types import Block, Finding, Pose


class Between(ABC):
    """Makes the poses of one sensor between the reports of its cycles.

    Attributes
    ----------
    absent : str
        What to say where a rate was asked for and nothing comes that such poses are made of.
    """

    absent: str

    def __init__(self, *, used_all: bool) -> None:
        self._used_all = used_all
        self._verdict = Verdict()
        self._witnessed: Finding | None = None
        self._succession = Succession()

    def note(self, verdict: Verdict, witnessed: Finding | None) -> None:
        """Let what the boards say of themselves, and what the anchors see, hold from now on."""
        self._verdict, self._witnessed = verdict, witnessed

    @abstractmethod
    def poses(self, event: Block | Pose) -> list[Pose]:
        """Take the next block or pose of the sensor; return the poses at the asked rate that it makes due."""

    @abstractmethod
    def skip(self) -> None:
        """Let no pose be due up to the next block or pose of the sensor: those before it were let go."""

    @abstractmethod
    def of_cycle(self, report: Report) -> Pose | None:
        """Return the pose at the end of a cycle, without what the boards say; None if nothing came of late."""

    @abstractmethod
    def pose_at(self, time_s: float) -> Pose | None:
        """Return the pose at a time near the latest one; None if there is none."""

    def finish(self) -> list[Pose]:
        """Return the poses that are left at the end."""
        return []

    @property
    @abstractmethod
    def time_s(self) -> float:
        """Time of the latest block or pose, on the sensor's clock; minus infinity if there was none."""

    def follows(self, report: Report) -> bool:
        """Return whether poses come at the time of a cycle; a cycle without a time is taken to be as those before."""
        return not abs(report.time_s - self.time_s) > GAP_S

    def _next(self, pose: Pose) -> Pose:
        return self._told(self._succession.follow(pose))

    def _told(self, pose: Pose) -> Pose:
        """Return a pose with what boards and anchors say of it."""
        named = () if self._used_all else left_out(self._witnessed)
        more = tuple(name for name in named if name not in pose.excluded)
        pose = replace(pose, excluded=(*pose.excluded, *more)) if more else pose
        return amended_pose(with_finding(pose, self._witnessed), self._verdict, used_all=self._used_all)


class Tracking(Between):
    """Tracks the sensor by its blocks of chips; where none come there are no poses, and the epochs' own serve.

    Parameters
    ----------
    site : Site
    new : callable
        Makes the track, anew after a defect.
    """

    absent = "no blocks of chips come: there is one pose a cycle"

    def __init__(self, new: Callable[[], BlockTrack | SmoothedTrack]) -> None:
        super().__init__(used_all=False)
        self._new = new
        self._track = new()
        self._defects: set[str] = set()

    def poses(self, event: Block | Pose) -> list[Pose]:
        """Take the next block; see `Between.poses`. A defect costs the track, which begins anew, not the run."""
        assert isinstance(event, Block)
        witnessed = left_out(self._witnessed)
        try:
            poses = self._track.update(event, (*self._verdict.out, *witnessed), self._verdict.ratio)
        except UserError:
            raise
        except Exception as error:
            self._tell_defect(error)
            self._track = self._new()
            return []
        return [self._next(pose) for pose in poses]

    def skip(self) -> None:
        """See `Between.skip`; the track goes on as if the blocks had been lost."""
        self._track.skip()

    def finish(self) -> list[Pose]:
        """See `Between.finish`."""
        return [self._next(pose) for pose in self._track.finish()]

    def of_cycle(self, report: Report) -> Pose | None:
        """See `Between.of_cycle`."""
        return self._track.of_cycle(report)

    def pose_at(self, time_s: float) -> Pose | None:
        """See `Between.pose_at`."""
        pose = self._track.pose_at(time_s)
        return None if pose is None else self._told(self._succession.nearest(pose))

    @property
    def time_s(self) -> float:
        """End of the latest block."""
        return self._track.time_s

    def _tell_defect(self, error: Exception) -> None:
        show_defect()
        text = f"{type(error).__name__}: {error}"
        if text not in self._defects:
            self._defects.add(text)
            tell(f"a block of chips could not be used ({text}), and the track begins anew: please report it")


class Relayed(Between):
    """Passes on the poses that the sensor computes itself of its blocks, at the rate at which it sends them."""

    absent = "the sensor sends no poses of blocks, which a rate needs"

    def __init__(self) -> None:
        super().__init__(used_all=True)
        self._of_cycles: dict[int, Pose] = {}
        self._last: Pose | None = None

    def poses(self, event: Block | Pose) -> list[Pose]:
        """Take the sensor's next pose; see `Between.poses`."""
        assert isinstance(event, Pose)
        self._last = self._of_cycles[event.epoch] = event
        if len(self._of_cycles) > CYCLES_KEPT:
            del self._of_cycles[next(iter(self._of_cycles))]
        return [self._next(event)]

    def skip(self) -> None:
        """See `Between.skip`: what the sensor's poses were is not known, and none is due."""

    def of_cycle(self, report: Report) -> Pose | None:
        """Return the last pose of a cycle."""
        return self._of_cycles.get(report.cycle)

    def pose_at(self, time_s: float) -> Pose | None:
        """Return None: the host knows no motion of this sensor."""
        return None

    @property
    def time_s(self) -> float:
        """Time of the latest pose."""
        return -float("inf") if self._last is None else self._last.time_s


def between_of(site: Site, options: Options, aside: Executor | None = None) -> Between | None:
    """Return what makes poses between the cycles; None if the options ask for none, or the site allows none.

    ``aside`` is a thread for what takes longer than a block (`BlockFilter`).
    """
    if options.method is Method.ON_SENSOR and options.rate_hz is not None:
        return Relayed()
    if options.method is not Method.TRACK:
        return None
    lag_s = options.lag_s
    try:
        if lag_s is None:
            make = partial(BlockFilter, aside=aside)
            return Tracking(lambda: BlockTrack(site, make, options.rate_hz))
        return Tracking(lambda: SmoothedTrack(site, lambda known: BlockSmoother(known, lag_s), options.rate_hz))
    except UserError as error:
        tell(f"{error}: the track is one of whole cycles")
        return None
