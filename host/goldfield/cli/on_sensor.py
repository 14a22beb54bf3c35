"""The option ``--on-sensor``: poses that the sensor board itself computes, in place of the host's."""

from __future__ import annotations

import argparse
import os

from goldfield.errors import UserError
from goldfield.site import Site


def add_on_sensor(parser: argparse.ArgumentParser) -> None:
    """Add ``--on-sensor``."""
    parser.add_argument(
        "--on-sensor",
        action="store_true",
        default=os.environ.get("GOLDFIELD_ON_SENSOR", "") not in ("", "0"),
        help="print the poses that the sensor computes, once it has got the site's beacons "
        "(environment: GOLDFIELD_ON_SENSOR)",
    )


def check_on_sensor(site: Site, track: bool) -> None:
    """Check that the sensor can do what is asked.

    Raises
    ------
    UserError
        If the host is to track as well, or if the beacons are not such as the board can separate.
    """
    if track:
        raise UserError("--on-sensor and --track are both given: the sensor tracks by itself; leave out one of them")
    own_codes = site.access == "cdma" and len(set(site.codes)) == len(site.beacons)
    code_v = site.chips + 1  # the one code of the family that the board's closed form does not separate (framing.md)
    if not own_codes or code_v in site.codes:
        raise UserError(
            f"site {site.name}: a sensor computes its own pose only from beacons that have each their own code, "
            f"none of them {code_v}: change the codes or leave out --on-sensor"
        )
