"""``goldfield nodes``: who is on a link; parameters by name; a board that saves them, blinks, restarts, or may drive.

What takes long to import is imported by `run`, which is called when a node is to be spoken to.
"""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli import link_options, node_board_options, options
from goldfield.errors import on_command_line, tell

ONLY_ITS_OWN = "a serial line carries the messages of its own board only: to see the other boards, look on CAN (--can)"


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "nodes",
        help="who is on a link; read and set parameters",
        description="Lists the nodes of a link; or reads and sets parameters of one of them, by name.",
    )
    _add_common(parser, nested=False)
    options.add(parser, "--seconds", metavar="N", what="how long to listen, default 2.2", kind=options.seconds)
    parser.add_argument(
        "--elf",
        metavar="FILE",
        action="append",
        default=[],
        help="ELF file that was flashed, to name the line of a crash; once for each role",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", dest="action")
    get = actions.add_parser("get", help="read parameters", description="Reads one parameter, or all of a node.")
    put = actions.add_parser(
        "set",
        help="set a parameter",
        description="Sets a parameter until the node's next reset, unless it is saved; several values are those of "
        "successive elements.",
    )
    blink = actions.add_parser(
        "identify",
        help="let a node blink",
        description="Lets the LED of a board blink; a beacon that drives its coil halves its current in every other "
        "cycle meanwhile, which sensors see.",
    )
    blink.add_argument("--watch", action="store_true", help="tell which code a sensor sees come and go (on CAN)")
    blink.add_argument("--for", dest="blink_s", metavar="N", type=options.count, default=10, help="seconds, default 10")
    reset = actions.add_parser(
        "reset",
        help="restart a node",
        description="Switches a board's coils off and restarts it; --id names one of two boards with one number.",
    )
    clear = actions.add_parser(
        "clear",
        help="let a beacon drive again",
        description="Clears the cause for which a beacon's drive is off; --id names one of two boards with one number.",
    )
    keep = actions.add_parser(
        "save",
        help="save a node's parameters",
        description="Saves all parameters of a board, as they are now, in its flash; --id names one of two boards with "
        "one number.",
    )
    keep.add_argument("--pause", action="store_true", help="let a board that drives its coil switch it off meanwhile")
    for action in (blink, reset, clear, keep):
        action.add_argument("--id", dest="unique_id", metavar="ID", help="unique id, as goldfield nodes tells it")
    for action in (get, put, blink, reset, clear, keep):
        _add_common(action, nested=True)
        action.add_argument("node", metavar="NODE", type=options.node, help="number of the node")
    for action in node_board_options.add(actions):
        _add_common(action, nested=True)
    get.add_argument("name", metavar="NAME", nargs="?", help="as amplitude or code_list[3]; none: all parameters")
    put.add_argument("name", metavar="NAME", help="as amplitude or code_list[3]")
    put.add_argument("values", metavar="VALUE", nargs="+", help="in SI units")
    parser.set_defaults(run=run)


def _add_common(parser: argparse.ArgumentParser, *, nested: bool) -> None:
    link_options.add(parser, nested=nested)
    if nested:
        parser.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="one JSON object a line")
    else:
        options.add_json(parser)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Open the link and do what is asked."""
    if arguments.action == "key" and arguments.key_action == "make":
        from goldfield.cli import node_key

        return node_key.make(arguments)
    from contextlib import closing

    from goldfield.cli import node_actions
    from goldfield.nodes.conversation import Conversation
    from goldfield.nodes.opening import open_link
    from goldfield.nodes.tap import Tap

    kind, where = link_options.chosen(arguments)
    key = link_options.key(arguments)
    action = node_actions.ACTIONS[arguments.action]
    asked = node_actions.checked(arguments)  # before anything is opened
    with closing(Tap(open_link(kind, where, arguments.bit_rate), key)) as tap:
        action(Conversation(tap), arguments, asked)
    if arguments.action is None and kind == "port" and not arguments.json:
        tell(ONLY_ITS_OWN)
    return 0
