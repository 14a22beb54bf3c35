"""A sensor at the other end of a link: found by its heartbeat, made ready for the site, read cycle by cycle."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

import can

from goldfield.errors import SystemFailure, UserError, counted, option
from goldfield.link.blocks import BlockAssembler
from goldfield.link.budget import LINK_BITS, Choice
from goldfield.link.buses import BusSource, Source
from goldfield.link.chip_blocks import ChipBlockAssembler
from goldfield.link.heartbeat import ROLE_ANCHOR, ROLE_SENSOR, STATE_STARTING
from goldfield.link.line import Line
from goldfield.link.marks import is_mark, reads
from goldfield.link.reports import ON_SENSOR_POSE, SHORTEST_SILENCE_S, Assembler, Report
from goldfield.link.requests import set_request, value_of
from goldfield.sensor.anchors import AnchorWatch
from goldfield.sensor.backlog import LIMIT_S, Backlog
from goldfield.sensor.census import Census, Place, tells_of_motion
from goldfield.sensor.dialogue import BLOCKS, STREAM, STRONGEST, Dialogue, Parameters
from goldfield.sensor.finding import SILENCE_S, find_live, look_through
from goldfield.sensor.health import Health
from goldfield.sensor.keeping import Keeping
from goldfield.sensor.on_sensor import OnSensorTrack
from goldfield.sensor.receiver import Receiver, Recorder
from goldfield.sensor.sharing import Sharing
from goldfield.site import Site
from goldfield.types import Block, Pose
from goldfield_protocol.messages import INDEX_MASK, INDEX_SHIFT, TYPE_SHIFT, Message, encode, type_of
from goldfield_protocol.parameters import Kind

QUIET_S = 1.0
"""Silence of a live sensor after which its incomplete reports are handed out."""

STREAMED = ("BLOCK", "BLOCK_SUM", "CHIP")
"""Messages of which there are thousands a second, and which tell nothing of a board's health that others do not."""

POSE_TYPES = frozenset(type_of(name) for name in ON_SENSOR_POSE)
STREAMED_TYPES = frozenset(type_of(name) for name in STREAMED) | POSE_TYPES
"""Types of the messages that blocks and the sensor's own poses of them come in; those of a cycle have the index 0."""

Event = Report | Block | Pose
"""What a sensor reports: a cycle, a block of chips, or a pose that it computed of a block."""


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
        The sensor's node, which may be an anchor's; None: the only sensor there is, and no anchor.
    recorder : Recorder, optional
        Gets every message received.
    on_sensor : bool, optional
        Whether a cycle's report waits for the pose that the sensor computed itself.
    channel : str, optional
        The sensor's channel, where the source has several.
    blocks : bool, optional
        Whether blocks of chips are read, if they come.
    poses : bool, optional
        Whether the poses that the sensor computes itself of blocks are read, if they come.

    strongest : int, optional
        How many codes the sensor is to choose by their strength in each cycle; None: it reports the site's.

    Attributes
    ----------
    node : int or None
        None until a sensor was heard.
    strongest : int
        How many codes the sensor chooses, by its own latest word, else by what was asked; 0: it reports its list.
    live : bool
    receiver : Receiver
        What the session reads.
    assembler : Assembler
        Its counters tell what went wrong on the way.
    blocks : BlockAssembler or ChipBlockAssembler or None
        The same of the blocks.
    health : Health
        What every board on the link last said of itself.
    anchors : AnchorWatch
        What the anchors on the link see of the beacons.
    keeping : Keeping
        What the sensor was set to, and what others have changed of that.
    backlog : Backlog
        What was let go because this machine fell behind.
    unchosen : str
        The sensors of a recording which has none that the user chose; empty otherwise.
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
        channel: str | None = None,
        *,
        blocks: bool = False,
        poses: bool = False,
        strongest: int | None = None,
    ) -> None:
        self.name = name
        self.health = Health(site.cycle_s)
        self.anchors = AnchorWatch(site)
        self.receiver = Receiver(source, name, recorder, self._listen)
        self.assembler = Assembler(silence_s=max(SHORTEST_SILENCE_S, 8.0 * site.cycle_s), on_sensor=on_sensor)
        self._bus = source if isinstance(source, BusSource) else None
        self._chip_s = site.cycle_s / site.chips
        self.blocks: BlockAssembler | ChipBlockAssembler | None = None
        self._node: int | None = None
        if blocks:
            self.blocks = BlockAssembler(site.codes, site.chips, self._chip_s)
        self._sharing = Sharing(self.receiver, site, self._bus, blocks=blocks, strongest=strongest)
        self.poses = OnSensorTrack(site) if poses else None
        self.keeping = Keeping(self.receiver)
        self.backlog = Backlog()
        self.counters: dict[int, int] = {}
        self._site = site
        self._streamed_before: int | float = 1
        self._was_locked = False
        self.strongest = strongest or 0
        self._codes = None if strongest is not None and not on_sensor else site.codes
        self._asked = node is not None
        self._channel = channel
        self._parameters: dict[int, int | float] | None = None
        self._quiet_s = 0.0
        self._looked = False
        self._reads = True
        self._skipped = 0
        self.unchosen = ""
        self._reconnections = 0
        self.node = node

    @property
    def node(self) -> int | None:
        """The sensor's node; None until one was heard."""
        return self._node

    @node.setter
    def node(self, node: int | None) -> None:
        self._node = self.health.node = self.receiver.node = node

    @property
    def live(self) -> bool:
        """Whether the source is a sensor and not a recording."""
        return self._bus is not None

    @property
    def line(self) -> Line | None:
        """The link that a live sensor is read over; at the rate that is known once the sensor is found."""
        return None if self._bus is None else self._bus.line

    @property
    def block_parameters(self) -> Parameters:
        """What the sensor must have to send blocks of chips on the link that is read; empty if none are read."""
        return {} if self.choice is None else self.choice.parameters

    @property
    def choice(self) -> Choice | None:
        """What a live sensor is to send its blocks by, if they are read: sums or chips, or cycles only."""
        return self._sharing.choice

    @property
    def talks(self) -> bool:
        """Whether the sensor can be asked and set; a live one may be listened to only."""
        return self._bus is not None and not self._bus.listen_only

    @property
    def waits(self) -> bool:
        """Whether a link that is gone and a sensor that is silent are waited for."""
        return self._bus is not None and self._bus.reconnects

    @property
    def reconnections(self) -> int:
        """How often the link was opened again."""
        return 0 if self._bus is None else self._bus.reconnections

    @property
    def gone(self) -> str:
        """Why the link is gone, while it is waited for; else empty."""
        return "" if self._bus is None else self._bus.gone

    @property
    def dialogue(self) -> Dialogue:
        """The dialogue with the sensor; it must be live and found."""
        return self._dialogue()

    def _dialogue(self, *, keeps: bool = False) -> Dialogue:
        assert self._bus is not None
        assert self.node is not None
        return Dialogue(self.receiver, self._bus, self.node, keeps=keeps)

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
            If no sensor is heard, or it does not answer, as `Unheard`, or refuses.
        UserError
            If a node speaks another protocol, the sensor works with another degree than the site's, or the site has
            more beacons than a sensor reports.
        """
        if not self.talks:
            self.find()
            return False
        self.receiver.mark(None)
        self.find()
        self.dialogue.check_degree(self._site.degree)
        self._parameters = dict(parameters or {})
        chooses = self._sharing.fitting()
        if chooses is not None:
            self._parameters[STRONGEST] = chooses
        self._sharing.take(self._sharing.moving, self._node, self._parameters)
        if self.choice is not None:
            for parameter in (BLOCKS, STREAM):  # the link is slower, or fuller, than was known when they were chosen
                self._parameters.pop(parameter, None)
            self._parameters |= self.choice.parameters
        if STREAM in self._parameters:
            self._streamed_before = self.dialogue.ask(STREAM)
            self.blocks = ChipBlockAssembler(self._site.chips, self._chip_s, self.dialogue.calibration())
        changed = self._configure()
        self.receiver.mark(self.node)
        for node in self.health.boards:
            self._ask_who(node)
        return changed

    def end(self) -> None:
        """Let a live sensor stop to send blocks or chips on this link, if it did not before.

        No answer is awaited, but that of a sensor which is locked.
        """
        if self._bus is None or self.node is None:
            return
        wanted, bit, before = self._parameters or {}, LINK_BITS[self._bus.line.link], self.keeping.links_before
        with contextlib.suppress(SystemFailure):
            if wanted.get(BLOCKS) and before is not None and not before & bit:
                others = (self.keeping.links or 0) & ~bit
                self._leave(BLOCKS, others)
            if STREAM in wanted and not self._streamed_before:
                self._leave(STREAM, 0)

    def find(self) -> None:
        """Wait for a live sensor's heartbeat; where it is only listened to, its reports count too.

        Raises
        ------
        Unheard
            If nothing is heard for `SILENCE_S`, or no sensor within `PATIENCE_S`.
        UserError
            If there are several sensors to choose from, or the sensor speaks another protocol.
        """
        census = Census(self.node, self._channel, by_reports=not self.talks)
        alone = self._asked or self._bus is None or not (self._bus.shared or self._bus.listen_only)
        self._read_at(find_live(self.receiver, self.name, census, alone=alone))
        self._sharing.moving |= census.moving

    def reports(self) -> Iterator[Report]:
        """Yield the reports of the sensor's cycles, to the end of a log or without end; the errors are `events`'."""
        return (event for event in self.events() if isinstance(event, Report))

    def events(self) -> Iterator[Event]:
        """Yield what the sensor reports, as it becomes whole, to the end of a log or without end.

        Silence is what the link itself shows: time counts only while a message is waited for, and little of it each
        time, so that neither a pause of this process nor one of who takes the reports is taken for one of the sensor.

        Raises
        ------
        SystemFailure
            If a live link is lost or silent for `SILENCE_S`, and is not waited for.
        UserError
            If the sensor speaks another protocol, a log has several to choose from, or the first reports of a log are
            an anchor's that nobody asked for.
        """
        self._look_through()
        while True:
            begin_s = time.monotonic()
            try:
                raw = self.receiver.receive_raw(QUIET_S)
            except SystemFailure:
                yield from self.assembler.flush()
                raise
            step_s = min(time.monotonic() - begin_s, QUIET_S)
            if raw is None and not self.live:
                yield from self.assembler.flush()
                if self._skipped:
                    said = counted(self._skipped, "messages of the sensor were")
                    self.receiver.tell_once(f"{said} not read at the end, where it was being set")
                return
            if raw is not None and not self.live and is_mark(raw):
                self._reads, self._skipped = reads(raw), 0
                continue
            if raw is not None and self._lets_go(raw):
                continue
            message = None if raw is None else self.receiver.decoded(raw)
            if not self._reads:
                self._skipped += message is not None and message.node == self.node
                continue
            if message is not None and self.node is None and message.name == "EPOCH":
                self.node = message.node
            if message is not None and message.name == "HEARTBEAT":
                self._ask_who(message.node)
            if raw is not None and message is not None and message.node == self.node:
                self._heard_again()
                yield from self._take(message, raw.timestamp)
            elif self.live:
                # Nothing, or the other nodes of a bus.
                self._quiet_s += step_s
                if self._quiet_s > QUIET_S:
                    yield from self.assembler.flush()
                self._judge_silence()

    def _lets_go(self, raw: can.Message) -> bool:
        """Tell whether a message of blocks is let go, unread, because this machine has fallen behind."""
        if self._bus is None or self._bus.sender_waits:
            return False
        kind, index = raw.arbitration_id >> TYPE_SHIFT & 0x1F, raw.arbitration_id >> INDEX_SHIFT & INDEX_MASK
        if kind not in STREAMED_TYPES or (kind in POSE_TYPES and not index):
            return False
        if not self.backlog.lets_go(self.receiver.arrived_s):
            return False
        self._quiet_s = 0.0
        self.receiver.tell_once(
            f"this machine is too slow for so many poses: blocks that have waited for more than {LIMIT_S:g} s are left "
            "out"
        )
        return True

    def _judge_silence(self) -> None:
        """End the session if the sensor has been silent for too long, or say so if it is waited for."""
        if self._quiet_s <= SILENCE_S:
            return
        text = f"sensor {self.node} has been silent for {SILENCE_S:.0f} s"
        if not self.waits:
            raise SystemFailure(f"{self.name}: {text}")
        self.receiver.tell_once(f"{text}; waiting for it")

    def _heard_again(self) -> None:
        """Set the sensor again if it may have forgotten everything while the link was gone, or it was silent."""
        if self.reconnections != self._reconnections or self._quiet_s > SILENCE_S:
            if self.reconnections == self._reconnections:
                self.receiver.forget(f"sensor {self.node} has been silent for {SILENCE_S:.0f} s; waiting for it")
            self._reconnections = self.reconnections
            if self._parameters is not None:
                try:
                    self._configure_again()
                except SystemFailure as error:  # it is set when it says that it has started
                    self.receiver.tell_once(f"the sensor is back but could not be set: {error}")
        self._quiet_s = 0.0

    def _look_through(self) -> None:
        """Choose the sensor of a recording by its beginning; one that is only listened to is found already."""
        if self.live or self._looked:
            return
        self._looked = True
        census = Census(self.node, self._channel, by_reports=True, live=False)
        look_through(self.receiver, census)
        place = census.choose(self.name)
        if place is None:
            self.unchosen = census.unchosen
        else:
            self._read_at(place)
        self.receiver.channel = self.receiver.channel or self._channel

    def _read_at(self, place: Place) -> None:
        """Read the sensor at a place from now on."""
        self.node, self.receiver.channel = place.node, place.channel

    def _configure(self) -> bool:
        self.keeping.begin(self.node, self._codes, self._parameters, self.health.now_s)
        dialogue = self.dialogue
        try:
            return dialogue.configure(self._codes, self._parameters)
        finally:
            self._lock(dialogue)

    def _lock(self, dialogue: Dialogue) -> None:
        """Lock a sensor that was unlocked to be set."""
        self._was_locked |= dialogue.unlocked is not None
        dialogue.lock()

    def _leave(self, parameter: int, value: int) -> None:
        """Set the sensor at the end: only one that is locked is waited for."""
        assert self._bus is not None
        assert self.node is not None
        if not self._was_locked:
            self._bus.send(*set_request(self.node, parameter, value, Kind.UNSIGNED))
            return
        dialogue = self.dialogue
        dialogue.ask(parameter, value)
        dialogue.lock()

    def _configure_again(self) -> None:
        """Set the sensor in the middle of a run; a recording marks that what it reports meanwhile is not read."""
        self.receiver.mark(None)
        try:
            self._configure()
        finally:
            self.receiver.mark(self.node)

    def _listen(self, message: Message) -> None:
        moving = self._sharing.moving
        if message.node not in moving and self._node not in (None, message.node) and tells_of_motion(message):
            self._sharing.take({*moving, message.node}, self._node, self._parameters or {})
        if message.name in STREAMED:
            return
        self.keeping.take(message, self.health.now_s)
        if message.name == "PARAM_SET":
            return
        if (message.name, message.node, message.index) == ("PARAM_VALUE", self.node, STRONGEST):
            self.strongest = int(value_of(message.signals)) if not message.signals["status"] else self.strongest
        self.health.take(message)
        self.anchors.take(message)
        other = self.node not in (None, message.node) and not self._asked
        if other and message.name == "HEARTBEAT" and message.signals["role"] == ROLE_SENSOR:
            choice = option("node", message.node)
            self.receiver.tell_once(f"sensor {message.node} is there too: {self.node} is read; {choice} reads it")

    def _ask_who(self, node: int) -> None:
        """Ask a live board that drives a coil for what tells which beacon it is; its answers come among the others."""
        if self._bus is not None and self.talks:
            for parameter in self.health.boards[node].unasked:
                self._bus.send(*encode("PARAM_GET", {"reserved": 0}, node=node, index=parameter))

    def _take(self, message: Message, arrival_s: float) -> Iterator[Event]:
        """Take a message of the sensor."""
        if message.name == "HEARTBEAT" and message.signals["role"] == ROLE_ANCHOR and not self._asked:
            raise UserError(
                f"{self.name}: node {message.node} is an anchor: give {option('node', message.node)} to read it, "
                "or the number of the sensor"
            )
        if self.blocks is not None:
            yield from self.blocks.feed(message, arrival_s)
        if self.poses is not None and (pose := self.poses.feed(message)) is not None:
            yield pose
        yield from self.assembler.feed(message, arrival_s)
        if message.name == "COUNTER":
            self.counters[message.index] = int(message.signals["value"])
        elif message.name == "HEARTBEAT" and message.signals["state"] == STATE_STARTING:
            yield from self.assembler.end()
            if self.blocks is not None:
                self.blocks.restart()
            self.counters.clear()
            if self._parameters is not None:
                self._configure_again()
        if self._parameters is not None and self.keeping.disturbed:
            dialogue = self._dialogue(keeps=True)
            self.keeping.put_back(dialogue, self.health.now_s)
            self._lock(dialogue)
            self.receiver.put_back(dialogue.kept)
