"""``goldfield nodes bit-rate``: all boards of a link brought to another bit rate."""

from __future__ import annotations

import argparse

from goldfield.cli.output import json_line
from goldfield.errors import SystemFailure, UserError, counted, listed, tell
from goldfield.nodes.bit_rate import Change
from goldfield.nodes.commissioning import boards_of
from goldfield.nodes.conversation import Conversation


def act(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Let all boards save a rate, reset them, and tell who is heard again."""
    conversation.listen()
    boards = boards_of(conversation)
    change = Change(conversation, boards, arguments.rate, pause=arguments.pause)
    change.prepare()
    numbers = sorted(board.number for board in boards)
    if change.bit_rate != change.old_rate:
        change.reset()
    try:
        heard = change.heard()
    except UserError as error:  # the rate of the kernel's interface
        tell(f"{counted(len(numbers), 'boards')} were reset, and speak at {change.bit_rate} bit/s now; {error}")
        heard = None
    if arguments.json:
        record = {"bit_rate": change.bit_rate, "before": change.old_rate, "nodes": numbers, "heard": heard}
        print(json_line(record))
    elif heard is not None:
        print(f"{counted(len(heard), 'boards')} heard at {change.bit_rate} bit/s: {listed(heard)}")
    missing = [] if heard is None else [number for number in numbers if number not in heard]
    if missing:
        raise SystemFailure(
            f"{conversation.name}: {counted(len(missing), 'nodes')}, {listed(missing)}, not heard since the reset: all "
            f"boards have saved {change.bit_rate} bit/s: power them off and on"
        )
