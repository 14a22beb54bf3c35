"""``goldfield flash``: new images for the boards of a link, or for the one at a debug probe.

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
    parser.add_argument(
        "--probe",
        metavar="ID",
        nargs="?",
        const="",
        help="a debug probe in place of a link; of several the one whose unique id contains ID",
    )
    parser.add_argument("--public", metavar="KEY", help="with --probe: the site's public key, which the board then has")
    parser.add_argument("--boot", metavar="FILE", help="with --probe: the boot loader, default build/boot/boot.bin")
    link_options.add(parser)
    options.add_json(parser)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Open the link and do what is asked."""
    from contextlib import closing

    from goldfield.cli.flashing import flash
    from goldfield.nodes.conversation import Conversation
    from goldfield.nodes.opening import open_link
    from goldfield.nodes.tap import Tap
    from goldfield.update.image_files import read

    if arguments.probe is not None:
        return _by_probe(arguments)
    if arguments.public is not None or arguments.boot is not None:
        raise UserError("--public and --boot are written by a probe alone: give --probe, too")
    if sum((bool(arguments.nodes), arguments.role is not None, arguments.all)) != 1:
        raise UserError("flash takes numbers of nodes, --role ROLE or --all: give one of these")
    kind, where = link_options.chosen(arguments)
    key = link_options.key(arguments)
    images = read(arguments.file)  # before anything is opened
    with closing(Tap(open_link(kind, where, arguments.bit_rate), key)) as tap:
        try:
            flash(Conversation(tap), arguments, images, shared=kind == "can")
        except KeyboardInterrupt:
            tell(BROKEN_OFF, failure=True)
            raise
    return 0


def _by_probe(arguments: argparse.Namespace) -> int:
    from goldfield.update import by_probe, keys
    from goldfield.update.image_files import read

    others = {"NODE": arguments.nodes, "--all": arguments.all, "--port": arguments.port, "--can": arguments.can}
    given = [name for name, value in others.items() if value]
    if given:
        raise UserError(f"--probe programs the one board that it is at: leave {given[0]} out")
    public = None if arguments.public is None else keys.public_of(arguments.public)
    image = by_probe.image_of(read(arguments.file), arguments.role)
    if public is None:
        tell("no --public is given: this board will take no image over its links")
    by_probe.flash(image, arguments.probe, arguments.boot or by_probe.BOOT, public)
    return 0
