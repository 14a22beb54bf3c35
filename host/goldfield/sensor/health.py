"""What every board on a link last said of itself, and when, on the clock of the sensor that is read.

The clock is that of the sensor's own reports, so that a recording, a bench that runs slower than the wall clock and a
sensor on a desk are judged alike. What it all means for an epoch is told by `goldfield.sensor.verdict`.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

from goldfield.link.heartbeat import DRIVING, STATE_STARTING
from goldfield.sensor.headers import Event, Headers
from goldfield_protocol.messages import Message
from goldfield_protocol.parameters import COUNTERS, PARAMETERS

SYNC_REJECTED = next(counter.index for counter in COUNTERS if counter.name == "sync edges rejected")
MANY_EDGES = 3
"""Edges of the sync wire that a board rejects from one heartbeat to the next, a second, if they come regularly. A
second master makes 5 of degree 11 and 10 of any other; a clock that changes to another master rejects 3, once."""

TURNS_S = 3.0
"""A board whose `SYNC` is not older leads still when another one's has come and its own comes again."""
LONGEST_STEP_S = 0.5
"""The clock goes on by so much at most from one header to the next: in a longer gap nobody was heard, not one board."""

CODE, WAVEFORM = PARAMETERS["code"].first, PARAMETERS["waveform"].first
ASKED = (CODE, WAVEFORM)
"""Parameters that tell which beacon of the site a board is; no message does."""
ONE_CODE = 0
"""Value of ``waveform`` with which a board drives the one code of its parameter ``code``."""


@dataclass(frozen=True)
class Drive:
    """A `DRIVE_STATUS`, as the DBC has it, with the time at which it came."""

    time_s: float
    current_A: float
    target_A: float
    over_current: bool
    open_coil: bool
    driver_fault: bool
    enabled: bool
    locked: bool


@dataclass
class Board:
    """What one node last said; times are those of `Health.now_s`.

    Attributes
    ----------
    node : int
    heard_s : float
        Time of its latest message of any kind.
    role, state : int or None
        Role and state of the latest heartbeat; None while there was none.
    drive, drive_before : Drive or None
        The two latest reports of channel 0, the later one first.
    counters : dict of int to int
        Error counters since its reset.
    parameters : dict of int to int or None
        Answers to reads of `ASKED`; None if the board has no such parameter.
    restarted_s, renumbered_s, doubled_s : float or None
        Latest time at which it restarted, at which the numbers of its cycles jumped while it was locked, and at which
        two boards spoke in its name.
    locked : bool or None
        Whether its clock is locked, by its latest `EPOCH_STATUS`.
    disturbed_s : float or None
        Latest time at which it told, not for the first time, that it rejects `MANY_EDGES` of the sync wire a second.
    """

    node: int
    heard_s: float
    role: int | None = None
    state: int | None = None
    drive: Drive | None = None
    drive_before: Drive | None = None
    counters: dict[int, int] = field(default_factory=dict)
    parameters: dict[int, int | None] = field(default_factory=dict)
    restarted_s: float | None = None
    renumbered_s: float | None = None
    doubled_s: float | None = None
    locked: bool | None = None
    disturbed_s: float | None = None
    disturbed_before: bool = False

    @property
    def code(self) -> int | None:
        """The code that it drives; None if that is unknown, or if it drives anything but one code."""
        return self.parameters.get(CODE) if self.parameters.get(WAVEFORM) == ONE_CODE else None

    @property
    def unasked(self) -> tuple[int, ...]:
        """Parameters that it has yet to be asked for."""
        return tuple(p for p in ASKED if p not in self.parameters) if self.role in DRIVING else ()


class Health:
    """Takes every message of a link in the order of arrival.

    Parameters
    ----------
    cycle_s : float
        Duration of a code cycle, s.

    Attributes
    ----------
    node : int or None
        The sensor whose reports are the clock; None: the first node that reports.
    now_s : float
        Time since the first report, s.
    boards : dict of int to Board
        The boards that were heard, by node.
    masters : dict of int to float
        Time of each node's latest `SYNC`.
    rivals : dict of int to float
        The nodes that lead beside another one, and until when they did: of two that send `SYNC` by turns one does not
        take over from the other.
    """

    def __init__(self, cycle_s: float) -> None:
        self.node: int | None = None
        self.now_s = 0.0
        self.boards: dict[int, Board] = {}
        self.masters: dict[int, float] = {}
        self.rivals: dict[int, float] = {}
        self._leader: int | None = None
        self._cycle_s = cycle_s
        self._time_s: float | None = None
        self._headers: dict[int, Headers] = {}
        self._identities: dict[int, dict[tuple[float, ...], float]] = {}

    def take(self, message: Message) -> None:
        """Take the next message."""
        node = message.node
        if message.name == "EPOCH" and node == (node if self.node is None else self.node):
            self.node = node
            self._advance(message.signals["time"])
        board = self.boards.setdefault(node, Board(node, self.now_s))
        board.heard_s = self.now_s
        if message.name == "SYNC":
            self._take_sync(node)
        elif message.name == "HEARTBEAT":
            self._take_heartbeat(board, message)
        elif message.name == "COUNTER":
            self._take_counter(board, message.index, int(message.signals["value"]))
        elif message.name == "DRIVE_STATUS" and message.index == 0:
            board.drive_before, board.drive = board.drive, _drive(message, self.now_s)
        elif message.name == "PARAM_VALUE" and message.index in ASKED:
            self._take_parameter(board, message)
        elif message.name == "EPOCH":
            self._take_header(board, message)
        elif message.name == "EPOCH_STATUS":
            board.locked = bool(message.signals["locked"])

    def _take_sync(self, node: int) -> None:
        before = self._leader
        if before is not None and before != node and self.now_s - self.masters.get(node, -math.inf) < TURNS_S:
            self.rivals[node] = self.rivals[before] = self.masters[before]
        self.masters[node] = self.now_s
        self._leader = node

    @property
    def counters(self) -> dict[int, Counter[int]]:
        """The error counters that are not zero, by node."""
        found = {node: Counter(board.counters) for node, board in sorted(self.boards.items())}
        return {node: +counter for node, counter in found.items() if +counter}

    def _advance(self, time_s: float) -> None:
        if self._time_s is not None:
            self.now_s += min(max(0.0, time_s - self._time_s), LONGEST_STEP_S)
        self._time_s = time_s

    def _take_heartbeat(self, board: Board, message: Message) -> None:
        signals = message.signals
        board.role, board.state = int(signals["role"]), int(signals["state"])
        identities = self._identities.setdefault(board.node, {})
        if board.state == STATE_STARTING:
            identities.clear()  # the board may have got other firmware
            board.counters.clear()
            board.parameters.clear()
            board.drive = board.drive_before = None
            self._restarted(board)
        identity = tuple(signals[name] for name in ("role", "version_major", "version_minor", "version_patch"))
        latest = max(identities.values(), default=0.0)
        if identity in identities and identities[identity] < latest:
            board.doubled_s = self.now_s
        identities[identity] = self.now_s

    def _take_counter(self, board: Board, index: int, value: int) -> None:
        if index == SYNC_REJECTED:
            disturbed = value - board.counters.get(index, value) >= MANY_EDGES
            if disturbed and board.disturbed_before:
                board.disturbed_s = self.now_s
            board.disturbed_before = disturbed
        board.counters[index] = value

    def _take_parameter(self, board: Board, message: Message) -> None:
        known = not message.signals["status"]
        value = int(message.signals.get("value_unsigned", -1)) if known else None
        if board.parameters.get(message.index, value) != value:
            board.doubled_s = self.now_s
        board.parameters[message.index] = value

    def _take_header(self, board: Board, message: Message) -> None:
        headers = self._headers.setdefault(board.node, Headers(self._cycle_s))
        event = headers.take(int(message.signals["cycle"]), message.signals["time"])
        if event is Event.DOUBLED and board.locked is not False:  # a starting board may begin its count several times
            board.doubled_s = self.now_s
        elif event is Event.RESTARTED:
            self._restarted(board)
        elif event is Event.RENUMBERED and board.locked:
            board.renumbered_s = self.now_s

    def _restarted(self, board: Board) -> None:
        """Note a restart; the heartbeat and the first header after it tell of the same one."""
        board.restarted_s = self.now_s


def _drive(message: Message, now_s: float) -> Drive:
    flags = {name: bool(message.signals[name]) for name in ("over_current", "open_coil", "driver_fault")}
    flags |= {name: bool(message.signals[name]) for name in ("enabled", "locked")}
    return Drive(now_s, message.signals["current"], message.signals["target"], **flags)
