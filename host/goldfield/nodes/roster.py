"""Who is on a link, by what was heard: each node's latest words about itself, and requests of another host.

A node whose heartbeat tells another protocol is listed with it and its unique id, and nothing else of it is
understood.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import can
from cantools.database.errors import Error as DatabaseError

from goldfield.link.access import TO_BOARD
from goldfield.link.heartbeat import ROLES, STATE_STARTING, STATES
from goldfield.link.requests import UNKNOWN, Value, value_of
from goldfield.link.traffic import BY_MISMATCH, MEANINGLESS, kind_of
from goldfield.nodes.clock_quality import ClockQuality, quality_of
from goldfield.nodes.drive_health import DriveHealth, health_of
from goldfield.nodes.last_reset import NAME as RESET_REPORT
from goldfield.nodes.last_reset import LastReset, last_reset
from goldfield_protocol.messages import Message, decode, mismatch, protocol_hash

REQUESTS = ("PARAM_SET", "PARAM_GET", "PARAM_DESCRIBE", "COMMAND", "UPDATE_DATA")
"""Messages that hosts send; the node in their identifier is the receiver's."""
IDENTITY = "IDENTITY"
"""The message that is understood of a node of another protocol, too, so that it can be given this one's firmware."""
ECHO_S = 2.0
"""A bus that hands a host its own messages back does so within this time, s."""

UNLOCKED = "a clock that is not locked"


@dataclass(frozen=True)
class Drive:
    """One channel of a coil driver: a `DRIVE_STATUS`."""

    current_A: float
    reference_A: float
    target_A: float
    over_current: bool
    open_coil: bool
    driver_fault: bool
    enabled: bool
    locked: bool
    phase_s: float

    @property
    def complaints(self) -> list[str]:
        """What is wrong with it, in words."""
        said = (
            (self.over_current, "over-current"),
            (self.open_coil, "an open coil"),
            (self.driver_fault, "a driver fault"),
            (not self.locked, UNLOCKED),
            (self.target_A == 0.0, "an amplitude of 0 A"),
            (self.target_A != 0.0 and not self.enabled, "a bridge that is off"),
        )
        return [text for wrong, text in said if wrong]


@dataclass
class Node:
    """What one node number last said; None where nothing was heard of it.

    Attributes
    ----------
    number : int
    first_s, heard_s : float
        Times of its first and its latest message, s.
    messages : int
        How many messages it sent.
    role, state : str or None
        As in ``HEARTBEAT``.
    version : str or None
        Version of its firmware.
    protocol : int or None
        Hash of the protocol that it speaks.
    counters : dict of int to int
        Its error counters that are not zero, by index.
    drives : dict of int to Drive
        Its coil drivers by channel.
    health : dict of int to DriveHealth
        How they fare, by channel.
    locked : bool or None
        Whether its chip clock follows the sync signal.
    phase_s : float or None
        Phase of that clock against the sync signal, s.
    temperature_degC : float or None
        Temperature of a sensor's processor.
    clock : ClockQuality or None
        How it has the time.
    syncs : int
        ``SYNC`` messages that it sent: above 0 it is a sync master.
    parameters : dict of int to int or float or None
        Answers to reads by the parameter's id; None: it has no such parameter.
    halves : dict of int to dict of int to int
        The two halves of its unique id by the tag that they have in common: `unique_ids` joins them.
    reset_items : dict of int to dict of str to float
        What it told of its last reset, by the item: `last_reset` joins them.
    restarts : int
        Heartbeats that told a start.
    contradictions : int
        Times that role, version or protocol changed without a restart: two boards have its number.
    """

    number: int
    first_s: float
    heard_s: float
    messages: int = 0
    role: str | None = None
    state: str | None = None
    version: str | None = None
    protocol: int | None = None
    counters: dict[int, int] = field(default_factory=dict)
    drives: dict[int, Drive] = field(default_factory=dict)
    health: dict[int, DriveHealth] = field(default_factory=dict)
    locked: bool | None = None
    phase_s: float | None = None
    temperature_degC: float | None = None
    clock: ClockQuality | None = None
    syncs: int = 0
    parameters: dict[int, Value | None] = field(default_factory=dict)
    halves: dict[int, dict[int, int]] = field(default_factory=dict)
    reset_items: dict[int, Mapping[str, float]] = field(default_factory=dict)
    restarts: int = 0
    contradictions: int = 0

    @property
    def unique_ids(self) -> list[str]:
        """Unique ids of the processors that have this number, 24 hexadecimal digits each: two if it is taken twice."""
        whole = [halves for halves in self.halves.values() if len(halves) == 2]
        return sorted((halves[0].to_bytes(6, "little") + halves[1].to_bytes(6, "little")).hex() for halves in whole)

    @property
    def last_reset(self) -> LastReset | None:
        """Why it started, and how its last run ended; None if it has not told."""
        return last_reset(self.reset_items)

    @property
    def drives_coils(self) -> bool:
        """Whether it is a beacon or an anchor."""
        return self.role in ("beacon", "anchor")

    @property
    def same_protocol(self) -> bool:
        """Whether nothing is known against its speaking this host's protocol."""
        return self.protocol in (None, protocol_hash())


class Roster:
    """Takes every message of a link, and what this host sends.

    Attributes
    ----------
    nodes : dict of int to Node
        The nodes by number.
    others : dict of str to int
        What came and is no message of a node, by the kinds of `goldfield.link.traffic`.
    requests_of_others : list of Message
        Requests that this host did not send: another host speaks on the bus.
    """

    def __init__(self) -> None:
        self.nodes: dict[int, Node] = {}
        self.others: Counter[str] = Counter()
        self.requests_of_others: list[Message] = []
        self._sent: deque[tuple[float, int, bytes]] = deque(maxlen=1000)

    def sent(self, identifier: int, data: bytes, now_s: float) -> None:
        """Note a request of this host, which a bus may hand back."""
        self._sent.append((now_s, identifier, data))

    def take(self, raw: can.Message, now_s: float) -> None:
        """Take the next message that came."""
        kind = kind_of(raw) or _kind_of_data_frame(raw)
        message = None if kind is not None else decoded(raw)
        if message is None:
            self.others[kind or MEANINGLESS] += 1
        elif message.name in REQUESTS or (message.name, message.index) == ("ACCESS", TO_BOARD):
            self._take_request(message, raw.arbitration_id, bytes(raw.data), now_s)
        elif message.node == 0:
            self.others["messages of node 0, which is no node"] += 1
        else:
            node = self.nodes.setdefault(message.node, Node(message.node, now_s, now_s))
            node.heard_s = now_s
            node.messages += 1
            if message.name == "HEARTBEAT":
                _take_heartbeat(node, message)
            elif node.same_protocol or message.name == IDENTITY:
                _take_message(node, message)

    def _take_request(self, message: Message, identifier: int, data: bytes, now_s: float) -> None:
        while self._sent and self._sent[0][0] < now_s - ECHO_S:
            self._sent.popleft()
        # A bus may hand a message back more than once: each adapter and bridge on it can.
        if not any((own, own_data) == (identifier, data) for _, own, own_data in self._sent):
            self.requests_of_others.append(message)


def _kind_of_data_frame(raw: can.Message) -> str | None:
    """Return the kind of a frame that is no message by its identifier and length; None for one that may be."""
    fault = mismatch(raw.arbitration_id, len(raw.data))
    return None if fault is None else BY_MISMATCH[fault]


def decoded(raw: can.Message) -> Message | None:
    """Return a message that the protocol explains; None for any other."""
    try:
        return decode(raw.arbitration_id, bytes(raw.data))
    except (DatabaseError, ValueError):
        return None


def _take_heartbeat(node: Node, message: Message) -> None:
    signals = message.signals
    version = ".".join(str(int(signals[f"version_{part}"])) for part in ("major", "minor", "patch"))
    role = ROLES.get(int(signals["role"]))
    protocol, before = int(signals["protocol_hash"]), (node.role, node.version, node.protocol)
    if int(signals["state"]) == STATE_STARTING:
        node.counters.clear()
        node.parameters.clear()
        node.drives.clear()
        node.reset_items.clear()
        node.health.clear()
        node.syncs = 0
        node.restarts += 1
    elif node.role is not None and before != (role, version, protocol):
        node.contradictions += 1
    node.role, node.version, node.protocol = role, version, protocol
    node.state = STATES.get(int(signals["state"]))


def _take_message(node: Node, message: Message) -> None:
    signals = message.signals
    if message.name == "COUNTER":
        node.counters[message.index] = int(signals["value"])
    elif message.name == "DRIVE_STATUS":
        node.drives[message.index] = _drive(message)
        node.locked, node.phase_s = bool(signals["locked"]), signals["phase"] * 1e-9
    elif message.name == "DRIVE_HEALTH":
        node.health[message.index] = health_of(message)
    elif message.name == "EPOCH_STATUS":
        node.locked, node.phase_s = bool(signals["locked"]), signals["phase"] * 1e-9
        node.temperature_degC = signals["temperature"]
    elif message.name == "CLOCK":
        node.clock = quality_of(message)
    elif message.name == "SYNC":
        node.syncs += 1
    elif message.name == IDENTITY and message.index in (0, 1):
        node.halves.setdefault(int(signals["tag"]), {})[message.index] = int(signals["half"])
    elif message.name == RESET_REPORT:
        if message.index == 0:
            node.reset_items.clear()  # A new report begins.
        node.reset_items[message.index] = signals
    elif message.name == "PARAM_VALUE":
        node.parameters[message.index] = None if signals["status"] == UNKNOWN else value_of(signals)


def _drive(message: Message) -> Drive:
    signals = message.signals
    return Drive(
        current_A=signals["current"],
        reference_A=signals["reference"],
        target_A=signals["target"],
        over_current=bool(signals["over_current"]),
        open_coil=bool(signals["open_coil"]),
        driver_fault=bool(signals["driver_fault"]),
        enabled=bool(signals["enabled"]),
        locked=bool(signals["locked"]),
        phase_s=signals["phase"] * 1e-9,
    )
