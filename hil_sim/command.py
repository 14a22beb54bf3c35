"""``goldfield hil``: simulated bench: boards, coils, field and links.

The rig is a process of its own, its serial ports pseudo-terminals, its CAN a python-can bus. The first line is the
command's line in ``goldfield --help``. Also ``python -m hil_sim.command``.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from goldfield.cli import main as goldfield_main
from goldfield.cli.options import add_force
from hil_sim import KINDS, LONGEST_S, NO_CAN
from hil_sim.options import add_cycles


def command(subparsers: Any) -> None:
    """Add the subcommand to the command line of goldfield."""
    parser = subparsers.add_parser(
        "hil",
        description="Runs a scenario in one virtual time. The first line tells the serial path and the CAN channel, "
        "with --json those of anchors too, which else have a line each, and the command that reads the sensor; "
        "then one line of truth a cycle (--json) or a line of progress now and then.",
    )
    _add_arguments(parser)


def _add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", metavar="SCENARIO", help="a name in hil_sim/scenarios, or a file")
    seconds = _number(1e-3, LONGEST_S, "number of seconds")
    parser.add_argument("--seconds", type=seconds, metavar="N", help="virtual seconds; default: until interrupted")
    parser.add_argument(
        "--boards",
        choices=KINDS,
        default=KINDS[0],
        help="emulated: they run the ARM image (default)",
    )
    parser.add_argument(
        "--seed", type=_seed, metavar="N", help="in place of the scenario's; walks and errors of installation follow it"
    )
    add_cycles(parser)
    parser.add_argument("--json", action="store_true", help="JSON lines")
    parser.add_argument("--truth", type=Path, metavar="FILE", help="write the lines of truth there, and only there")
    parser.add_argument("--site", type=Path, metavar="FILE", help=SITE_HELP)
    parser.add_argument("--true-site", type=Path, metavar="FILE", help=TRUE_SITE_HELP)
    parser.add_argument("--points", type=Path, metavar="FILE", help=POINTS_HELP)
    add_force(parser)
    parser.add_argument("--pace", type=_pace, default=1.0, metavar="X", help=PACE_HELP)
    parser.add_argument("--wait", action="store_true", help=WAIT_HELP)
    parser.add_argument("--can", metavar="CHANNEL", default=NO_CAN, help=CAN_HELP)
    parser.add_argument("--link", type=Path, metavar="PATH", help=LINK_HELP)
    parser.set_defaults(run=run)


SITE_HELP = "write the site file of this scenario there; default: a file that is there as long as the bench runs"
SEED_HELP = "in place of the scenario's; walks and errors of installation without a seed of their own follow it"
TRUE_SITE_HELP = "write the site file of the bench that is there: where beacons and axes really are"
POINTS_HELP = "write the cycles that stand at known points there, as a table for goldfield survey --points"
CAN_HELP = (
    "own: a CAN channel of this bench alone, for programs of this machine; "
    "INTERFACE:CHANNEL of python-can, as socketcan:vcan0; none (default)"
)
PACE_HELP = (
    "at most X virtual seconds in a second (default 1); 0: as fast as possible, and waiting for the reader of the port"
)
WAIT_HELP = (
    "stand still while nobody has a serial port of the bench open, once its boards have started: each reader finds "
    "what the one before it left"
)
LINK_HELP = "a symbolic link to the serial port while the bench runs; those of anchors have their node added: PATH.NODE"


def _number(least: float, most: float, what: str) -> Callable[[str], float]:
    """Return a parser of numbers between two limits, which are allowed."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"'{text}' is no {what} of {least:g} to {most:.0f}")
        return value

    return parse


def _pace(text: str) -> float:
    """Parse a pace: 0, or a speed at which the bench still does something within seconds."""
    try:
        if float(text) == 0.0:
            return 0.0
    except ValueError:
        pass
    return _number(1e-3, 1e6, "pace: give 0, or a number")(text)


def _seed(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= 19 and int(text) < 1 << 63):
        raise argparse.ArgumentTypeError(f"'{text}' is no seed: seeds are 0 to 2^63 - 1")
    return int(text)


def run(arguments: argparse.Namespace) -> int:
    """Run the bench."""
    from hil_sim.links.serve import serve  # heavy: only when a bench is wanted

    return serve(arguments)


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``goldfield hil`` with arguments and return its exit code."""
    return goldfield_main(["hil", *(sys.argv[1:] if argv is None else argv)])


if __name__ == "__main__":
    sys.exit(main())
