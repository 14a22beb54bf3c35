"""Poses as datagrams, sent to one host, which may listen or not: each a line of JSON, or what another format makes."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from goldfield.errors import tell
from goldfield.feeds.address import Address
from goldfield.feeds.feed import Clock, Feed, Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.files.inputs import reason_of


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return the feed that sends lines of JSON to an address; `UserError` if its host has no address."""
    return DatagramFeed(address, setting.clock, _line)


class DatagramFeed:
    """Sends a datagram for each pose to one address, and never waits.

    Parameters
    ----------
    address : Address
        A host, or an address for broadcast or multicast.
    clock : callable
    content : callable
        Returns the datagram of a pose at a time by the wall clock, s since 1970.

    Attributes
    ----------
    dropped : int
        Datagrams that this machine did not send, since its queue was full or no way led there.

    Raises
    ------
    UserError
        If the host has no address.
    """

    whole = False

    def __init__(self, address: Address, clock: Clock, content: Callable[[StampedPose, float], bytes]) -> None:
        self.dropped = 0
        self._clock, self._content = clock, content
        self._url, self._told = address.url, ""
        try:
            found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            raise address.wrong(f"the host is not known: {reason_of(error)}") from None
        family, kind, _, _, place = found[0]
        self._place: Any = place
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def write(self, stamped: StampedPose, /) -> None:
        """Send a pose; that nobody listens is no error. What hinders it is told once in a row."""
        try:
            self._socket.sendto(self._content(stamped, self._clock()), self._place)
            self._told = ""
        except BlockingIOError:  # the queue is full: the next one may have room
            self.dropped += 1
        except OSError as error:
            self.dropped += 1
            reason = reason_of(error)
            if reason != self._told:
                self._told = reason
                tell(f"{self._url}: a pose is not sent: {reason}; the next ones are tried")

    def close(self) -> None:
        """Close the socket."""
        with suppress(OSError):
            self._socket.close()


def _line(stamped: StampedPose, now_s: float) -> bytes:
    return f"{stamped.json(now_s)}\n".encode()
