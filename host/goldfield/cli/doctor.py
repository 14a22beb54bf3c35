"""``goldfield doctor``: what is wrong with an installation, in plain words, and what to do."""

from __future__ import annotations

import argparse
import textwrap
from typing import Any

from goldfield import site as sites
from goldfield.cli import link_options, options
from goldfield.errors import EXIT_FAILED, on_command_line


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "doctor",
        help="what is wrong, and what to do",
        description="Checks installation, permissions, port, bus, firmware, clocks, codes, coils, currents and fields, "
        "and says in plain words what is wrong and what to do. It sets the sensor's code list, as run does. "
        "Exit code 0: all is sound; 3: something is wrong.",
    )
    link_options.add(parser)
    options.add_site(parser)
    options.add(parser, "--node", metavar="N", what="node of the sensor (else the first one)", kind=options.node)
    options.add_json(parser)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Print each check, and how many found something wrong."""
    kind, where = link_options.chosen(arguments)
    site = sites.load(options.required(arguments.site, "--site", "FILE"))

    from goldfield.cli.output import json_line
    from goldfield.doctor.examination import Examination
    from goldfield.link.line import Link, checked_rate

    if arguments.bit_rate is not None:  # bad usage is no finding
        checked_rate(Link.CAN if kind == "can" else Link.SERIAL, arguments.bit_rate)
    faults = 0
    examination = Examination(kind, where, site, arguments.node, link_options.key(arguments), arguments.bit_rate)
    for check in examination.checks():
        faults += check.fault is not None
        if arguments.json:
            record: dict[str, Any] = {
                "check": check.subject,
                "state": check.state.value,
                "fault": check.fault,
                "text": check.text,
            }
            record |= {"advice": check.advice or None, "nodes": check.nodes, "beacons": check.beacons}
            print(json_line(record), flush=True)
            continue
        mark = {"sound": "  ok", "wrong": "  !!", "unjudged": "   ?"}[check.state.value]
        said = f"{mark}  {check.subject}: {check.text}"
        for text, first in ((said, ""), (f"do: {check.advice}", " " * 8)):
            if not text.endswith("do: "):
                print("\n".join(textwrap.wrap(text, 80, initial_indent=first, subsequent_indent=" " * 8)), flush=True)
    if not arguments.json:
        print("all is sound" if not faults else f"{faults} thing{'s are' if faults > 1 else ' is'} wrong")
    return EXIT_FAILED if faults else 0
