"""Boards from the box to their places: who is there by unique id, one number each, names, start and stop, copies.

A board is meant by its unique id wherever something is done to it: two boards may share a number at first, as a fresh
board makes its number of its unique id.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from goldfield.errors import SystemFailure, UserError, counted
from goldfield.link.access import KEY, Locked
from goldfield.link.access_key import AccessKey
from goldfield.link.requests import Value
from goldfield.nodes.conversation import (
    ALL_GROUPS,
    DONE,
    DONE_RESTARTS,
    NUMBER,
    SAVE,
    START,
    STOP,
    TRIES,
    Conversation,
)
from goldfield.nodes.last_reset import NAME as RESET_REPORT
from goldfield.nodes.names import NAME_IDS, name_of
from goldfield_protocol.messages import Message
from goldfield_protocol.parameters import PARAMETERS

RESTART_S = 5.0
"""A board's first heartbeat after a reset is waited for so long, s."""
SAVED_AT_A_TIME = 24
"""Boards that save at a time."""
SAVES = "and its processor stands still for each word that it saves"
"""Why a coil cannot be driven while its board saves."""
LARGEST_NUMBER = 4095
ARMED, GROUP = PARAMETERS["armed"].first, PARAMETERS["group"].first
OWN = (
    "node",
    "name",
    "access_key",
    "armed",
    "sync_master",
    "zero_x",
    "zero_y",
    "zero_z",
    "calibration",
    "code",
    "slot",
    "can_rate",
    "serial_rate",
)
"""Parameters that are not copied from one board to another: number and name are the board's own, its key is told to
nobody; a copy is never armed,
and is no second sync master; zero and calibration are those of its converters; and of two boards with one code, or one
slot, none could be told from the other; bit rates are those of a board's own links."""


@dataclass(frozen=True)
class Board:
    """A board, by its unique id, with the number that it has and what it says of itself.

    Attributes
    ----------
    unique_id : str
    number : int
    role : str or None
    name : str
    group : int or None
    armed : bool or None
        None: it did not tell, or shares its number with another board.
    keyed : bool or None
        Whether it has a key, and is locked but for who knows it.
    """

    unique_id: str
    number: int
    role: str | None
    name: str = ""
    group: int | None = None
    armed: bool | None = None
    keyed: bool | None = None

    @property
    def access(self) -> str | None:
        """Whether anybody may change it, in a word."""
        return None if self.keyed is None else "locked" if self.keyed else "open"


def boards_of(conversation: Conversation) -> list[Board]:
    """Find all boards of a link, with their names, groups, and whether they are armed; in the order of their ids.

    Raises
    ------
    SystemFailure
        If there is none.
    """
    found = conversation.discover()
    if not found:
        raise SystemFailure(f"{conversation.name}: no node was heard: check the power, the cable and the bit rate")
    shared = Counter(number for _, number in found)
    alone = [number for _, number in found if shared[number] == 1 and conversation.roster.nodes[number].same_protocol]
    told = conversation.read(
        (number, parameter) for number in alone for parameter in (ARMED, GROUP, KEY.first, *NAME_IDS)
    )
    boards = []
    for unique_id, number in found:
        role = conversation.roster.nodes[number].role
        if shared[number] > 1 or (number, ARMED) not in told:
            boards.append(Board(unique_id, number, role))
            continue
        group, armed, keyed = (told.get((number, parameter)) for parameter in (GROUP, ARMED, KEY.first))
        name = name_of([told.get((number, word)) for word in NAME_IDS])
        boards.append(
            Board(
                unique_id,
                number,
                role,
                name,
                None if group is None else int(group),
                None if armed is None else bool(armed),
                None if keyed is None else bool(keyed),
            )
        )
    return boards


def assigned(boards: Sequence[Board], first: int, *, renew: bool) -> dict[str, int]:
    """Return a number for every board by its unique id: none is given twice.

    Parameters
    ----------
    boards : sequence of Board
    first : int
        The first number that is given to a board that needs one.
    renew : bool
        Whether all get new numbers, beacons and anchors before sensors, in the order of their ids. Else those keep
        theirs that have one of their own, and of those that share one the first by its id.

    Raises
    ------
    UserError
        If there are not so many numbers from ``first`` on, or two boards tell one unique id.

    Examples
    --------
    >>> two = [Board("0a", 7, "beacon"), Board("0b", 7, "sensor")]
    >>> assigned(two, 1, renew=False), assigned(two, 5, renew=True)
    ({'0a': 7, '0b': 1}, {'0a': 5, '0b': 6})
    """
    if first + len(boards) - 1 > LARGEST_NUMBER:
        raise UserError(f"numbers from {first} on do not suffice for all {len(boards)}: the last is {LARGEST_NUMBER}")
    told = Counter(board.unique_id for board in boards)
    if len(told) < len(boards):
        (unique_id, count), *_ = told.most_common(1)
        raise UserError(
            f"{counted(count, 'boards tell')} the unique id {unique_id}, so that none of them can be meant alone: "
            "leave one of them on the link, and replace the others"
        )
    result: dict[str, int] = {}
    if not renew:
        for board in boards:
            if board.number not in result.values():
                result[board.unique_id] = board.number
    free = iter(number for number in range(first, LARGEST_NUMBER + 1) if number not in set(result.values()))
    for board in sorted(boards, key=lambda one: (one.role == "sensor", one.unique_id)):
        if board.unique_id not in result:
            number = next(free, None)
            if number is None:
                raise UserError(f"no number from {first} on is free: give a smaller one with --first")
            result[board.unique_id] = number
    return {board.unique_id: result[board.unique_id] for board in boards}


def renumber(conversation: Conversation, numbers: Mapping[str, int]) -> None:
    """Give boards their numbers by their unique ids, and check that they have them.

    A number that another board still has is shared for a moment, which does no harm: boards are meant by their ids.

    Raises
    ------
    SystemFailure
        If a board is not heard, refuses, or has another number in the end.
    """
    for _ in range(TRIES):
        found = dict(conversation.discover())
        moving = [(one, found[one]) for one in numbers if one in found and found[one] != numbers[one]]
        if not moving and all(one in found for one in numbers):
            return
        while moving:
            # Answers tell the number alone: of boards that share one, one is asked at a time.
            turn = {number: one for one, number in reversed(moving)}
            with suppress(SystemFailure):  # The next round tells whether it was the answer that was lost.
                conversation.commands({number: (numbers[one], one) for number, one in turn.items()}, NUMBER)
            moving = [(one, number) for one, number in moving if one not in turn.values()]
    wrong = next(one for one in numbers if found.get(one) != numbers[one])
    raise SystemFailure(
        f"{conversation.name}: board {wrong} was to have the number {numbers[wrong]} and "
        f"{f'has {found[wrong]}' if wrong in found else 'is not heard'}: try again"
    )


def refuse_driven(conversation: Conversation, boards: Collection[Board], *, pause: bool, why: str = SAVES) -> None:
    """Refuse boards that have told that they drive their coils, before anything is changed, unless they may pause.

    They would refuse to save themselves, but then some have what was set, until their next reset, and others do not.
    ``why`` says why a coil cannot be driven meanwhile.

    Raises
    ------
    SystemFailure
        If there is one, and ``pause`` is False.
    """
    nodes = conversation.roster.nodes
    for board in boards:
        driven = board.number in nodes and any(drive.enabled for drive in nodes[board.number].drives.values())
        if driven and not pause:
            raise SystemFailure(
                f"{conversation.name}: node {board.number} drives its coil, {why}: let boards switch theirs off with "
                "--pause, or stop them with goldfield nodes stop; nothing was changed"
            )


def save_all(conversation: Conversation, boards: Mapping[int, str], *, pause: bool = False) -> int:
    """Let boards save their parameters, and wait for those that restart; return how many did.

    Parameters
    ----------
    conversation : Conversation
    boards : mapping of int to str
        Unique ids by the number.
    pause : bool
        Whether a coil may be switched off for it.

    Raises
    ------
    SystemFailure
        If a board does not answer, refuses, or is not heard again.
    """
    restarted = 0
    numbers = list(boards)
    for begin in range(0, len(numbers), SAVED_AT_A_TIME):
        part = numbers[begin : begin + SAVED_AT_A_TIME]
        nodes = conversation.roster.nodes
        before = {number: nodes[number].restarts if number in nodes else 0 for number in part}
        done = conversation.commands({number: (int(pause), boards[number]) for number in part}, SAVE)
        waiting = {number for number, status in done.items() if status == DONE_RESTARTS}
        restarted += len(waiting)
        await_restarts(conversation, {number: before[number] for number in waiting}, "has saved its parameters")
    return restarted


def await_restarts(conversation: Conversation, before: Mapping[int, int], what: str) -> None:
    """Wait until nodes have restarted once more than so often; `SystemFailure` names one that has not.

    The first heartbeat is lost on a serial line where the restart tore a frame: the report on the reset tells it, too.
    """
    nodes, reported = conversation.roster.nodes, set[int]()

    def silent() -> list[int]:
        return [
            n for n, count in before.items() if n not in reported and (n not in nodes or nodes[n].restarts <= count)
        ]

    def take(message: Message) -> bool:
        if (message.name, message.index) == (RESET_REPORT, 0):
            reported.add(message.node)
        return not silent()

    if silent() and not conversation.wait(take, RESTART_S):
        raise SystemFailure(
            f"{conversation.name}: node {silent()[0]} {what}, and was not heard since: power it off and on"
        )


def switch(conversation: Conversation, command: int, boards: Collection[Board]) -> None:
    """Start or stop boards, each by its unique id; `SystemFailure` if one refuses or does not answer."""
    conversation.commands({board.number: (0, board.unique_id) for board in boards}, command)


def switch_group(conversation: Conversation, command: int, group: int | None) -> tuple[list[int], list[int]]:
    """Start or stop the boards of a group, None: of all, with one message; return who did, and who refused.

    Sensors refuse a start, and boards that were not commissioned.
    """
    told = conversation.broadcast(command, ALL_GROUPS if group is None else group)
    return sorted(n for n, s in told.items() if s == DONE), sorted(n for n, s in told.items() if s != DONE)


def copied(role: str) -> dict[int, str]:
    """Return the ids of the parameters that are copied from a board of a role, with the names."""
    return {
        parameter.identifier(element): name
        for name, parameter in PARAMETERS.items()
        if name not in OWN and role in parameter.roles
        for element in range(parameter.count)
    }


def clone(conversation: Conversation, source: int, targets: Sequence[int], role: str) -> int:
    """Copy the parameters of a board to others, but those that are their own (`OWN`); return how many were changed.

    Raises
    ------
    SystemFailure
        If a board does not answer, or refuses.
    """
    wanted = copied(role)
    told = conversation.read((node, parameter) for node in (source, *targets) for parameter in wanted)
    silent = [node for node in (source, *targets) for parameter in wanted if told.get((node, parameter)) is None]
    if silent:
        raise SystemFailure(f"{conversation.name}: node {silent[0]} does not tell all its parameters: try again")
    changes: dict[tuple[int, int], Value] = {}
    for node in targets:
        for parameter in wanted:
            value = told[source, parameter]
            if value is not None and told[node, parameter] != value:
                changes[node, parameter] = value
    conversation.write(changes)
    return len(changes)


def set_key(conversation: Conversation, boards: Sequence[Board], key: AccessKey | None) -> None:
    """Give boards a key, or take theirs away, and check by a challenge that they have it; they have yet to save it.

    What the boards are locked with now is the key of the conversation, which has the new one behind it.

    Raises
    ------
    SystemFailure
        If a board does not answer, is locked with another key, or has not the new one in the end.
    """
    words = [0] * KEY.count if key is None else key.words
    before = conversation.key
    for board in boards:
        conversation.key = before
        ids = [(board.number, KEY.identifier(element)) for element in range(KEY.count)]
        conversation.unlock(board.number, board.unique_id) if board.keyed else None
        conversation.write(dict(zip(ids, words, strict=True)))
        conversation.key = key
        try:
            _check_key(conversation, board, key)
        except Locked as error:
            raise SystemFailure(
                f"{conversation.name}: node {board.number} did not take its key as it was given: power it off and on, "
                "so that it has what it had saved, and try again"
            ) from error


def _check_key(conversation: Conversation, board: Board, key: AccessKey | None) -> None:
    """Check that a board opens with a key, or needs none; `Locked` if it does not."""
    conversation.lock()
    if key is None:
        told = conversation.read([(board.number, KEY.first)])
        if told.get((board.number, KEY.first)) != 0:
            raise Locked(f"node {board.number} still has a key")
        return
    conversation.unlock(board.number, board.unique_id)


SWITCHES: Mapping[str, int] = {"start": START, "stop": STOP}
"""The commands by their words."""
