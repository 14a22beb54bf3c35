"""``goldfield site``: codes for the beacons of a site; its boards set to what it says, or compared with it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from goldfield.cli import link_options, options
from goldfield.cli.output import json_line
from goldfield.errors import UserError, on_command_line, tell
from goldfield.files.outputs import check_outputs, check_writable, write_file
from goldfield.sensor.options import USUAL_STRONGEST, most_strongest


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "site",
        help="codes for a site; boards set to it, or compared with it",
        description="Plans the codes of a site's beacons, sets the boards of a link to what a site file says of them, "
        "or compares them with it.",
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
        action.add_argument(
            "--strongest",
            type=options.count,
            metavar="K",
            help="sensors choose the K codes that they hear best (default: they report the site's codes, or "
            f"{USUAL_STRONGEST} where these are more than a sensor's list holds, or shared)",
        )
        options.add_json(action)
    _add_codes(actions)
    parser.set_defaults(run=run)


def _add_codes(actions: Any) -> None:
    codes = actions.add_parser(
        "codes",
        help="choose a code for each beacon",
        description="Chooses a Gold code for each beacon, balanced ones first, the same one again only where it is "
        "far away, and says how much beacons disturb each other at most where sensors go.",
    )
    codes.add_argument("site", metavar="SITE", help="site file (TOML); the codes that it has do not count")
    options.add_box(codes)
    codes.add_argument(
        "--strongest",
        type=options.count,
        metavar="K",
        help="how many beacons a sensor reports, those that it hears best "
        f"(default: {USUAL_STRONGEST}, or as many as it can)",
    )
    codes.add_argument("--out", metavar="FILE", help="write the site file with the codes (default: they are not kept)")
    options.add_force(codes)
    options.add_json(codes)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Plan codes, or open the link and do what is asked."""
    if arguments.action == "codes":
        return _codes(arguments)
    from contextlib import closing

    from goldfield.cli.site_actions import act
    from goldfield.nodes.conversation import Conversation
    from goldfield.nodes.opening import open_link
    from goldfield.nodes.site_boards import wanted_of
    from goldfield.nodes.tap import Tap
    from goldfield.site import load

    site = load(arguments.site)
    options.tell_doubts(site)
    wanted_of(site, [], arguments.strongest)  # What no board can drive is told before anything is opened.
    kind, where = link_options.chosen(arguments)
    key = link_options.key(arguments)
    with closing(Tap(open_link(kind, where, arguments.bit_rate), key)) as tap:
        act(Conversation(tap), arguments, site)
    return 0


def _codes(arguments: argparse.Namespace) -> int:
    """Plan codes, write the site file with them, and print what they cost."""
    from goldfield.cli.site_codes import record, text
    from goldfield.planning.code_plan import planned
    from goldfield.planning.code_text import CodedText

    grid = options.grid_of(arguments)
    check_outputs({"--out": arguments.out}, {"SITE": arguments.site}, force=arguments.force)
    check_writable(arguments.out, "the site")
    coded = CodedText(Path(arguments.site))
    options.tell_doubts(coded.site)
    most = most_strongest(coded.site)
    if arguments.strongest is not None and arguments.strongest > most:
        raise UserError(
            f"--strongest {arguments.strongest}: a sensor chooses 1 to {most} codes of degree {coded.site.degree}"
        )
    plan = planned(coded.site, grid, arguments.strongest or min(USUAL_STRONGEST, most), tell)
    if arguments.out:
        text_of_site = coded.with_codes(plan.code.tolist())
        write_file(arguments.out, text_of_site.encode(), "the site", force=arguments.force)
    print(json_line(record(plan, coded.site)) if arguments.json else text(plan, coded.site))
    return 0
