"""A sensor at the other end of a link: found by its heartbeat, made ready for the site, read cycle by cycle."""

from __future__ import annotations

import time
from collections.abc import Iterator

from goldfield.errors import SystemFailure, UserError, option
from goldfield.link.buses import BusSource, Source
from goldfield.link.reports import SHORTEST_SILENCE_S, Assembler, Report
from goldfield.sensor.anchors import AnchorWatch
from goldfield.sensor.dialogue import Dialogue, Parameters
from goldfield.sensor.health import Health
from goldfield.sensor.receiver import ROLES, Receiver, Recorder
from goldfield.site import Site
from goldfield_protocol.messages import Message, encode

ROLE_SENSOR, ROLE_ANCHOR = 1, 3
STATE_STARTING = 0

QUIET_S = 1.0
"""Silence of a live sensor after which its incomplete reports are handed out."""
SILENCE_S = 10.0
"""Silence of a live link, or of the sensor that is read, which ends the session."""
PATIENCE_S = 30.0
"""Longest wait for a heartbeat of the sensor while others are heard. Heartbeats come once a second, but simulated
boards may run slower than the wall clock."""


class Session:
    """Reads one sensor, and on a bus talks to it.

    Parameters
    ----------
    source : Source
        A `BusSource` is live: the sensor is there and answers.
    name : str
        The link's name, for error messages.
    site : Site
    node : int, optional
        The sensor's node, which may be an anchor's; None: the first sensor that is heard, and no anchor.
    recorder : Recorder, optional
        Gets every message received.
    on_sensor : bool, optional
        Whether a cycle's report waits for the pose that the sensor computed itself.

    Attributes
    ----------
    node : int or None
        None until a sensor was heard.
    live : bool
    receiver : Receiver
        What the session reads.
    assembler : Assembler
        Its counters tell what went wrong on the way.
    health : Health
        What every board on the link last said of itself.
    anchors : AnchorWatch
        What the anchors on the link see of the beacons.
    counters : dict of int to int
        The sensor's own error counters since its reset, those that it told; `counter_name` names them.
    """

    def __init__(
        self,
        source: Source,
        name: str,
        site: Site,
        node: int | None = None,
        recorder: Recorder | None = None,
        on_sensor: bool = False,
    ) -> None:
        self.name = name
        self.node = node
        self.health = Health(site.cycle_s)
        self.health.node = node
        self.anchors = AnchorWatch(site)
        self.receiver = Receiver(source, name, recorder, self._listen)
        self.assembler = Assembler(silence_s=max(SHORTEST_SILENCE_S, 8.0 * site.cycle_s), on_sensor=on_sensor)
        self.counters: dict[int, int] = {}
        self._bus = source if isinstance(source, BusSource) else None
        self._site = site
        self._asked = node is not None
        self._parameters: Parameters | None = None

    @property
    def live(self) -> bool:
        """Whether the source is a sensor and not a recording."""
        return self._bus is not None

    @property
    def dialogue(self) -> Dialogue:
        """The dialogue with the sensor; it must be live and found."""
        assert self._bus is not None
        assert self.node is not None
        return Dialogue(self.receiver, self._bus, self.node)

    def start(self, parameters: Parameters | None = None) -> bool:
        """Find a live sensor and make it report the site's codes, now and after each of its resets.

        Parameters
        ----------
        parameters : mapping of int to int or float, optional
            Further parameters that it must have.

        Returns
        -------
        bool
            Whether any parameter had to be set.

        Raises
        ------
        SystemFailure
            If no sensor is heard, or it does not answer or refuses.
        UserError
            If a node speaks another protocol, the sensor works with another degree than the site's, or the site has
            more beacons than a sensor reports.
        """
        self.find()
        self.dialogue.check_degree(self._site.degree)
        self._parameters = parameters or {}
        changed = self._configure()
        for node in self.health.boards:
            self._ask_who(node)
        return changed

    def find(self) -> None:
        """Wait for a live sensor's heartbeat.

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
            message = self.receiver.receive(min(SILENCE_S, 0.5))
            if message is None:
                continue
            heard_last = time.monotonic()
            role = message.signals["role"] if message.name == "HEARTBEAT" else None
            if role == ROLE_SENSOR or (role == ROLE_ANCHOR and self._asked):
                if self.node in (None, message.node):
                    self.node = self.health.node = message.node
                    return
                heard.add(f"{ROLES[int(role)]} {message.node}")
            elif role == ROLE_ANCHOR:
                heard.add(f"anchor {message.node} (to read it, give {option('node', message.node)})")
            else:
                heard.add(f"{message.name} of node {message.node}")
        wanted = "a sensor" if self.node is None else f"sensor {self.node}"
        bad_frames = self.receiver.bad_frames
        if heard:
            what = f"heard only {', '.join(sorted(heard)[:4])}"
        elif bad_frames:
            what = f"heard only {bad_frames} corrupt frames: check the wiring and that nothing else uses the link"
        else:
            what = "heard nothing: check the power, the cable and the port"
        waited_s = time.monotonic() - begin
        raise SystemFailure(f"{self.name}: no heartbeat of {wanted} in {waited_s:.0f} s; {what}")

    def reports(self) -> Iterator[Report]:
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
                raw = self.receiver.receive_raw(QUIET_S)
            except SystemFailure:
                yield from self.assembler.flush()
                raise
            if raw is None and not self.live:
                yield from self.assembler.flush()
                return
            message = None if raw is None else self.receiver.decoded(raw)
            if message is not None and self.node is None and message.name == "EPOCH":
                self.node = message.node
            if message is not None and message.name == "HEARTBEAT":
                self._ask_who(message.node)
            if raw is not None and message is not None and message.node == self.node:
                quiet_since = time.monotonic()
                yield from self._take(message, raw.timestamp)
            elif self.live:
                # Nothing, or the other nodes of a bus.
                quiet_s = time.monotonic() - quiet_since
                if quiet_s > QUIET_S:
                    yield from self.assembler.flush()
                if quiet_s > SILENCE_S:
                    raise SystemFailure(f"{self.name}: sensor {self.node} has been silent for {SILENCE_S:.0f} s")

    def _configure(self) -> bool:
        return self.dialogue.configure(self._site.codes, self._parameters)

    def _listen(self, message: Message) -> None:
        self.health.take(message)
        self.anchors.take(message)

    def _ask_who(self, node: int) -> None:
        """Ask a live board that drives a coil for what tells which beacon it is; its answers come among the others."""
        if self._bus is not None:
            for parameter in self.health.boards[node].unasked:
                self._bus.send(*encode("PARAM_GET", {"reserved": 0}, node=node, index=parameter))

    def _take(self, message: Message, arrival_s: float) -> Iterator[Report]:
        """Take a message of the sensor."""
        if message.name == "HEARTBEAT" and message.signals["role"] == ROLE_ANCHOR and not self._asked:
            raise UserError(
                f"{self.name}: node {message.node} is an anchor: give {option('node', message.node)} to read it, "
                "or the number of the sensor"
            )
        yield from self.assembler.feed(message, arrival_s)
        if message.name == "COUNTER":
            self.counters[message.index] = int(message.signals["value"])
        elif message.name == "HEARTBEAT" and message.signals["state"] == STATE_STARTING:
            yield from self.assembler.end()
            self.counters.clear()
            if self._parameters is not None:
                self._configure()
