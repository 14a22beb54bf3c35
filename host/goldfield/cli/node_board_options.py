"""The options of those actions of ``goldfield nodes`` that are for boards from the box."""

from __future__ import annotations

import argparse
from typing import Any


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
    for action in (number, assign, name, copy):
        action.add_argument("--pause", action="store_true", help="let boards switch their coils off while they save")
    return [boards, number, assign, name, start, stop, copy]
