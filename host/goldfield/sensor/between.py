"""Poses between the reports of the cycles, of a track of the host (`goldfield.sensor.tracking`) or of the sensor's own.

What the boards say of themselves is judged once a cycle, with its report, and holds for the poses that follow.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace

from goldfield.link.reports import Report
from goldfield.sensor.amendment import amended_pose
from goldfield.sensor.anchors import left_out
from goldfield.sensor.block_track import CYCLES_KEPT, GAP_S
from goldfield.sensor.location import Succession, with_finding
from goldfield.sensor.verdict import Verdict
from goldfield.types import Block, Finding, Pose


class Between(ABC):
    """Makes the poses of one sensor between the reports of its cycles.

    Attributes
    ----------
    absent : str
        What to say where a rate was asked for and nothing comes that such poses are made of.
    takes_blocks, takes_poses : bool
        Whether it makes them of blocks of chips, or of poses that the sensor computes of blocks.
    """

    absent: str
    takes_blocks = False
    takes_poses = False

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


class Relayed(Between):
    """Passes on the poses that the sensor computes itself of its blocks, at the rate at which it sends them."""

    takes_poses = True
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
