"""``goldfield nodes key``: a site's key made, given to boards, and taken from them."""

from __future__ import annotations

import argparse
from dataclasses import replace

from goldfield.cli import link_options
from goldfield.cli.node_boards import SHARED, meant
from goldfield.cli.output import json_line
from goldfield.errors import UserError, counted, listed, tell
from goldfield.link.access_key import load_key, make_key
from goldfield.nodes.commissioning import Board, boards_of, refuse_driven, save_all, set_key
from goldfield.nodes.conversation import Conversation

IN_THE_CLEAR = "the key went over CAN in the clear: whoever listened has it; give it over serial where that matters"


def make(arguments: argparse.Namespace) -> int:
    """Make up a key; no board is spoken to."""
    key = make_key(arguments.file)
    if arguments.json:
        print(json_line({"key": key.file, "made": True}))
    else:
        print(f"{key.file}: a new key, which you alone can read; keep a copy: boards that have it cannot do without")
    return 0


def act(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Give boards a key, or take theirs away."""
    if bool(arguments.nodes) == arguments.all:
        raise UserError(f"nodes key {arguments.key_action} takes numbers of nodes or --all: give one of these")
    setting = arguments.key_action == "set"
    key = conversation.key
    if key is None:
        raise UserError("no key is given: give its file with --key FILE, which goldfield nodes key make makes")
    if setting and arguments.old:
        conversation.key = load_key(arguments.old)
    conversation.listen()
    boards = _meant(boards_of(conversation), arguments)
    refuse_driven(conversation, boards, pause=arguments.pause)
    set_key(conversation, boards, key if setting else None)
    save_all(conversation, {board.number: board.unique_id for board in boards}, pause=arguments.pause)
    _tell(arguments, [replace(board, keyed=setting) for board in boards])
    if setting and link_options.chosen(arguments)[0] == "can":
        tell(IN_THE_CLEAR)


def _meant(boards: list[Board], arguments: argparse.Namespace) -> list[Board]:
    if arguments.nodes:
        return [meant(boards, number) for number in dict.fromkeys(arguments.nodes)]
    for board in boards:
        others = [other.unique_id for other in boards if other.number == board.number]
        if len(others) > 1:
            raise UserError("node " + SHARED.format(number=board.number, boards=listed(others)))
    return boards


def _tell(arguments: argparse.Namespace, boards: list[Board]) -> None:
    if arguments.json:
        for board in boards:
            print(json_line({"node": board.number, "unique_id": board.unique_id, "access": board.access}))
        return
    numbers = ", ".join(str(board.number) for board in boards)
    said = "locked with the key" if arguments.key_action == "set" else "open: anybody may change them"
    print(f"{counted(len(boards), 'boards are')} {said}, and have saved it: {numbers}")
