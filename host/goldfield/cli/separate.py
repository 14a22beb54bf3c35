"""``goldfield separate``: the field of each beacon from raw samples of the sum field."""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli import options
from goldfield.cli.chips_file import COLUMNS


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "separate",
        description=f"The field of each beacon from a CSV table with the columns {','.join(COLUMNS)}: one row a chip "
        "from chip 0 (counting on or beginning again at every cycle), an empty cell is a sample that is missing.",
    )
    parser.add_argument("samples", metavar="SAMPLES.csv", help="table of samples")
    options.add_site(parser)
    options.add_json(parser)
    options.add(
        parser, "--mains", metavar="HZ", kind=options.hertz, what="take out a hum near this frequency, within 0.5 Hz"
    )
    options.add(
        parser,
        "--harmonics",
        metavar="N",
        kind=options.count,
        what="multiples of --mains to take out, from 1 on",
    )
    parser.add_argument(
        "--unknown-rise", action="store_true", help="find the time constants of the coils in place of tau_s of the site"
    )
    options.add(parser, "--fields", metavar="FILE", what="write the fields to a table for goldfield locate")
    options.add_force(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print a line for every cycle."""
    from goldfield.cli.separated_cycles import separate  # heavy: only when something is separated

    return separate(arguments)
