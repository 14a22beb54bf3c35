"""Zero and calibration of a live sensor board: read with its unique id, and written."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass

import numpy as np

from goldfield.errors import SystemFailure, UserError, tell
from goldfield.link.access import Locked
from goldfield.link.access_key import AccessKey
from goldfield.nodes import opening
from goldfield.nodes.conversation import Conversation
from goldfield.nodes.tap import Tap
from goldfield.types import FloatArray
from goldfield_protocol.parameters import PARAMETERS, Parameter

HOLDS = "it holds until the board's next reset, unless goldfield nodes save keeps it"
SENSING = {"sensor", "anchor"}
"""Roles of boards with a sensor: sensor and anchor."""


@dataclass(frozen=True, eq=False)
class BoardCalibration:
    """What a board corrects with: B = matrix (counts - zero)."""

    node: int
    unique_id: str
    zero: FloatArray
    matrix: FloatArray


def _elements() -> list[tuple[Parameter, int]]:
    zeros = [(PARAMETERS[f"zero_{axis}"], 0) for axis in "xyz"]
    return zeros + [(PARAMETERS["calibration"], element) for element in range(9)]


def read(kind: str, where: str, node: int | None, bit_rate: int | None = None) -> BoardCalibration:
    """Read from a link, of the kinds of `goldfield.nodes.opening`, what its only sensor, or a node, has.

    Raises
    ------
    UserError
        If there are several sensors to choose from.
    SystemFailure
        If the board does not answer.
    """
    with closing(Tap(opening.open_link(kind, where, bit_rate))) as tap:
        conversation = Conversation(tap)
        conversation.listen()
        found = [one.number for one in conversation.roster.nodes.values() if one.role in SENSING]
        chosen = [number for number in found if node in (None, number)]
        if not chosen:
            raise SystemFailure(f"{where}: no sensor{f' of node {node}' if node else ''} is heard: see goldfield nodes")
        if len(chosen) > 1:
            raise UserError(f"{where}: nodes {', '.join(map(str, chosen))} have a sensor: choose with --node")
        number = chosen[0]
        conversation.discover()
        ids = conversation.roster.nodes[number].unique_ids
        wanted = [(number, parameter.identifier(element)) for parameter, element in _elements()]
        values = conversation.read(wanted)
        if len(ids) != 1 or any(values.get(key) is None for key in wanted):
            raise SystemFailure(
                f"{where}: node {number} does not tell its unique id and calibration: see goldfield nodes"
            )
        numbers = np.array([values[key] for key in wanted], dtype=np.float64)
        return BoardCalibration(number, ids[0], numbers[:3], numbers[3:].reshape(3, 3))


def write(
    kind: str,
    where: str,
    before: BoardCalibration,
    zero: FloatArray,
    matrix: FloatArray,
    key: AccessKey | None = None,
    bit_rate: int | None = None,
) -> None:
    """Set a board's zero and matrix: all twelve numbers, or none.

    A board has no way to take them at once. If it refuses one or does not answer, or at Ctrl-C, it is given back what
    it had ``before``: part of a calibration is worse than none.

    Raises
    ------
    SystemFailure
        If the board refuses or does not answer; if it is locked, and ``key`` is none, or not its own.
    """
    with closing(Tap(opening.open_link(kind, where, bit_rate), key)) as tap:
        conversation = Conversation(tap)
        done: list[Parameter] = []
        try:
            _set(conversation, before.node, zero, matrix, done)
        except BaseException as error:
            if done or not isinstance(error, Locked):
                _give_back(conversation, before)
            raise


def _give_back(conversation: Conversation, before: BoardCalibration) -> None:
    try:
        _set(conversation, before.node, before.zero, before.matrix, [])
    except (SystemFailure, KeyboardInterrupt):
        tell(
            f"node {before.node} may have part of a new calibration, and could not be given its old one: reset it, or "
            "calibrate it again",
            failure=True,
        )
    else:
        tell(f"node {before.node} has its old calibration again", failure=True)


def _set(conversation: Conversation, node: int, zero: FloatArray, matrix: FloatArray, done: list[Parameter]) -> None:
    """Set the twelve numbers, and note those that are set in ``done``."""
    for (parameter, element), value in zip(_elements(), [*zero, *matrix.ravel()], strict=True):
        conversation.set(node, parameter.identifier(element), float(value), parameter.kind)
        done.append(parameter)
