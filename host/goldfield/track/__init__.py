"""A sensor in motion: poses that know of each other, and cycles that know of the motion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from goldfield.site import Site
from goldfield.track.cycle import CycleLocator, MovingPose
from goldfield.track.filter import Tracker
from goldfield.track.motion import Agility
from goldfield.track.observe import CycleData, CycleObserver, EpochObserver
from goldfield.track.smoother import FixedLagSmoother
from goldfield.track.witness import Witness
from goldfield.types import Fields, Pose

__all__ = [
    "Agility",
    "CycleData",
    "CycleLocator",
    "CycleObserver",
    "EpochObserver",
    "FixedLagSmoother",
    "MovingPose",
    "Tracker",
    "Witness",
    "tracked",
]


def tracked(site: Site, epochs: Iterable[Fields]) -> Iterator[Pose]:
    """Yield a pose for every epoch, whatever happens; the epochs come in the order of time."""
    tracker = Tracker(site)
    for fields in epochs:
        yield tracker.update(fields)
