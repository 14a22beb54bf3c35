"""What ``goldfield nodes`` does with boards from the box: numbers, names, start and stop, copies, signatures."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from goldfield.cli.output import json_line
from goldfield.errors import SystemFailure, UserError, counted, listed, printable
from goldfield.nodes.commissioning import (
    SWITCHES,
    Board,
    assigned,
    boards_of,
    clone,
    refuse_driven,
    renumber,
    save_all,
    switch,
    switch_group,
)
from goldfield.nodes.conversation import START, Conversation
from goldfield.nodes.names import NAME_IDS, words_of

SHARED = "{number} is {boards}: name one of them with --id, or give each its own number with goldfield nodes assign"


def meant(boards: Sequence[Board], number: int, unique_id: str | None = None) -> Board:
    """Return the board that a number, and an id if it is shared, means.

    Raises
    ------
    SystemFailure
        If none has the number.
    UserError
        If the id is not one of its boards, or several have the number.
    """
    found = [board for board in boards if board.number == number]
    if not found:
        raise SystemFailure(f"node {number} does not answer: see who is there with goldfield nodes")
    wanted = [board for board in found if unique_id in (None, board.unique_id)]
    if len(wanted) != 1:
        ids = listed(board.unique_id for board in found)
        raise UserError("node " + SHARED.format(number=number, boards=ids))
    return wanted[0]


def _saved(conversation: Conversation, boards: Mapping[int, str], arguments: argparse.Namespace) -> None:
    save_all(conversation, boards, pause=arguments.pause)


def set_number(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Give one board another number."""
    if not 1 <= arguments.number <= 4095:
        raise UserError(f"{arguments.number} is no number of a node: give one from 1 to 4095")
    conversation.listen()
    boards = boards_of(conversation)
    board = meant(boards, arguments.node, arguments.unique_id)
    taken = [other for other in boards if other.number == arguments.number and other != board]
    if taken:
        raise UserError(f"the number {arguments.number} is that of board {taken[0].unique_id}: give another one")
    refuse_driven(conversation, [board], pause=arguments.pause)
    renumber(conversation, {board.unique_id: arguments.number})
    _saved(conversation, {arguments.number: board.unique_id}, arguments)
    _tell_numbers(arguments, [board], {board.unique_id: arguments.number})


def assign(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Give every board a number of its own."""
    if not 1 <= arguments.first <= 4095:
        raise UserError(f"--first {arguments.first} is no number of a node: give one from 1 to 4095")
    conversation.listen()
    boards = first = boards_of(conversation)
    refuse_driven(conversation, boards, pause=arguments.pause)
    if arguments.renew and len({board.number for board in boards}) < len(boards):
        renumber(conversation, assigned(boards, arguments.first, renew=False))
        conversation.listen()  # Only now each tells its role.
        boards = boards_of(conversation)
    numbers = assigned(boards, arguments.first, renew=arguments.renew)
    renumber(conversation, numbers)
    _saved(conversation, {number: one for one, number in numbers.items()}, arguments)
    before = {board.unique_id: board.number for board in first}
    _tell_numbers(arguments, [replace(board, number=before[board.unique_id]) for board in boards], numbers)


def _tell_numbers(arguments: argparse.Namespace, boards: Sequence[Board], numbers: Mapping[str, int]) -> None:
    for board in sorted(boards, key=lambda one: numbers[one.unique_id]):
        number = numbers[board.unique_id]
        if arguments.json:
            print(json_line({"node": number, "unique_id": board.unique_id, "before": board.number, "saved": True}))
        else:
            was = "" if board.number == number else f", was {board.number}"
            print(f"{number:4d} {board.role or '?':7} {board.unique_id}{was}")
    if not arguments.json and len(boards) > 1:
        print(f"all {len(boards)} have a number of their own, and have saved it")


def set_name(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Give a board a name."""
    words = words_of(arguments.text)
    conversation.listen()
    boards = boards_of(conversation)
    board = meant(boards, arguments.node, arguments.unique_id)
    taken = [other for other in boards if arguments.text and other.name == arguments.text and other != board]
    if taken:
        raise UserError(f"the name {arguments.text!r} is that of node {taken[0].number}: give another one")
    refuse_driven(conversation, [board], pause=arguments.pause)
    conversation.write({(board.number, word): value for word, value in zip(NAME_IDS, words, strict=True)})
    _saved(conversation, {board.number: board.unique_id}, arguments)
    if arguments.json:
        print(json_line({"node": board.number, "unique_id": board.unique_id, "name": arguments.text, "saved": True}))
    else:
        print(f"node {board.number} is called {arguments.text!r}, and has saved it")


def start_or_stop(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Start or stop boards, a group, or all."""
    command, word = SWITCHES[arguments.action], {"start": "started", "stop": "stopped"}[arguments.action]
    ways = [bool(arguments.nodes), arguments.group is not None, arguments.all]
    if sum(ways) != 1:
        raise UserError(f"nodes {arguments.action} takes numbers of nodes, --group G or --all: give one of these")
    if arguments.group is not None and not 1 <= arguments.group <= 255:
        raise UserError(f"--group {arguments.group} is no group: give one from 1 to 255")
    conversation.listen()
    boards = boards_of(conversation)
    if arguments.nodes:
        chosen = [meant(boards, number) for number in dict.fromkeys(arguments.nodes)]
        switch(conversation, command, chosen)
        done, refused = [board.number for board in chosen], list[int]()
    else:
        done, refused = switch_group(conversation, command, arguments.group)
    if not done:
        raise SystemFailure(f"{conversation.name}: no board was {word}: see their groups with goldfield nodes boards")
    if arguments.save:
        save_all(conversation, {n: meant(boards, n).unique_id for n in done}, pause=True)
    drivers = [n for n in refused if command == START and meant(boards, n).role != "sensor"]
    if arguments.json:
        print(json_line({word: done, "refused": drivers, "saved": arguments.save}))
        return
    print(f"{counted(len(done), 'boards')} {word}: {_list(done)}")
    if drivers:
        print(f"not started, as they were not commissioned: {_list(drivers)}")
    if not arguments.save:
        print("it holds until the next reset: --save keeps it")


def _list(numbers: Sequence[int]) -> str:
    return ", ".join(map(str, numbers))


def copy(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Copy the parameters of a board to others."""
    if arguments.source in arguments.targets:
        raise UserError(f"node {arguments.source} cannot be copied to itself: give the other boards behind it")
    conversation.listen()
    boards = boards_of(conversation)
    source = meant(boards, arguments.source)
    targets = [meant(boards, number) for number in dict.fromkeys(arguments.targets)]
    for target in targets:
        if target.role != source.role:
            raise UserError(
                f"node {target.number} is a {target.role} and node {source.number} a {source.role}: only boards of one "
                "role are copied"
            )
    refuse_driven(conversation, targets, pause=arguments.pause)
    changed = clone(conversation, source.number, [board.number for board in targets], source.role or "")
    _saved(conversation, {board.number: board.unique_id for board in targets}, arguments)
    if arguments.json:
        to = [board.number for board in targets]
        print(json_line({"from": source.number, "to": to, "changed": changed, "saved": True}))
    else:
        numbers = _list([board.number for board in targets])
        print(f"{counted(changed, 'values')} of node {source.number} copied to {numbers}, and saved")


def list_boards(conversation: Conversation, arguments: argparse.Namespace, _: object = None) -> None:
    """Print the boards by their unique ids, with name, group, and whether they are armed."""
    conversation.listen(arguments.seconds or 2.2)
    for board in sorted(boards_of(conversation), key=lambda one: (one.number, one.unique_id)):
        state = conversation.roster.nodes[board.number].state
        if arguments.json:
            print(json_line(board_record(board, state)))
            continue
        armed = {None: "?", True: "armed", False: "-"}[board.armed]
        group = "?" if board.group is None else str(board.group or "-")
        cells = (board.role or "?", state or "?", armed, group, board.access or "?")
        print(
            f"{board.number:4d} {cells[0]:7} {cells[1]:14} {cells[2]:6} {cells[3]:>5} {cells[4]:6}  {board.unique_id}"
            f"  {printable(board.name)}"
        )


def board_record(board: Board, state: str | None) -> dict[str, Any]:
    """Return what is known of a board, for JSON."""
    return {
        "node": board.number,
        "unique_id": board.unique_id,
        "role": board.role,
        "state": state,
        "name": board.name,
        "group": board.group,
        "armed": board.armed,
        "access": board.access,
    }
