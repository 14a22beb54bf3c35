"""A CAN bus among the programs of one machine as a python-can interface named ``goldfield_loopback``.

A frame is one datagram to a multicast group on the loopback interface, with time to live 0: it leaves neither the
machine nor its loopback interface, which is all the network that there must be. Any python-can program of the machine
takes part by the names of interface and channel alone.
"""

from __future__ import annotations

import errno
import select
import socket
import struct
import sys
import time
from typing import Any

import can

INTERFACE = "goldfield_loopback"
LOOPBACK = "127.0.0.1"
IP_MULTICAST_ALL = 49
"""Linux's option, which Python does not name: 0 keeps datagrams away that came for a group by another interface."""

FRAME = struct.Struct("<IB3x8s")
"""A frame in a datagram: Linux's ``struct can_frame`` in little-endian order."""
EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
"""Flags beside the identifier, as in Linux's ``can.h``."""
MOST_IN_A_ROW = 256
"""Datagrams without a frame that one call takes: whoever floods the channel must not hold its reader for ever."""
PADDING = slice(5, 8)
"""Bytes of a datagram that are zero."""


class LoopbackBus(can.BusABC):
    """A channel of the loopback interface.

    Parameters
    ----------
    channel : str, optional
        ``GROUP:PORT``, an IPv4 multicast group and a UDP port, as in ``239.74.200.17:51217``; None: one that no other
        program holds, of which the system chooses the port and the port the group.
    holds : bool
        Hold the channel, as a bench does: no second program of the machine can hold the same. Who does not hold a
        channel takes part in it.

    Attributes
    ----------
    channel : str
    bad_frames : int
        Datagrams that were no frame.

    Raises
    ------
    can.CanInitializationError
        If there is no such channel, another program holds it, or the machine has no loopback interface.

    Notes
    -----
    Frames are of CAN 2.0. A datagram that is none costs nothing but a count. Nobody gets his own frames back.
    """

    def __init__(self, channel: str | None = None, holds: bool = False, **kwargs: Any) -> None:
        self._is_shutdown = True  # until everything is open, there is nothing that python-can could miss closing
        self._group = ("", 0) if channel is None else _parse(channel)
        self._out, self._in = _socket(), _socket()
        try:
            self._open(holds)
        except OSError as error:
            self._close()
            raise can.CanInitializationError(_why(self._group, error)) from error
        self.channel = f"{self._group[0]}:{self._group[1]}"
        self.channel_info = f"{INTERFACE} {self.channel}"
        self.bad_frames = 0
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel=self.channel, **kwargs)

    def _open(self, holds: bool) -> None:
        # The address that is sent from is this program's alone: it tells its own frames from those of others.
        self._out.bind((LOOPBACK, self._group[1] if holds else 0))
        self._own = self._out.getsockname()
        if not self._group[0]:
            port = self._own[1]
            self._group = (f"239.74.{port >> 8}.{port & 255}", port)
        group = socket.inet_aton(self._group[0])
        self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(LOOPBACK))
        self._out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        self._in.setblocking(False)
        self._in.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if sys.platform == "linux":
            self._in.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)
        self._in.bind(self._group)  # and not to all addresses: else it would get whatever comes to this port
        self._in.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group + socket.inet_aton(LOOPBACK))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; `can.CanOperationError` if it is none of CAN 2.0, or the system does not take it."""
        if msg.is_fd:
            raise can.CanOperationError("the loopback channel carries frames of CAN 2.0 only")
        flags = EXTENDED * msg.is_extended_id | REMOTE * msg.is_remote_frame | ERROR * msg.is_error_frame
        try:
            self._out.sendto(FRAME.pack(msg.arbitration_id | flags, msg.dlc, bytes(msg.data)), self._group)
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: {error.strerror}") from error

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = None if timeout is None else time.monotonic() + timeout
        for _ in range(MOST_IN_A_ROW):
            datagram = self._receive()
            if datagram is None:
                left_s = None if deadline is None else max(0.0, deadline - time.monotonic())
                if not select.select([self._in], [], [], left_s)[0]:
                    break
            elif (message := _unpack(datagram, self.channel)) is not None:
                return message, False
            else:
                self.bad_frames += 1
        return None, False

    def _receive(self) -> bytes | None:
        """Return the next datagram of another program; None if none waits."""
        try:
            while True:
                datagram, sender = self._in.recvfrom(FRAME.size + 1)
                if sender != self._own:
                    return datagram
        except BlockingIOError:
            return None
        except OSError as error:
            raise can.CanOperationError(f"{self.channel_info}: {error.strerror}") from error

    def fileno(self) -> int:
        """Return the file descriptor that is ready when frames wait."""
        return self._in.fileno()

    def shutdown(self) -> None:
        """Leave the channel."""
        super().shutdown()
        self._close()

    def _close(self) -> None:
        self._in.close()
        self._out.close()


def _socket() -> socket.socket:
    return socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def _parse(channel: str) -> tuple[str, int]:
    """Return group and port of a channel."""
    group, _, port = channel.rpartition(":")
    try:
        first = socket.inet_pton(socket.AF_INET, group)[0]
    except OSError:
        first = 0
    if first >> 4 != 14 or not (port.isascii() and port.isdigit() and 1 <= int(port[:6]) <= 65535):
        raise can.CanInitializationError(
            f"'{channel}' is no channel of {INTERFACE}: write GROUP:PORT, as in 239.74.200.17:51217"
        )
    return group, int(port)


def _why(channel: tuple[str, int], error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return f"another bench or program holds port {channel[1]}"
    if error.errno in (errno.ENODEV, errno.EADDRNOTAVAIL, errno.ENETUNREACH):
        return "this machine has no loopback interface that is up (ip link set lo up)"
    return str(error.strerror)


def _unpack(datagram: bytes, channel: str) -> can.Message | None:
    """Return the frame of a datagram; None if it holds none, or one that no sender would have written so."""
    if len(datagram) != FRAME.size or any(datagram[PADDING]):
        return None
    word, length, data = FRAME.unpack(datagram)
    extended, remote, error = bool(word & EXTENDED), bool(word & REMOTE), bool(word & ERROR)
    identifier = word & (ERROR - 1)
    known = 0 if remote else length
    if length > 8 or any(data[known:]) or (remote and error) or (not extended and not error and identifier >= 1 << 11):
        return None
    return can.Message(
        timestamp=time.time(),
        arbitration_id=identifier,
        is_extended_id=extended,
        is_remote_frame=remote,
        is_error_frame=error,
        dlc=length,
        data=data[:known],
        channel=channel,
    )
