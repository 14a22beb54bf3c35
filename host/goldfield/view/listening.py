"""How programs of the network are let in that are shown poses: by the live page, and by the feed of WebSockets.

asyncio takes whatever connects, until the system has no more files, and then tells of each with a traceback; the run
itself could not open its port again. So both let in `MOST` and turn away the rest before it has said anything.
"""

from __future__ import annotations

import socket

MOST = 100
"""Connections at once, of the 1,024 files that most systems let a program have; a browser takes up to seven."""
BACKLOG = 16
"""Connections that asyncio takes in one go, before the first of them may be turned away."""


def listening(address: str, port: int) -> socket.socket:
    """Return a socket that listens at an address of this machine, IPv4 or IPv6; port 0 is any that is free.

    Raises
    ------
    OSError
        If the address is none of this machine's, or the port is taken or not allowed.
    UnicodeError
        If the address is no name.
    """
    family, kind, _, _, place = socket.getaddrinfo(address, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0]
    found = socket.socket(family, kind)
    try:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind(place)
        found.listen(BACKLOG)
    except OSError:
        found.close()
        raise
    return found
