"""The one place where a python-can bus is opened by the name of its interface and channel."""

from __future__ import annotations

import json
import logging
import socket
import subprocess
import sys
from typing import Any

import can

from goldfield.link.line import VIRTUAL_OF_KERNEL
from goldfield.link.loopback_bus import INTERFACE

# What fails is raised and told in one line; python-can's own warnings are for programs that set logging up.
logging.getLogger("can").addHandler(logging.NullHandler())

MULTICAST_ALL = {socket.AF_INET: (socket.IPPROTO_IP, 49), socket.AF_INET6: (socket.IPPROTO_IPV6, 29)}
"""Level and number of Linux's options IP_MULTICAST_ALL and IPV6_MULTICAST_ALL, which Python does not name."""


VIRTUAL = (INTERFACE, "udp_multicast", "virtual")
"""Interfaces of CAN that have no bit rate: who is behind one has its own, and keeps it."""
IP_S = 5.0
"""Longest wait for the program ip, s."""


def open_channel(interface: str, channel: str, *, listen_only: bool = False, **options: Any) -> can.BusABC:
    """Open a python-can bus that hears its own channel and no other.

    python-can binds every ``udp_multicast`` bus to the same port of all addresses, and Linux then hands each of them
    the messages of every group that any program of the machine has joined: two benches with groups of their own would
    hear each other. This function asks the system for the bus's own group only.

    Parameters
    ----------
    interface, channel : str
        Names that python-can knows, for example ``udp_multicast`` and ``239.74.163.2``.
    listen_only : bool, optional
        An adapter that can be told to acknowledge no frame either, as one of slcan, is told so.
    **options
        Further arguments of `can.Bus`.

    Returns
    -------
    can.BusABC

    Raises
    ------
    Exception
        Whatever python-can or a vendor's interface raises if there is no such bus.
    """
    if listen_only and interface == "slcan":
        options["listen_only"] = True
    bus = can.Bus(interface=interface, channel=channel, **options)
    if interface == "udp_multicast" and sys.platform == "linux":
        family = socket.AF_INET6 if ":" in channel else socket.AF_INET
        with socket.fromfd(bus.fileno(), family, socket.SOCK_DGRAM) as own:
            own.setsockopt(*MULTICAST_ALL[family], 0)
        _drain(bus)
    return bus


def is_virtual(interface: str, channel: str) -> bool:
    """Tell whether a bus has no bit rate of its own."""
    return interface in VIRTUAL or (interface == "socketcan" and channel.startswith(VIRTUAL_OF_KERNEL))


def kernel_bit_rate(channel: str) -> int | None:
    """Return the bit rate of a CAN interface of the kernel, which ``ip link`` sets; None if it has or tells none."""
    command = ["ip", "-details", "-json", "link", "show", "dev", channel]
    try:
        told = subprocess.run(command, capture_output=True, text=True, timeout=IP_S, check=True).stdout
        return int(json.loads(told)[0]["linkinfo"]["info_data"]["bittiming"]["bitrate"])
    except (OSError, subprocess.SubprocessError, ValueError, LookupError, TypeError):
        return None  # no such program, no such interface, or a virtual one


def resynchronise(bus: can.BusABC) -> None:
    """Make a bus that could not read a line begin anew with the next; python-can's slcan would keep the line."""
    line = getattr(bus, "_buffer", None)
    if isinstance(line, bytearray):
        line.clear()


def _drain(bus: can.BusABC) -> None:
    """Throw away messages of other groups that came between the opening and the option, readable or not."""
    while True:
        try:
            if bus.recv(timeout=0.0) is None:
                return
        except can.CanOperationError as error:
            if isinstance(error.__cause__, OSError):
                raise
