"""Poses between the reports of the cycles by the track of the host, which follows the sensor by its blocks of chips."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from functools import partial

from goldfield.errors import UserError, tell
from goldfield.link.reports import Report
from goldfield.sensor.anchors import left_out
from goldfield.sensor.between import Between, Relayed
from goldfield.sensor.block_track import BlockTrack
from goldfield.sensor.guard import show_defect
from goldfield.sensor.options import Method, Options
from goldfield.sensor.smoothed_track import SmoothedTrack
from goldfield.site import Site
from goldfield.track.blocks import BlockFilter, BlockSmoother
from goldfield.types import Block, Pose


class Tracking(Between):
    """Tracks the sensor by its blocks of chips; where none come there are no poses, and the epochs' own serve.

    Parameters
    ----------
    site : Site
    new : callable
        Makes the track, anew after a defect.
    """

    takes_blocks = True
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
