"""``goldfield samples``: raw samples of a sensor, for ``goldfield separate``: any way to tell beacons apart."""

from __future__ import annotations

import argparse
import csv
import sys
from contextlib import closing
from itertools import islice
from typing import Any

import numpy as np

from goldfield import site as sites
from goldfield.cli import link_options, options
from goldfield.cli.chips_file import COLUMNS, PLACE
from goldfield.errors import on_command_line


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "samples",
        help="raw samples of a sensor",
        description=f"A CSV table with the columns {','.join(COLUMNS)} on stdout, one row a chip, from a sensor on a "
        "serial port: for goldfield separate, which tells beacons apart in every way that a site file can name.",
    )
    options.add(parser, "--port", metavar="PATH", what="serial port of the sensor")
    link_options.add_key(parser)
    link_options.add_bit_rate(parser)
    options.add_site(parser)
    options.add(parser, "--cycles", metavar="N", kind=options.count, what="how many cycles, default 1")
    parser.add_argument(
        "--at",
        type=options.finite,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help=f"where the sensor stands, m: added as the columns {','.join(PLACE)}, for goldfield paper zheng survey",
    )
    link_options.add_reading(parser, channel=False)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Print the samples."""
    from goldfield.sensor.samples import sample_cycles
    from goldfield.sensor.session import Session
    from goldfield.sensor.sources import open_source  # heavy: only when there is a sensor

    site = sites.load(options.required(arguments.site, "--site", "FILE"))
    port = options.required(arguments.port, "--port", "PATH")
    rows = csv.writer(sys.stdout, lineterminator="\n")
    place = [repr(value) for value in arguments.at or []]
    choices = link_options.reading(arguments)
    with closing(open_source("port", port, choices)) as source:
        session = Session(source, port, site, choices.node)
        rows.writerow(COLUMNS + (PLACE if place else ()))
        with closing(sample_cycles(session, site)) as cycles:
            for samples in islice(cycles, arguments.cycles or 1):
                for chip, field in enumerate(samples):
                    rows.writerow([chip, *("" if np.isnan(value) else repr(float(value)) for value in field), *place])
    return 0
