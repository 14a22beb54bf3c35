"""Poses as datagrams: each a line of JSON, sent to one host, which may listen or not."""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Any

from goldfield.feeds.address import Address
from goldfield.feeds.feed import Feed, Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.files.inputs import reason_of


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return the feed that sends to an address; `UserError` if its host has no address."""
    return UdpFeed(Datagrams(address), setting)


class Datagrams:
    """Sends datagrams to one address and never waits.

    Parameters
    ----------
    address : Address
        A host, or an address for broadcast or multicast.

    Attributes
    ----------
    dropped : int
        Datagrams that this machine did not send, since its queue was full or no way led there.

    Raises
    ------
    UserError
        If the host has no address.
    """

    def __init__(self, address: Address) -> None:
        self.dropped = 0
        try:
            found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:
            raise address.wrong(f"the host is not known: {reason_of(error)}") from None
        family, kind, _, _, place = found[0]
        self._place: Any = place
        self._socket = socket.socket(family, kind)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)

    def send(self, data: bytes) -> None:
        """Send a datagram; that nobody listens is no error."""
        try:
            self._socket.sendto(data, self._place)
        except OSError:
            self.dropped += 1

    def close(self) -> None:
        """Close the socket."""
        with suppress(OSError):
            self._socket.close()


class UdpFeed:
    """Sends each pose as a line of JSON.

    Parameters
    ----------
    datagrams : Datagrams
    setting : Setting
    """

    whole = False

    def __init__(self, datagrams: Datagrams, setting: Setting) -> None:
        self._datagrams = datagrams
        self._clock = setting.clock

    @property
    def dropped(self) -> int:
        """Datagrams that were not sent."""
        return self._datagrams.dropped

    def write(self, stamped: StampedPose, /) -> None:
        """Send a pose."""
        self._datagrams.send(f"{stamped.json(self._clock())}\n".encode())

    def close(self) -> None:
        """Close the socket."""
        self._datagrams.close()
