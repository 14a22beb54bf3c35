"""``goldfield flash``: new images for the boards of a link.

What takes long to import is imported by `run`, which is called when a board is to be spoken to.
"""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli import link_options, options
from goldfield.errors import UserError, on_command_line, tell

ROLES = ("beacon", "sensor", "anchor")
BROKEN_OFF = (
    "broken off: each board restarts within 15 s into the image that it had, or into the new one if it has all of it"
)


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "flash",
        help="new images for the boards of a link",
        description="Sends boards the images of an update file (goldfield image sign), many at once on CAN, and waits "
        "until each runs its image and has confirmed it. A board that refuses keeps the image that it has, and comes "
        "back to it if the new one fails.",
    )
    parser.add_argument("file", metavar="FILE", help="update file")
    parser.add_argument("nodes", metavar="NODE", nargs="*", type=options.node, help="numbers of the nodes")
    parser.add_argument("--role", choices=ROLES, help="all boards of this role")
    parser.add_argument("--all", action="store_true", help="all boards for whose role the file has images")
    parser.add_argument("--force", action="store_true", help="an image may be older than the one that runs")
    parser.add_argument("--pause", action="store_true", help="let boards that drive their coils switch them off for it")
    link_options.add(parser)
    options.add_json(parser)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Open the link and do what is asked."""
    from contextlib import closing

    from goldfield.cli.flashing import flash
    from goldfield.nodes.conversation import Conversation, Tap
    from goldfield.nodes.opening import open_link
    from goldfield.update.image_files import read

    if sum((bool(arguments.nodes), arguments.role is not None, arguments.all)) != 1:
        raise UserError("flash takes numbers of nodes, --role ROLE or --all: give one of these")
    kind, where = link_options.chosen(arguments)
    key = link_options.key(arguments)
    images = read(arguments.file)  # before anything is opened
    with closing(Tap(open_link(kind, where), key)) as tap:
        try:
            flash(Conversation(tap), arguments, images, shared=kind == "can")
        except KeyboardInterrupt:
            tell(BROKEN_OFF, failure=True)
            raise
    return 0
