"""A sensor on a link in virtual time: nothing waits, and the clock moves only while somebody listens."""

from __future__ import annotations

import heapq
import itertools
from dataclasses import astuple

import can

from goldfield.errors import SystemFailure
from goldfield.link.buses import BusSource
from goldfield.link.line import FASTEST, Link
from goldfield.sensor import dialogue, finding, samples, session
from goldfield_protocol import Identifier, decode, encode

ANSWER_S = 0.004
"""Virtual time that the sensor takes to answer."""
CLOCKED = (dialogue, finding, samples, session)
"""The modules that measure how long a sensor is waited for."""


def told_by(link, monkeypatch):
    """Let a link tell the time to whoever waits for a sensor."""
    for module in CLOCKED:
        monkeypatch.setattr(module, "time", link)


class VirtualLink(BusSource):
    """Takes the place of a `BusSource` and, by its `monotonic`, of the module `time`.

    Parameters
    ----------
    parameters : dict of int to int
        Values of the sensor by number.
    deaf : int
        How many requests the sensor leaves unanswered.
    """

    traffic = {}  # noqa: RUF012 - nothing is counted
    line = FASTEST[Link.SERIAL]

    def __init__(self, parameters=None, deaf=0):
        self.now_s = 1000.0
        self.parameters = parameters or {}
        self.requests = []
        self._deaf = deaf
        self._due = []
        self._order = itertools.count()

    def monotonic(self):
        return self.now_s

    def deliver(self, message, after_s=0.0):
        """Let a message arrive so long after now."""
        heapq.heappush(self._due, (self.now_s + after_s, next(self._order), message))

    def receive(self, timeout_s):
        if not self._due or self._due[0][0] > self.now_s + timeout_s:
            self.now_s += timeout_s
            return None
        time_s, _, (identifier, data) = heapq.heappop(self._due)
        self.now_s = max(self.now_s, time_s)
        return can.Message(timestamp=self.now_s, arbitration_id=identifier, data=data)

    def send(self, identifier, data):
        message, (_, number, node) = decode(identifier, data), astuple(Identifier.unpack(identifier))
        self.requests.append((message.name, number))
        if self._deaf:
            self._deaf -= 1
            return
        if message.name == "PARAM_SET":
            self.parameters[number] = int(message.signals["value_unsigned"])
        value = self.parameters.get(number, 0)
        own = {"kind": 2, "value_float": value} if isinstance(value, float) else {"kind": 0, "value_unsigned": value}
        self.deliver(encode("PARAM_VALUE", {"status": 0, **own}, node=node, index=number), ANSWER_S)

    def close(self):
        """Let go of nothing."""


def next_or_none(reports):
    """Return the next report, None if the link was lost or silent."""
    try:
        return next(reports)
    except SystemFailure:
        return None
