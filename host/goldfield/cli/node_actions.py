"""What ``goldfield nodes`` does on an open link, and how it prints it."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from goldfield.cli import identification, node_bit_rate, node_boards, node_key
from goldfield.cli.output import json_line, number
from goldfield.errors import SystemFailure, UserError, counted
from goldfield.link.heartbeat import ROLES
from goldfield.link.line import PARAMETER, Link
from goldfield.link.requests import Value
from goldfield.nodes.commissioning import Board, await_restarts, boards_of
from goldfield.nodes.conversation import CLEAR, DONE_RESTARTS, HEARD_S, RESET, SAVE, Conversation
from goldfield.nodes.elements import elements_of, parsed, shown
from goldfield.nodes.elf_lines import ElfLines
from goldfield.nodes.last_reset import LastReset, words_of
from goldfield.nodes.roster import Node
from goldfield.view.boards import clock_record
from goldfield.view.terminal import WIDTH
from goldfield_protocol.messages import protocol_hash
from goldfield_protocol.parameters import PARAMETERS, Parameter, counter_name

MOST_SHOWN = 16
"""Elements of an array that the list of all parameters shows."""

Asked = tuple[Parameter, Sequence[int], Sequence[Value]] | None
"""The parameter that is named, its elements, and the values to set."""


def checked(arguments: argparse.Namespace) -> Asked:
    """Return what is asked of which parameter; `UserError` if there is none such, or a board would refuse a value."""
    name = getattr(arguments, "name", None)
    if name is None:
        return None
    parameter, elements = elements_of(name)
    texts = getattr(arguments, "values", [])
    if len(texts) > len(elements):
        raise UserError(f"{name} got {len(texts)} values; it takes {len(elements)} at most")
    if not texts:
        return parameter, elements, ()
    if parameter.name == "node":
        raise UserError(
            "a number is given so that no other board has it: goldfield nodes number takes the old and the new"
        )
    if parameter.secret:
        raise UserError(f"{name} is secret, and a command line is not: goldfield nodes key set takes it from its file")
    elements = elements[: len(texts)]
    return parameter, elements, [parsed(parameter, *pair) for pair in zip(elements, texts, strict=True)]


def print_list(conversation: Conversation, arguments: argparse.Namespace, _: Asked) -> None:
    """Print who is there."""
    images = [ElfLines(path) for path in arguments.elf]
    conversation.listen(arguments.seconds or HEARD_S)
    if not conversation.roster.nodes:
        raise SystemFailure(f"{conversation.name}: no node was heard: check the power, the cable and the bit rate")
    boards = {board.number: board for board in boards_of(conversation)}
    conversation.last_resets()
    nodes = sorted(conversation.roster.nodes.values(), key=lambda node: node.number)
    if arguments.json:
        for node in nodes:
            print(json_line(node_record(node, boards.get(node.number), _image_of(node, images))))
        return
    print(f"{'node':>4} {'role':7} {'state':14} {'version':8} {'current A':>12}  clock")
    for node in nodes:
        for line in _lines_of(node, boards.get(node.number), _image_of(node, images)):
            print(line)


def _image_of(node: Node, images: Sequence[ElfLines]) -> ElfLines | None:
    """Return the program of a node: the file that is named after its role, else one that is named after none."""
    named = [image for image in images if image.role == node.role]
    return next(iter(named or [image for image in images if image.role not in ROLES.values()]), None)


def node_record(node: Node, board: Board | None, image: ElfLines | None = None) -> dict[str, Any]:
    """Return what is known of a node, for JSON; ``board`` is that which has its number, alone."""
    return {
        "node": node.number,
        "role": node.role,
        "state": node.state,
        "version": node.version,
        "protocol": None if node.protocol is None else f"{node.protocol:#010x}",
        "same_protocol": node.same_protocol,
        "unique_ids": node.unique_ids,
        "name": None if board is None else board.name,
        "group": None if board is None else board.group,
        "armed": None if board is None else board.armed,
        "access": None if board is None else board.access,
        "locked": node.locked,
        "phase_s": None if node.phase_s is None else number(node.phase_s),
        "temperature_degC": node.temperature_degC,
        "sync_master": node.syncs > 0,
        "clock": None if node.clock is None else clock_record(node.clock),
        "drives": [{"channel": channel, **asdict(drive)} for channel, drive in sorted(node.drives.items())],
        "last_reset": None if node.last_reset is None else _reset_record(node.last_reset, image),
        "health": [{"channel": channel, **asdict(health)} for channel, health in sorted(node.health.items())],
        "counters": {counter_name(index): count for index, count in sorted(node.counters.items())},
    }


def _reset_record(reset: LastReset, image: ElfLines | None) -> dict[str, Any]:
    crash = reset.crash
    record = {
        "cause": reset.cause,
        "uptime_s": reset.uptime_s,
        "stalled": list(reset.stalled),
        "counts": dict(reset.counts),
        "text": ". ".join(words_of(reset, image)),
        "crash": None,
    }
    if crash is not None:
        record["crash"] = {
            "fault": crash.fault,
            "exception": crash.exception,
            "stack_overflow": crash.stack_overflow,
            "registers": {name: f"{value:#010x}" for name, value in crash.registers.items()},
            "place": None if image is None else image.place(crash.registers.get("pc", 0) & ~1),
        }
    return record


def _lines_of(node: Node, board: Board | None, image: ElfLines | None) -> Iterator[str]:
    """Yield a line of the table, and below it what is worth saying."""
    drive = node.drives.get(0)
    current = "" if drive is None else f"{drive.current_A:.2f} of {drive.target_A:g}"
    clock = {None: "-", True: "locked", False: "not locked"}[node.locked]
    cells = (node.role or "?", node.state or "?", node.version or "?")
    yield f"{node.number:4d} {cells[0]:7} {cells[1]:14} {cells[2]:8} {current or '-':>12}  {clock}"
    for text in _words_of(node, board, image):
        yield from textwrap.wrap(text, WIDTH, initial_indent=" " * 5, subsequent_indent=" " * 7)


def _words_of(node: Node, board: Board | None, image: ElfLines | None) -> Iterator[str]:
    if node.syncs and (node.clock is None or node.clock.rank <= 1):
        yield "sync master"
    if node.clock is not None:
        yield from node.clock.words
    if not node.same_protocol:
        yield (
            f"speaks protocol {node.protocol:#010x} and this host {protocol_hash():#010x}: flash it with this "
            f"version's firmware (make flash ROLE={node.role or 'beacon'})"
        )
    access = f", {board.access}" if board is not None and board.access is not None else ""
    yield from (f"unique id {unique_id}{access}" for unique_id in node.unique_ids)
    if node.contradictions or len(node.unique_ids) > 1:
        yield f"two boards have the number {node.number}: give each its own: goldfield nodes assign"
    if board is not None and (board.name or board.group):
        yield ", ".join([f"called {board.name!r}"] * bool(board.name) + [f"group {board.group}"] * bool(board.group))
    if board is not None and node.drives_coils and board.armed is False:
        yield f"not armed, its coil stays off: goldfield nodes start {node.number}"
    for channel, drive in sorted(node.drives.items()):
        if drive.complaints:
            yield f"channel {channel} reports {', '.join(drive.complaints)}"
    if node.last_reset is not None:
        yield from words_of(node.last_reset, image)
    yield from _kept_off(node)
    for channel, health in sorted(node.health.items()):
        if health.headroom_lost:
            yield f"channel {channel} does not keep to its current: its supply is too low, or its amplitude too high"
    if node.counters:
        yield "counted: " + ", ".join(counted(count, counter_name(i)) for i, count in sorted(node.counters.items()))


def _kept_off(node: Node) -> Iterator[str]:
    for channel, health in sorted(node.health.items()):
        if health.reason is not None:
            yield f"channel {channel} is off: {health.reason}; {health.remedy(node.number)}"


def print_values(conversation: Conversation, arguments: argparse.Namespace, asked: Asked) -> None:
    """Print the values of one parameter, or of all that the node's role uses."""
    node = arguments.node
    if asked is not None:
        parameter, elements, _ = asked
        values = _read(conversation, node, {parameter.name: elements})
        _print_values(arguments, node, parameter, elements, values)
        return
    conversation.listen()
    known = conversation.roster.nodes.get(node)
    if known is None or known.role is None:
        raise SystemFailure(f"{conversation.name}: node {node} was not heard: see who is there with goldfield nodes")
    wanted = {p.name: range(p.count) for p in PARAMETERS.values() if known.role in p.roles and p.count <= MOST_SHOWN}
    values = _read(conversation, node, wanted)
    for name, elements in wanted.items():
        _print_values(arguments, node, PARAMETERS[name], elements, values)


def _read(
    conversation: Conversation, node: int, wanted: Mapping[str, Sequence[int]]
) -> Mapping[tuple[int, int], Value | None]:
    """Return the values of elements; `SystemFailure` if any is not told."""
    ids = [(node, PARAMETERS[name].identifier(e)) for name, elements in wanted.items() for e in elements]
    values = conversation.read(ids)
    missing = [label for label in ids if values.get(label) is None]
    if missing:
        why = (
            "has no such parameter"
            if missing[0] in values
            else "does not answer: see who is there with goldfield nodes"
        )
        raise SystemFailure(f"{conversation.name}: node {node} {why}")
    return values


def _print_values(
    arguments: argparse.Namespace,
    node: int,
    parameter: Parameter,
    elements: Sequence[int],
    values: Mapping[tuple[int, int], Value | None],
) -> None:
    told = [values[node, parameter.identifier(element)] for element in elements]
    if arguments.json:
        print(json_line(_record(node, parameter, elements, told)))
        return
    name = parameter.label(elements[0]) if len(elements) == 1 else parameter.name
    if parameter.secret:
        print(f"{name} is {'set' if any(told) else 'not set'}, which is all that a board tells of it")
        return
    print(f"{name} = {shown(parameter, elements, told)}  ({parameter.range_text})")


def _record(node: int, parameter: Parameter, elements: Sequence[int], values: Sequence[Value | None]) -> dict[str, Any]:
    low, high = parameter.low, parameter.high
    return {
        "node": node,
        "parameter": parameter.name,
        "elements": list(elements),
        "values": [None if value is None else number(value) if isinstance(value, float) else value for value in values],
        "units": [parameter.units[element % parameter.group] for element in elements],
        "range": [low, high],
        "at_start": parameter.at_start,
    }


def set_values(conversation: Conversation, arguments: argparse.Namespace, asked: Asked) -> None:
    """Set elements of a parameter one after the other, and print what is in force."""
    assert asked is not None
    parameter, elements, wanted = asked
    conversation.discover()  # Whether another board has this number, too, which would be set with it.
    before = _read(conversation, arguments.node, {parameter.name: elements})
    told = [
        conversation.set(arguments.node, parameter.identifier(element), value, parameter.kind)
        for element, value in zip(elements, wanted, strict=True)
    ]
    old = [before[arguments.node, parameter.identifier(element)] for element in elements]
    if arguments.json:
        print(json_line(_record(arguments.node, parameter, elements, told) | {"before": old}))
        return
    name = parameter.label(elements[0]) if len(elements) == 1 else parameter.name
    print(f"{name} = {shown(parameter, elements, told)}, was {shown(parameter, elements, old)}")
    if parameter.at_start:
        print(f"it acts only if it is saved, as the board reads it at its start: goldfield nodes save {arguments.node}")
        if parameter.name == PARAMETER[Link.CAN]:
            print("all boards of a bus need one rate: goldfield nodes bit-rate brings them there together")
    else:
        print(f"it holds until the board's next reset: to keep it, goldfield nodes save {arguments.node}")
    known = conversation.roster.nodes.get(arguments.node)
    for text in _kept_off(known) if known is not None else ():
        print(text)


def _meant(conversation: Conversation, arguments: argparse.Namespace) -> tuple[Node, str]:
    """Return the node that is meant, and the unique id of its board."""
    number = arguments.node
    conversation.discover()  # of two boards with one number both are heard
    node = conversation.roster.nodes.get(number)
    found = node.unique_ids if node is not None else []
    if node is None or not found:
        raise SystemFailure(
            f"{conversation.name}: node {number} does not answer: see who is there with goldfield nodes"
        )
    wanted = found[0] if arguments.unique_id is None else arguments.unique_id.lower()
    if wanted not in found or (len(found) > 1 and arguments.unique_id is None):
        raise UserError(f"node {number} is {' and '.join(found)}: name one of them with --id")
    return node, wanted


def clear_cause(conversation: Conversation, arguments: argparse.Namespace, _: Asked) -> None:
    """Let a beacon's drive go on."""
    _node, wanted = _meant(conversation, arguments)
    conversation.command(arguments.node, CLEAR, board=wanted)
    if arguments.json:
        print(json_line({"node": arguments.node, "unique_id": wanted, "cleared": True}))
    else:
        print(f"node {arguments.node} may drive again: after repeated faults it waits a while before it does")


def save(conversation: Conversation, arguments: argparse.Namespace, _: Asked) -> None:
    """Let a board save its parameters."""
    number = arguments.node
    meant, wanted = _meant(conversation, arguments)
    restarts = meant.restarts
    status = conversation.command(number, SAVE, int(arguments.pause), wanted)
    if status == DONE_RESTARTS:
        await_restarts(conversation, {number: restarts}, "has saved its parameters")
    if arguments.json:
        restarted = status == DONE_RESTARTS
        print(json_line({"node": number, "unique_id": wanted, "saved": True, "restarted": restarted}))
    elif status == DONE_RESTARTS:
        print(f"node {number} has saved all its parameters, and has restarted, as it had to erase flash for them")
    else:
        print(f"node {number} has saved all its parameters")


def reset(conversation: Conversation, arguments: argparse.Namespace, _: Asked) -> None:
    """Restart a board, and wait until it says that it has."""
    number = arguments.node
    meant, wanted = _meant(conversation, arguments)
    restarts = meant.restarts
    conversation.command(number, RESET, board=wanted)
    await_restarts(conversation, {number: restarts}, "took the reset")
    if arguments.json:
        print(json_line({"node": number, "unique_id": wanted, "reset": True}))
    else:
        print(f"node {number} has restarted")


ACTIONS: dict[str | None, Callable[[Conversation, argparse.Namespace, Asked], None]] = {
    None: print_list,
    "get": print_values,
    "set": set_values,
    "identify": identification.identify,
    "boards": node_boards.list_boards,
    "number": node_boards.set_number,
    "assign": node_boards.assign,
    "name": node_boards.set_name,
    "start": node_boards.start_or_stop,
    "stop": node_boards.start_or_stop,
    "clone": node_boards.copy,
    "key": node_key.act,
    "bit-rate": node_bit_rate.act,
    "reset": reset,
    "clear": clear_cause,
    "save": save,
}
