"""``goldfield survey``: where beacons really are, how strong they are, and how the sensor's axes lie."""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli import link_options, options
from goldfield.cli.page_option import add_view
from goldfield.errors import on_command_line

KINDS = ("position", "axis", "current", "gain", "tilt", "offset", "lever", "field")


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "survey",
        description="Finds beacons and sensor as they are from the fields of a walk, all epochs together, and writes "
        "the site file anew. The site file says how wrong it may be ([survey], [sensor]); known points, distances, "
        "heights, directions and currents, and anchors that measure each other, fix what fields do not tell.",
    )
    parser.add_argument("fields", metavar="FIELDS.csv", nargs="?", help="table of fields, as goldfield locate reads it")
    link_options.add(parser, log=True)
    options.add_site(parser)
    options.add(
        parser,
        "--points",
        metavar="POINTS.csv",
        what="where the sensor was: epoch,x_m,y_m,z_m[,sigma_m]; an empty cell is a coordinate that is not known",
    )
    options.add(
        parser,
        "--known",
        metavar="KNOWN.toml",
        what="[known] with lists of distance, height, position, direction, current and sensor",
    )
    parser.add_argument(
        "--anchor",
        metavar="ID=FIELDS.csv",
        action="append",
        default=[],
        help="what the sensor at this beacon measured, averaged over the epochs of the table; may be given repeatedly",
    )
    options.add(
        parser,
        "--free",
        metavar="LIST",
        kind=kinds,
        what=f"what is found, of {','.join(KINDS)} (default: what the site file does not call exact)",
    )
    options.add(parser, "--out", metavar="NEW.toml", what="the new site file")
    options.add(
        parser,
        "--map",
        metavar="FILE.png",
        what="draw what no pose explains of the walk's fields, by place and by beacon, before and after",
    )
    options.add(parser, "--node", metavar="N", what="node of the sensor, where there are several", kind=options.node)
    options.add(parser, "--seconds", metavar="N", what="stop after so much time of the sensor", kind=options.seconds)
    options.add(
        parser,
        "--enough",
        metavar="METRES",
        what="live: walk until the beacons are known so well (default: until walking on gains little)",
        kind=options.metres,
    )
    add_view(parser)
    options.add_json(parser)
    options.add_force(parser)
    parser.set_defaults(run=run)


def kinds(text: str) -> tuple[str, ...]:
    """Parse a list of what is found, for argparse."""
    words = tuple(word.strip() for word in text.split(",") if word.strip())
    wrong = [word for word in words if word not in KINDS]
    if wrong or not words:
        raise argparse.ArgumentTypeError(f"{wrong[0] if wrong else 'nothing'} is none of {', '.join(KINDS)}")
    return words


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Survey, write the new site file, and print what was found."""
    from goldfield.cli.surveying import make_survey  # heavy: only when something is surveyed

    return make_survey(arguments)
