"""``goldfield site``: the boards of a link set to what a site file says, or compared with it."""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli import link_options, options
from goldfield.errors import on_command_line


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "site",
        help="boards set to a site, or compared with it",
        description="Sets the boards of a link to what a site file says of them, or compares them with it.",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", dest="action", required=True)
    push = actions.add_parser(
        "push",
        help="set the boards to a site",
        description="Sets code, amplitude, waveform and group of each beacon's board and the codes and beacons of each "
        "sensor, saves it, and checks it. No coil is switched on unless --start is given.",
    )
    push.add_argument("--start", action="store_true", help="then start the site's beacons, and save that")
    push.add_argument("--pause", action="store_true", help="let boards switch their coils off while they save")
    check = actions.add_parser(
        "check",
        help="compare the boards with a site",
        description="Lists what the boards do not have as the site file says; exits with 3 if there is anything.",
    )
    for action in (push, check):
        action.add_argument("site", metavar="SITE", help="site file (TOML)")
        link_options.add(action)
        options.add_json(action)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Open the link and do what is asked."""
    from contextlib import closing

    from goldfield.cli.site_actions import act
    from goldfield.nodes.conversation import Conversation, Tap
    from goldfield.nodes.opening import open_link
    from goldfield.nodes.site_boards import wanted_of
    from goldfield.site import load

    site = load(arguments.site)
    options.tell_doubts(site)
    wanted_of(site, [])  # What no board can drive is told before anything is opened.
    kind, where = link_options.chosen(arguments)
    key = link_options.key(arguments)
    with closing(Tap(open_link(kind, where), key)) as tap:
        act(Conversation(tap), arguments, site)
    return 0
