"""A live link whose messages are told to a roster, and which locks the boards that were unlocked over it."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress

import can

from goldfield.errors import SystemFailure
from goldfield.link.access import lock_request
from goldfield.link.access_key import AccessKey
from goldfield.link.buses import BusSource
from goldfield.link.line import Line
from goldfield.link.traffic import added
from goldfield.nodes.roster import Roster


class Tap(BusSource):
    """A live link whose messages, both ways, are told to a roster; otherwise it is that link.

    Parameters
    ----------
    link : BusSource
    key : AccessKey, optional
        What unlocks the boards that are locked.

    Attributes
    ----------
    unlocked : set of str
        Unique ids of the boards that were unlocked, which are locked again when the link is let go of.
    """

    def __init__(self, link: BusSource, key: AccessKey | None = None) -> None:
        self.name, self.key = link.name, key
        self.unlocked: set[str] = set()
        self.shared, self.listen_only, self.reconnects = link.shared, link.listen_only, link.reconnects
        self.virtual = link.virtual
        self.roster = Roster()
        self._link = link

    @property
    def traffic(self) -> Mapping[str, int]:
        """What the link dropped, by kind; what it handed on and is no message of a node is in the roster's count."""
        return self._link.traffic

    @property
    def line(self) -> Line:
        """What the link is, and at which rate."""
        return self._link.line

    def set_bit_rate(self, bit_rate: int) -> None:
        """Open the link anew at another rate; who was heard before is forgotten."""
        self.lock()
        self._link.set_bit_rate(bit_rate)
        self.roster.nodes.clear()

    @property
    def others(self) -> dict[str, int]:
        """All that came and is no message of a node, by the kinds of `goldfield.link.traffic`."""
        return added(self._link.traffic, self.roster.others)

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message, None when none came in time."""
        raw = self._link.receive(timeout_s)
        if raw is not None:
            self.roster.take(raw, time.monotonic())
        return raw

    def send(self, identifier: int, data: bytes) -> None:
        """Send a message."""
        self.roster.sent(identifier, data, time.monotonic())
        self._link.send(identifier, data)

    def close(self) -> None:
        """Let go of the link."""
        self.lock()
        self._link.close()

    def lock(self) -> None:
        """Lock the boards that were unlocked; no answer is awaited, as they lock themselves before long."""
        with suppress(SystemFailure):
            for unique_id in sorted(self.unlocked):
                self.send(*lock_request(unique_id))
        self.unlocked.clear()
