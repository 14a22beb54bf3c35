"""The headers of one node's reports, one after another: whether one clock and one count of cycles made them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from enum import Enum, auto

from goldfield.link.reports import distance

STREAMS = 4
"""Streams of headers that are remembered."""
RECENT = 8
"""Headers whose times are remembered; one that is later by more cycles is of a sensor that restarted."""
SAME_TIME_S = 1e-5
"""Times of one cycle that differ by less are one time: a header counts microseconds."""
SAME_STREAM_CYCLES = 0.25
"""A header continues a stream if its time is so near to where the stream would be."""


class Event(Enum):
    """What a header tells of itself beside those before it."""

    CONTINUED = auto()
    """The header goes on where those before it were, or came a second time."""
    RESTARTED = auto()
    """The time went back: the sensor has restarted."""
    RENUMBERED = auto()
    """The time goes on, the cycles' numbers jumped, or went back."""
    DOUBLED = auto()
    """The cycle had another time before, or time and number are back where they had been before they jumped."""


@dataclass
class Headers:
    """Takes the headers (`EPOCH`) of one node.

    The time of a header, less its cycle's number times the duration of a cycle, is nearly the same from header to
    header; here those that have it in common are called a stream. One sensor that follows one master has one stream. A
    restart, or a new count of the cycles, begins another, once. Two sensors of one number, or one that two masters
    number in turn, come back to a stream that was left.

    Attributes
    ----------
    cycle_s : float
        Duration of a cycle, s.
    """

    cycle_s: float
    _streams: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=STREAMS))
    """The latest cycle and time of each stream, the stream of the latest header first."""
    _recent: dict[int, float] = field(default_factory=dict)

    def take(self, cycle: int, time_s: float) -> Event:
        """Take the next header: the number of its cycle, and its time in s."""
        before = self._recent.get(cycle)
        self._recent[cycle] = time_s
        if len(self._recent) > RECENT:
            del self._recent[next(iter(self._recent))]
        doubled = before is not None and abs(time_s - before) > SAME_TIME_S
        for place, (own_cycle, own_time_s) in enumerate(self._streams):
            steps = distance(cycle, own_cycle)
            if abs(time_s - own_time_s - steps * self.cycle_s) < SAME_STREAM_CYCLES * self.cycle_s:
                if place == 0 and steps < -RECENT:
                    return self._begin(Event.RESTARTED, cycle, time_s)
                if place > 0 or steps > 0:
                    del self._streams[place]
                    self._streams.appendleft((cycle, time_s))
                return Event.DOUBLED if doubled or place > 0 else Event.CONTINUED
        latest_s = self._streams[0][1] if self._streams else None
        if latest_s is None:
            return self._begin(Event.CONTINUED, cycle, time_s)
        return self._begin(Event.RESTARTED if time_s <= latest_s else Event.RENUMBERED, cycle, time_s)

    def _begin(self, event: Event, cycle: int, time_s: float) -> Event:
        self._streams.appendleft((cycle, time_s))
        self._recent = {cycle: time_s}  # the numbers of before may come again
        return event
