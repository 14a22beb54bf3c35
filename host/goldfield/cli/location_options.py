"""The options that say how poses are made, when they are told, and how they are judged."""

from __future__ import annotations

import argparse
from dataclasses import replace

from goldfield import site as sites
from goldfield.cli import options
from goldfield.files.environment import switched_on
from goldfield.site import Site


def add_track(parser: argparse.ArgumentParser) -> None:
    """Add ``--track``."""
    parser.add_argument(
        "--track",
        action="store_true",
        default=switched_on("GOLDFIELD_TRACK"),
        help="track the sensor: poses from this and the earlier epochs (environment: GOLDFIELD_TRACK)",
    )


def add_times(parser: argparse.ArgumentParser) -> None:
    """Add ``--rate`` and ``--lag``, which say when a track tells its poses."""
    options.add(
        parser,
        "--rate",
        metavar="HZ",
        what="track, and print so many poses a second of the sensor's time, each at once (330: one for each block of "
        "31 chips)",
        kind=options.rate,
    )
    options.add(
        parser,
        "--lag",
        metavar="MS",
        what="track, and print each pose so many milliseconds later (50 if no number is given), made of what came "
        "after it, too",
        kind=options.milliseconds,
        alone="50",
    )


def add_on_sensor(parser: argparse.ArgumentParser) -> None:
    """Add ``--on-sensor``."""
    parser.add_argument(
        "--on-sensor",
        action="store_true",
        default=switched_on("GOLDFIELD_ON_SENSOR"),
        help="print the poses that the sensor computes, once it has got the site's beacons "
        "(environment: GOLDFIELD_ON_SENSOR)",
    )


def add_alert_limit(parser: argparse.ArgumentParser) -> None:
    """Add ``--alert-limit``."""
    options.add(
        parser,
        "--alert-limit",
        metavar="METRES",
        what="a pose is unverified if a fault of one beacon could hide a larger error (default: the site file's)",
        kind=options.metres,
    )


def site_of(arguments: argparse.Namespace) -> Site:
    """Load the site of ``--site`` with the alert limit of the command line, if there is one."""
    site = sites.load(options.required(arguments.site, "--site", "FILE"))
    limit_m: float | None = arguments.alert_limit
    return site if limit_m is None else replace(site, alert_limit_m=limit_m)
