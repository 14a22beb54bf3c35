"""Reports of a sensor's code cycles, put together from messages that may be lost, repeated or late.

A cycle's messages carry its number's low four bits (`EPOCH` all twenty). Reports are handed out in the order of their
cycles, each once: when it is complete and its predecessors are out, when the second cycle after it has begun (so a
message may be late by a cycle), when the sender falls silent, or at the end. Cycles of which nothing arrived are
handed out empty, so that each cycle has a report.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from goldfield.types import FloatArray
from goldfield_protocol.messages import Message

CYCLE_MODULUS = 1 << 20
LOW_MODULUS = 16
WINDOW = 7
"""Farthest that a cycle may lie from the newest one to be told by its low four bits."""

FIELD_LIMIT_T = 524288e-10
OFFSET_LIMIT_T = 524288e-9
"""An axis at or beyond the negative limit was not measured (framing.md)."""

LONGEST_WAIT = 4096
"""Most messages that wait for a header behind a silence: a cycle of 64 codes has 71 with a pose."""

LONGEST_GAP = 1000
"""A cycle number that jumps further than so many cycles tells a restart, not a loss."""


SHORTEST_SILENCE_S = 0.8
"""Messages of short cycles come in bursts through an operating system; each burst has numbers of all twenty bits."""

ON_SENSOR_POSE = ("POSE_POSITION", "POSE_ATTITUDE", "POSE_QUALITY", "POSE_INTEGRITY")
"""What a sensor that computes its own pose sends after the fields of a cycle."""


@dataclass
class Report:
    """What arrived of one cycle.

    Attributes
    ----------
    cycle : int
        Number of the cycle, wraps at 2^20.
    time_s : float
        Middle of the cycle on the sensor's clock; NaN if the header was lost.
    chips, saturated : int or None
        Chips that were sampled, and that were saturated; None if the status was lost.
    announced : int or None
        How many fields the sensor sent.
    locked : bool or None
        Whether the chip clock follows the sync wire.
    offset_T : ndarray, shape (3,)
        Mean of the samples, NaN where lost or out of range.
    correlation_T : dict of int to ndarray, shape (3,)
        Plain correlation of each code; NaN where out of range.
    on_sensor_pose : dict of str to mapping
        Signals of the `ON_SENSOR_POSE` messages that arrived, if they are awaited.
    """

    cycle: int
    time_s: float = float("nan")
    chips: int | None = None
    saturated: int | None = None
    announced: int | None = None
    locked: bool | None = None
    offset_T: FloatArray | None = None
    correlation_T: dict[int, FloatArray] = field(default_factory=dict)
    on_sensor_pose: dict[str, Mapping[str, float]] = field(default_factory=dict)
    has_header: bool = False

    @property
    def complete(self) -> bool:
        """Whether no message of the fields is missing."""
        return (
            self.has_header
            and self.offset_T is not None
            and self.announced is not None
            and len(self.correlation_T) >= self.announced
        )

    def lost(self, expected_fields: int) -> int:
        """Return how many messages are missing, if the sensor sent so many fields (its own word counts more)."""
        fields = expected_fields if self.announced is None else self.announced
        head = (not self.has_header) + (self.announced is None) + (self.offset_T is None)
        return head + max(0, fields - len(self.correlation_T))


@dataclass
class Assembler:
    """Puts the messages of one sensor together; feed it every message of that node in order of arrival.

    Attributes
    ----------
    silence_s : float
        After such a time without a message the low bits of a cycle say nothing by themselves: eight cycles, but not
        less than `SHORTEST_SILENCE_S`. What comes then waits for the next header, whose number and time on the
        sensor's own clock tell whether the sensor was silent, or its messages only came late.
    on_sensor : bool
        Whether the sensor's own poses are awaited too; else they are ignored.
    repeated : int
        Messages that had been received already.
    late : int
        Messages of cycles that were handed out already.
    orphans : int
        Messages before the first header, or between a silence and the next one: nobody can tell their cycle.
    missed_cycles : int
        Cycles lost in gaps that were too long to hand out an empty report for each.
    restarts : int
        Times that the cycle number jumped: the sensor or the sync master restarted.
    """

    silence_s: float = SHORTEST_SILENCE_S
    on_sensor: bool = False
    repeated: int = 0
    late: int = 0
    orphans: int = 0
    missed_cycles: int = 0
    restarts: int = 0
    _open: dict[int, Report] = field(default_factory=dict)
    _newest: int | None = None
    _next: int | None = None
    _header_s: float = float("-inf")
    """Time of the latest header, on the sensor's clock."""
    _waiting: list[Message] | None = None
    """What came after a silence, and before the next header; None: there was no silence."""
    _last_time: float = float("-inf")

    def feed(self, message: Message, arrival_s: float) -> Iterator[Report]:
        """Yield the reports that this message completes or closes.

        Parameters
        ----------
        message : Message
            Others than those of a cycle are ignored.
        arrival_s : float
            Time of arrival, on any clock that does not run backwards.
        """
        awaited = ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", "FIELD", *(ON_SENSOR_POSE if self.on_sensor else ()))
        if message.name not in awaited or (message.name in ON_SENSOR_POSE and message.index):
            return  # a pose with an index is that of a block
        if arrival_s - self._last_time > self.silence_s and self._newest is not None:
            self._waiting = []
        self._last_time = arrival_s
        if self._waiting is not None:
            if message.name != "EPOCH" and len(self._waiting) < LONGEST_WAIT:
                self._waiting.append(message)
                return
            yield from self._end_silence(message)
        yield from self._sort_in(message)

    def _end_silence(self, message: Message) -> Iterator[Report]:
        """Judge a silence by the message behind it, and take or give up what came in between."""
        waiting, self._waiting = self._waiting or [], None
        assert self._newest is not None
        if message.name == "EPOCH" and message.signals["time"] >= self._header_s:
            ahead = distance(int(message.signals["cycle"]), self._newest)
            if ahead in (0, 1):  # the sensor went on: only the way to here was held up
                for late in waiting:
                    yield from self._sort_in(late)
                return
            if 1 < ahead <= WINDOW:
                self.orphans += len(waiting)
                return
        self.orphans += len(waiting)
        yield from self.end()

    def _sort_in(self, message: Message) -> Iterator[Report]:
        if message.name == "EPOCH":
            cycle = int(message.signals["cycle"])
            self._header_s = message.signals["time"]
            if self._newest is None or abs(distance(cycle, self._newest)) > WINDOW:
                yield from self.flush()
                self._begin(cycle)
        elif self._newest is None:
            self.orphans += 1
            return
        else:
            cycle = self._cycle_of(int(message.signals["cycle_low"]))
        assert self._newest is not None
        if distance(cycle, self._expected) < 0:
            self.late += 1
            return
        if distance(cycle, self._newest) > 0:
            self._newest = cycle
        report = self._open.setdefault(cycle, Report(cycle))
        self.repeated += not _enter(report, message)
        yield from self._ready()

    def flush(self) -> Iterator[Report]:
        """Yield all open reports as they are; what still waits for a header is given up."""
        if self._waiting:
            self.orphans += len(self._waiting)
            self._waiting = []
        if self._newest is not None:
            yield from self._hand_out(until=(self._newest + 1) % CYCLE_MODULUS)

    def _begin(self, cycle: int) -> None:
        gap = 0 if self._next is None else distance(cycle, self._next)
        if 0 <= gap <= LONGEST_GAP:
            self.missed_cycles += gap
        else:
            self.restarts += 1
        self._newest = self._next = cycle

    def end(self) -> Iterator[Report]:
        """Yield all open reports; what follows may be of any cycle (the sensor restarts, or was silent)."""
        yield from self.flush()
        self._newest = None
        self._waiting = None

    def _cycle_of(self, low: int) -> int:
        assert self._newest is not None
        ahead = (low - self._newest) % LOW_MODULUS
        return (self._newest + (ahead if ahead <= LOW_MODULUS // 2 else ahead - LOW_MODULUS)) % CYCLE_MODULUS

    def _ready(self) -> Iterator[Report]:
        assert self._newest is not None
        yield from self._hand_out(until=(self._newest - 1) % CYCLE_MODULUS)
        own = len(ON_SENSOR_POSE) if self.on_sensor else 0
        while (
            (report := self._open.get(self._expected)) is not None
            and report.complete
            and len(report.on_sensor_pose) >= own
        ):
            yield self._pop()

    def _hand_out(self, until: int) -> Iterator[Report]:
        while distance(until, self._expected) > 0:
            yield self._pop()

    def _pop(self) -> Report:
        cycle = self._expected
        self._next = (cycle + 1) % CYCLE_MODULUS
        return self._open.pop(cycle, None) or Report(cycle)

    @property
    def _expected(self) -> int:
        assert self._next is not None
        return self._next


def distance(cycle: int, reference: int) -> int:
    """Return the signed distance of cycle numbers that wrap."""
    half = CYCLE_MODULUS // 2
    return (cycle - reference + half) % CYCLE_MODULUS - half


def _enter(report: Report, message: Message) -> bool:
    """Enter a message into its report; False if it was there already: the first one counts."""
    signals = message.signals
    if message.name == "EPOCH":
        if report.has_header:
            return False
        report.has_header = True
        report.time_s = signals["time"]
    elif message.name == "EPOCH_STATUS":
        if report.announced is not None:
            return False
        report.announced = int(signals["fields"])
        report.chips = int(signals["chips"])
        report.saturated = int(signals["saturated"])
        report.locked = bool(signals["locked"])
    elif message.name == "EPOCH_OFFSET":
        if report.offset_T is not None:
            return False
        report.offset_T = vector(message, OFFSET_LIMIT_T)
    elif message.name in ON_SENSOR_POSE:
        if message.name in report.on_sensor_pose:
            return False
        report.on_sensor_pose[message.name] = signals
    else:
        if message.index in report.correlation_T:
            return False
        report.correlation_T[message.index] = vector(message, FIELD_LIMIT_T)
    return True


def vector(message: Message, limit_T: float) -> FloatArray:
    """Return x, y and z of a message; NaN on an axis at or beyond the negative limit."""
    result = np.array([message.signals[axis] for axis in "xyz"])
    result[result <= -limit_T * (1.0 - 1e-7)] = np.nan
    return result
