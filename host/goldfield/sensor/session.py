"""A sensor at the other end of a link: found by its heartbeat, checked for its protocol, set to the site's codes."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Mapping, Sequence

import can
from cantools.database.errors import Error as DatabaseError

from goldfield.errors import SystemFailure, UserError
from goldfield.link.buses import BusSource, Source
from goldfield.link.recordings import CandumpWriter
from goldfield.link.reports import OWN_POSE, Assembler, Report
from goldfield_protocol.messages import Identifier, Message, database, decode, encode, protocol_hash
from goldfield_protocol.parameters import PARAMETERS, Kind, find_id, label_of

ROLES = {0: "beacon", 1: "sensor", 2: "host", 3: "anchor"}
ROLE_SENSOR, ROLE_ANCHOR = 1, 3
STATE_STARTING = 0

LONGEST_CODE_LIST = PARAMETERS["code_list"].count
OUT_OF_RANGE = 2
PARAM_STATUS = {1: "unknown", OUT_OF_RANGE: "out of range", 3: "of the wrong kind", 4: "read-only"}

TRIES = 5
ANSWER_S = 1.0
QUIET_S = 1.0
"""After so long a live sensor's incomplete reports are handed out."""
SILENCE_S = 10.0
PATIENCE_S = 30.0
"""Heartbeats come once a second, but simulated boards may run slower than the wall clock: while something is heard, the
sensor's is awaited so long."""

USED = ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", "FIELD", "PART", "HEARTBEAT", "COUNTER", "PARAM_VALUE", *OWN_POSE)
USED_TYPES = {Identifier.unpack(database().get_message_by_name(name).frame_id).type for name in USED}


class Session:
    """Reads one sensor.

    Parameters
    ----------
    source : Source
    name : str
        Of the link, for messages.
    assembler : Assembler
        Its counters tell what went wrong.
    node : int or None
        The sensor's node, which may be an anchor's; None: the first sensor that is heard, and no anchor.
    recorder : CandumpWriter or None
        Gets every message received.

    Attributes
    ----------
    counters : dict of int to int
        The sensor's own error counters since its reset, those that are not zero; `counter_name` names them.
    """

    def __init__(
        self,
        source: Source,
        name: str,
        assembler: Assembler,
        node: int | None = None,
        recorder: CandumpWriter | None = None,
    ) -> None:
        self.node = node
        self.assembler = assembler
        self.undecodable = 0
        self.counters: dict[int, int] = {}
        self._source = source
        self.name = name
        self._recorder = recorder
        self._asked = node is not None
        self._configured: tuple[BusSource, Sequence[int], Mapping[int, int | float]] | None = None

    @property
    def bad_frames(self) -> int:
        """Frames that the link dropped as corrupt, and messages that say nothing by the DBC."""
        return self._source.bad_frames + self.undecodable

    def find_sensor(self) -> None:
        """Wait for the sensor's heartbeat.

        Raises
        ------
        SystemFailure
            If nothing is heard for `SILENCE_S`, or no sensor within `PATIENCE_S`.
        UserError
            If a node speaks another protocol.
        """
        heard: set[str] = set()
        begin = heard_last = time.monotonic()
        while time.monotonic() < min(heard_last + SILENCE_S, begin + PATIENCE_S):
            message = self._receive(min(SILENCE_S, 0.5))
            if message is None:
                continue
            heard_last = time.monotonic()
            role = message.signals["role"] if message.name == "HEARTBEAT" else None
            if role == ROLE_SENSOR or (role == ROLE_ANCHOR and self._asked):
                if self.node in (None, message.node):
                    self.node = message.node
                    return
                heard.add(f"{ROLES[int(role)]} {message.node}")
            elif role == ROLE_ANCHOR:
                heard.add(f"anchor {message.node} (to read it, give --node {message.node})")
            else:
                heard.add(f"{message.name} of node {message.node}")
        wanted = "a sensor" if self.node is None else f"sensor {self.node}"
        if heard:
            what = f"heard only {', '.join(sorted(heard)[:4])}"
        elif self.bad_frames:
            what = f"heard only {self.bad_frames} corrupt frames: check the wiring and that nothing else uses the link"
        else:
            what = "heard nothing: check the power, the cable and the port"
        waited_s = time.monotonic() - begin
        raise SystemFailure(f"{self.name}: no heartbeat of {wanted} in {waited_s:.0f} s; {what}")

    def check_degree(self, bus: BusSource, degree: int) -> None:
        """Check that the sensor works with codes of the site's degree, which it reads once at its start.

        Raises
        ------
        UserError
            If it does not.
        SystemFailure
            If it does not answer.
        """
        own = self._ask(bus, PARAMETERS["degree"].first)
        if own != degree:
            raise UserError(
                f"{self.name}: sensor {self.node} works with codes of degree {own}, the site file says {degree}: "
                "correct the site's degree, or store the parameter degree in every board"
            )

    def configure(
        self, bus: BusSource, codes: Sequence[int], parameters: Mapping[int, int | float] | None = None
    ) -> bool:
        """Make the sensor report these codes, now and after each of its resets; tells whether anything had to be set.

        Parameters
        ----------
        bus : BusSource
        codes : sequence of int
        parameters : mapping of int to int or float, optional
            Further parameters by id, unsigned or float by their type.

        Raises
        ------
        UserError
            If there are more codes than a sensor reports.
        SystemFailure
            If the sensor does not answer or refuses.
        """
        if len(codes) > LONGEST_CODE_LIST:
            raise UserError(
                f"the site has {len(codes)} beacons, a sensor reports {LONGEST_CODE_LIST} at most: split the site"
            )
        code_list = PARAMETERS["code_list"]
        wanted: list[tuple[int, int | float]] = [(code_list.identifier(i), code) for i, code in enumerate(codes)]
        wanted += [(PARAMETERS["code_count"].first, len(codes))]
        wanted += [
            (parameter, _single(value) if isinstance(value, float) else value)
            for parameter, value in (parameters or {}).items()
        ]
        changes = [(parameter, value) for parameter, value in wanted if self._ask(bus, parameter) != value]
        for parameter, value in changes:
            answer = self._ask(bus, parameter, value)
            if answer != value:
                raise SystemFailure(
                    f"{self.name}: sensor {self.node} keeps parameter {label_of(parameter)} at {answer} "
                    f"instead of {value}"
                )
        self._configured = bus, codes, parameters or {}
        return bool(changes)

    def reports(self, live: bool) -> Iterator[Report]:
        """Yield the reports of the sensor's cycles, to the end of a log or without end.

        Raises
        ------
        SystemFailure
            If a live link is lost or silent for `SILENCE_S`.
        UserError
            If a node speaks another protocol, or the first reports of a log are an anchor's that nobody asked for.
        """
        quiet_since = time.monotonic()
        while True:
            try:
                raw = self._receive_raw(QUIET_S)
            except SystemFailure:
                yield from self.assembler.flush()
                raise
            if raw is None and not live:
                yield from self.assembler.flush()
                return
            message = None if raw is None else self._decoded(raw)
            if message is not None and self.node is None and message.name == "EPOCH":
                self.node = message.node
            if raw is not None and message is not None and message.node == self.node:
                quiet_since = time.monotonic()
                yield from self._take(message, raw.timestamp)
            elif live:
                # Nothing, or the other nodes of a bus.
                quiet_s = time.monotonic() - quiet_since
                if quiet_s > QUIET_S:
                    yield from self.assembler.flush()
                if quiet_s > SILENCE_S:
                    raise SystemFailure(f"{self.name}: sensor {self.node} has been silent for {SILENCE_S:.0f} s")

    def _take(self, message: Message, arrival_s: float) -> Iterator[Report]:
        """Take a message of the sensor."""
        if message.name == "HEARTBEAT" and message.signals["role"] == ROLE_ANCHOR and not self._asked:
            raise UserError(
                f"{self.name}: node {message.node} is an anchor: give --node {message.node} to read it, "
                "or the number of the sensor"
            )
        yield from self.assembler.feed(message, arrival_s)
        if message.name == "COUNTER":
            self.counters[message.index] = int(message.signals["value"])
        elif message.name == "HEARTBEAT" and message.signals["state"] == STATE_STARTING:
            yield from self.assembler.end()
            self.counters.clear()
            if self._configured:
                self.configure(*self._configured)

    def parameter(self, bus: BusSource, number: int, value: int | float | None = None) -> int | float:
        """Read a parameter of the sensor, or set it, and return the sensor's answer.

        Raises
        ------
        SystemFailure
            If the sensor does not answer or refuses.
        """
        return self._ask(bus, number, value)

    def _ask(self, bus: BusSource, parameter: int, value: int | float | None = None) -> int | float:
        """Set a parameter, or read it, and return the sensor's answer."""
        assert self.node is not None
        if value is None:
            request = encode("PARAM_GET", {"reserved": 0}, node=self.node, index=parameter)
        else:
            signals: dict[str, float] = {"kind": Kind.UNSIGNED, "value_unsigned": value}
            if isinstance(value, float):
                signals = {"kind": Kind.FLOAT, "value_float": value}
            request = encode("PARAM_SET", signals, node=self.node, index=parameter)
        for _ in range(TRIES):
            bus.send(*request)
            deadline = time.monotonic() + ANSWER_S
            while (remaining := deadline - time.monotonic()) > 0.0:
                message = self._receive(remaining)
                if message is None or (message.name, message.node, message.index) != (
                    "PARAM_VALUE",
                    self.node,
                    parameter,
                ):
                    continue
                status = int(message.signals["status"])
                if status:
                    why = PARAM_STATUS.get(status, f"of status {status}")
                    given = "" if value is None else f" = {value}"
                    raise SystemFailure(
                        f"{self.name}: sensor {self.node} says that parameter {label_of(parameter)}{given} is "
                        f"{why}{_range_behind(parameter, status)}"
                    )
                if "value_float" in message.signals:
                    return float(message.signals["value_float"])
                return int(message.signals.get("value_unsigned", -1))
        raise SystemFailure(
            f"{self.name}: sensor {self.node} did not answer a request for parameter {label_of(parameter)} "
            f"in {TRIES} tries"
        )

    def _receive_raw(self, timeout_s: float) -> can.Message | None:
        raw = self._source.receive(timeout_s)
        if raw is not None and self._recorder is not None:
            self._recorder.write(raw)
        return raw

    def _receive(self, timeout_s: float) -> Message | None:
        raw = self._receive_raw(timeout_s)
        return None if raw is None else self._decoded(raw)

    def _decoded(self, raw: can.Message) -> Message | None:
        """Decode what a session uses; a heartbeat of another protocol ends it."""
        if Identifier.unpack(raw.arbitration_id).type not in USED_TYPES:
            return None
        try:
            message = decode(raw.arbitration_id, bytes(raw.data))
        except (DatabaseError, ValueError):
            message = None
        if message is None:
            self.undecodable += 1
        elif message.name == "HEARTBEAT":
            self._check_protocol(message)
        return message

    def _check_protocol(self, heartbeat: Message) -> None:
        theirs, ours = int(heartbeat.signals["protocol_hash"]), protocol_hash()
        if theirs == ours:
            return
        role = ROLES.get(int(heartbeat.signals["role"]), "unknown")
        version = ".".join(str(int(heartbeat.signals[f"version_{part}"])) for part in ("major", "minor", "patch"))
        raise UserError(
            f"{self.name}: node {heartbeat.node} ({role}, firmware {version}) speaks protocol {theirs:#010x} and this "
            f"host {ours:#010x}: flash it with the {role} firmware of this host's version (make flash ROLE={role})"
        )


def _range_behind(identifier: int, status: int) -> str:
    """Return the range in parentheses if that is what the sensor objects to."""
    found = find_id(identifier)
    return f" ({found[0].range_text})" if found is not None and status == OUT_OF_RANGE else ""


def _single(value: float) -> float:
    """Round to single precision, as a sensor keeps it."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])
