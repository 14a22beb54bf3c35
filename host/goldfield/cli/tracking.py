"""The option ``--track``: whether the epochs' poses know of each other."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from typing import TYPE_CHECKING

from goldfield.site import Site
from goldfield.types import Fields, Pose

if TYPE_CHECKING:
    from goldfield.track import CycleData


def add_track(parser: argparse.ArgumentParser) -> None:
    """Add ``--track``."""
    parser.add_argument(
        "--track",
        action="store_true",
        default=os.environ.get("GOLDFIELD_TRACK", "") not in ("", "0"),
        help="track the sensor: poses from this and the earlier epochs (environment: GOLDFIELD_TRACK)",
    )


def locating(site: Site, track: bool) -> Callable[[Fields, CycleData | None], Pose]:
    """Return what makes a pose of each epoch, whatever happens: on its own, or with the earlier ones.

    It takes the fields, and the thirds of the cycle if they came: a tracker prefers these.
    """
    from goldfield.sensor.guard import guarded, pose_of  # heavy: only when a pose is wanted

    if not track:
        return lambda fields, _: pose_of(site, fields)
    from goldfield.track import PartsObserver, Tracker

    tracker = Tracker(site, PartsObserver(site))
    return lambda fields, thirds: guarded(lambda _: tracker.update(fields if thirds is None else thirds), fields)
