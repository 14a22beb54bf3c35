"""``goldfield paper prigge``: ways to tell beacons apart, on equal terms; the patent's figures and coil rise."""

from __future__ import annotations

from typing import Any

from goldfield.cli import options
from hil_sim.papers.actions import action


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "prigge",
        help="TDMA, FDMA and CDMA side by side",
        description="Ways to tell beacons apart, compared at equal peak current and at equal average power: white "
        "noise, mains, impulses, the earth's field, spectrum, eddy currents; then the patent's example and coil rise. "
        "The figures are computed from the exact separation of each system, none is drawn at random.",
    )
    options.add(
        parser, "--beacons", metavar="N", kind=options.count, what="how many beacons share a cycle, default 100"
    )
    options.add(parser, "--degree", metavar="N", kind=options.count, what="2^N - 1 samples a cycle, default 10")
    options.add(parser, "--cycle", metavar="SECONDS", kind=options.seconds, what="duration of a cycle, default 0.1")
    options.add(parser, "--mains", metavar="HZ", kind=options.hertz, what="frequency of the mains, default 60")
    options.add(
        parser, "--figure", metavar="FILE", what="draw waveforms and spectra (FIG. 1 to 4) into a PNG, PDF or SVG"
    )
    options.add_force(parser)
    options.add_json(parser)
    parser.set_defaults(run=action("prigge.report:run"))
