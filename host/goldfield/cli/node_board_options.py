"""The options of those actions of ``goldfield nodes`` that are for boards from the box."""

from __future__ import annotations

import argparse
from typing import Any

from goldfield.cli import options


def add(actions: Any) -> list[argparse.ArgumentParser]:
    """Add the actions, and return their parsers."""
    boards = actions.add_parser(
        "boards", help="boards by their unique ids", description="Lists the boards of a link, a line each."
    )
    number = actions.add_parser(
        "number",
        help="give a board another number",
        description="Gives a board another number, and saves it; --id names one of two boards with one number.",
    )
    assign = actions.add_parser(
        "assign",
        help="give each board a number of its own",
        description="Gives each board of the link a number of its own, and saves it: of boards that share one, the "
        "first by its unique id keeps it.",
    )
    assign.add_argument("--first", metavar="N", type=int, default=1, help="the smallest number to give, default 1")
    assign.add_argument("--renew", action="store_true", help="give all new numbers, beacons before sensors")
    name = actions.add_parser("name", help="give a board a name", description="Gives a board a name, and saves it.")
    start = actions.add_parser(
        "start",
        help="let beacons drive their coils",
        description="Lets beacons drive their coils; boards that were not commissioned refuse.",
    )
    stop = actions.add_parser("stop", help="switch coils off", description="Switches the coils of beacons off.")
    for action in (start, stop):
        action.add_argument("nodes", metavar="NODE", type=int, nargs="*", help="numbers of the nodes")
        action.add_argument("--group", metavar="G", type=int, help="the boards of this group, 1 to 255")
        action.add_argument("--all", action="store_true", help="all boards")
        action.add_argument("--save", action="store_true", help="keep it over a reset; coils pause for it")
    copy = actions.add_parser(
        "clone",
        help="copy a board's parameters",
        description="Copies the parameters of a board to others, and saves them; what is a board's own stays.",
    )
    copy.add_argument("source", metavar="FROM", type=int, help="number of the node to copy")
    copy.add_argument("targets", metavar="TO", type=int, nargs="+", help="numbers of the nodes to change")
    number.add_argument("node", metavar="NODE", type=int, help="its number now")
    number.add_argument("number", metavar="N", type=int, help="the number to give, 1 to 4095")
    name.add_argument("node", metavar="NODE", type=int, help="number of the node")
    name.add_argument("text", metavar="TEXT", help="up to 16 characters of ASCII")
    for action in (number, name):
        action.add_argument("--id", dest="unique_id", metavar="ID", help="unique id, as goldfield nodes tells it")
    rate = actions.add_parser(
        "bit-rate",
        help="bring all boards to another bit rate",
        description="Brings all boards of a bus, or the one at a serial port, to another bit rate: they save it and "
        "are reset. If one of them does not take it, none does.",
    )
    rate.add_argument("rate", metavar="RATE", type=options.bit_rate, help="bits a second, as 500000")
    for action in (number, assign, name, copy, rate):
        action.add_argument("--pause", action="store_true", help="let boards switch their coils off while they save")
    return [*_add_key(actions), boards, number, assign, name, start, stop, copy, rate]


def _add_key(actions: Any) -> list[argparse.ArgumentParser]:
    """Add the action ``key``, and return the parsers of what it does on a link."""
    key = actions.add_parser(
        "key",
        help="lock boards with a key",
        description="Makes a site's key, and locks boards with it: they are read without it, and changed with it only.",
    )
    doing = key.add_subparsers(title="actions", metavar="ACTION", dest="key_action", required=True)
    make = doing.add_parser("make", help="make a key", description="Makes up a key, and writes it to a new file.")
    make.add_argument("file", metavar="FILE", help="a file that is not there yet; you alone can read it")
    make.add_argument("--json", action="store_true", default=argparse.SUPPRESS, help="one JSON object a line")
    give = doing.add_parser(
        "set",
        help="give boards the key",
        description="Gives boards the key of --key, checks that they have it, and lets them save it.",
    )
    give.add_argument("--old", metavar="FILE", help="the key that they have now, if it is another one")
    take = doing.add_parser(
        "remove",
        help="take the key from boards",
        description="Takes the key of --key from boards, which are open to everybody then, and lets them save that.",
    )
    for action in (give, take):
        action.add_argument("nodes", metavar="NODE", type=int, nargs="*", help="numbers of the nodes")
        action.add_argument("--all", action="store_true", help="all boards")
        action.add_argument("--pause", action="store_true", help="let boards switch their coils off while they save")
    return [give, take]
