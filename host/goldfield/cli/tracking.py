"""The option ``--track``: whether the epochs' poses know of each other."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable

from goldfield.poses import Fields, Pose
from goldfield.site import Site


def add_track(parser: argparse.ArgumentParser) -> None:
    """Add ``--track``."""
    parser.add_argument(
        "--track",
        action="store_true",
        default=os.environ.get("GOLDFIELD_TRACK", "") not in ("", "0"),
        help="track the sensor: poses from this and the earlier epochs (environment: GOLDFIELD_TRACK)",
    )


def locating(site: Site, track: bool) -> Callable[[Fields], Pose]:
    """Return what makes a pose of each epoch, whatever happens: on its own, or with the earlier ones."""
    from goldfield.pose_of import guarded, pose_of  # heavy: only when a pose is wanted

    if not track:
        return lambda fields: pose_of(site, fields)
    from goldfield.track import epoch_tracker

    tracker = epoch_tracker(site)
    return lambda fields: guarded(tracker.update, fields)
