"""A free port for those who must know it before somebody listens there, or let go of it and take it again."""

from __future__ import annotations

import itertools
import os
import socket
from pathlib import Path

LOWEST = 10_000
RANGE = Path("/proc/sys/net/ipv4/ip_local_port_range")
_tried = itertools.count(os.getpid())  # programs that run at once begin at different ones


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Return a port of 127.0.0.1 that is free, and that the system gives to nobody who does not ask for it by number.

    It could give a port of its own range to another program meanwhile, and even to the connection that is tried there,
    which then reaches itself.
    """
    end = int(RANGE.read_text().split()[0]) if RANGE.exists() else 32_768
    for number in itertools.islice(_tried, end - LOWEST):
        port = LOWEST + number * 101 % (end - LOWEST)
        with socket.socket(type=kind) as other:
            other.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                other.bind(("127.0.0.1", port))
            except OSError:
                continue
        return port
    raise AssertionError(f"all ports from {LOWEST} to {end} are taken")
