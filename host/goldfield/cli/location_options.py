"""The options that say how poses are made: ``--track`` and ``--on-sensor``."""

from __future__ import annotations

import argparse
import os


def add_track(parser: argparse.ArgumentParser) -> None:
    """Add ``--track``."""
    parser.add_argument(
        "--track",
        action="store_true",
        default=os.environ.get("GOLDFIELD_TRACK", "") not in ("", "0"),
        help="track the sensor: poses from this and the earlier epochs (environment: GOLDFIELD_TRACK)",
    )


def add_on_sensor(parser: argparse.ArgumentParser) -> None:
    """Add ``--on-sensor``."""
    parser.add_argument(
        "--on-sensor",
        action="store_true",
        default=os.environ.get("GOLDFIELD_ON_SENSOR", "") not in ("", "0"),
        help="print the poses that the sensor computes, once it has got the site's beacons "
        "(environment: GOLDFIELD_ON_SENSOR)",
    )
