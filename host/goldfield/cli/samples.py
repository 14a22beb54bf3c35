"""``goldfield samples``: raw samples of a sensor, for ``goldfield separate``: any way to tell beacons apart."""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from goldfield import site as sites
from goldfield.cli import options
from goldfield.cli.chips_file import COLUMNS, PLACE
from goldfield.errors import SystemFailure
from goldfield.link.buses import BusSource, open_port
from goldfield.link.chips import Calibration, ChipAssembler
from goldfield.link.reports import Assembler
from goldfield.sensor.session import Session
from goldfield.site import Site
from goldfield_protocol.messages import decode
from goldfield_protocol.parameters import PARAMETERS

STREAM = PARAMETERS["stream"].first
SILENCE_S = 10.0


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "samples",
        description=f"A CSV table with the columns {','.join(COLUMNS)} on stdout, one row a chip, from a sensor on a "
        "serial port: for goldfield separate, which tells beacons apart in every way that a site file can name.",
    )
    options.add(parser, "--port", metavar="PATH", what="serial port of the sensor")
    options.add_site(parser)
    options.add(parser, "--cycles", metavar="N", kind=options.count, what="how many cycles, default 1")
    parser.add_argument(
        "--at",
        type=options.finite,
        nargs=3,
        metavar=("X", "Y", "Z"),
        help=f"where the sensor stands, m: added as the columns {','.join(PLACE)}, for goldfield paper zheng survey",
    )
    options.add(parser, "--node", metavar="N", kind=options.node, what="node of the sensor (else the first one heard)")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print the samples."""
    site = sites.load(options.required(arguments.site, "--site", "FILE"))
    port = options.required(arguments.port, "--port", "PATH")
    source = open_port(port)
    try:
        session = Session(source, port, Assembler(), arguments.node)
        session.find_sensor()
        session.check_degree(source, site.degree)
        calibration = _calibration(session, source)
        before = session.parameter(source, STREAM)
        session.parameter(source, STREAM, 1)
        try:
            _print(session, source, site, calibration, arguments.cycles or 1, arguments.at or [])
        finally:
            session.parameter(source, STREAM, before)
    finally:
        source.close()
    return 0


def _calibration(session: Session, source: BusSource) -> Calibration:
    elements = PARAMETERS["calibration"]
    zero = [session.parameter(source, PARAMETERS[name].first) for name in ("zero_x", "zero_y", "zero_z")]
    matrix = [session.parameter(source, elements.identifier(i)) for i in range(elements.count)]
    return Calibration(np.array(zero, dtype=np.float64), np.array(matrix, dtype=np.float64).reshape(3, 3))


def _print(
    session: Session, source: BusSource, site: Site, calibration: Calibration, cycles: int, place_m: Sequence[float]
) -> None:
    rows = csv.writer(sys.stdout, lineterminator="\n")
    rows.writerow(COLUMNS + (PLACE if place_m else ()))
    where = [repr(value) for value in place_m]
    assembler = ChipAssembler(site.chips)
    heard = time.monotonic()
    while cycles:
        raw = source.receive(0.5)
        message = None if raw is None else decode(raw.arbitration_id, bytes(raw.data))
        if message is None or message.node != session.node or message.name != "CHIP":
            if time.monotonic() - heard > SILENCE_S:
                raise SystemFailure(f"{session.name}: sensor {session.node} sent no raw chip for {SILENCE_S:.0f} s")
            continue
        heard = time.monotonic()
        for sums in assembler.feed(message):
            for chip, field in enumerate(calibration.field_T(sums)):
                rows.writerow([chip, *("" if np.isnan(value) else repr(float(value)) for value in field), *where])
            cycles -= 1
            if not cycles:
                break
