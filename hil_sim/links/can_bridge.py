"""The host's CAN adapter: the rig's bus on a python-can bus that another process can open."""

from __future__ import annotations

import socket
import sys
from collections import deque

import can

from goldfield.errors import UserError
from goldfield.link.can_channel import open_channel
from hil_sim.rig import Frame, Rig

DEFAULT = "udp_multicast:239.74.163.2"
"""The channel of the first bench of a machine; `own_channel` gives each further one the next address."""
MOST_BENCHES = 100
ECHOES_KEPT = 4096


def own_channel() -> tuple[str, socket.socket | None]:
    """Return a CAN channel that no other bench of this machine has, and what keeps it until it is closed.

    Boards of two benches on one channel would hear each other. A channel is taken by a socket of its name in Linux's
    abstract name space, which the system forgets with the process and which reaches as far as the channel itself: one
    network name space. Other systems have no such names: there every bench gets `DEFAULT`.

    Raises
    ------
    UserError
        If `MOST_BENCHES` channels are taken.
    """
    if sys.platform != "linux":
        return DEFAULT, None
    stem, _, first = DEFAULT.rpartition(".")
    lock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    for number in range(int(first), int(first) + MOST_BENCHES):
        channel = f"{stem}.{number}"
        try:
            lock.bind(f"\0goldfield {channel}")
        except OSError:  # another bench has it
            continue
        return channel, lock
    lock.close()
    raise UserError(f"{MOST_BENCHES} benches run on this machine, each with its CAN channel: --can none does without")


class CanBridge:
    """Carries frames both ways.

    Parameters
    ----------
    channel : str, optional
        ``INTERFACE:CHANNEL`` of python-can, for example ``udp_multicast:239.74.163.2`` or ``socketcan:vcan0``; None:
        one that no other bench of this machine has taken in this way.

    Attributes
    ----------
    channel : str
    refused : int
        Frames that the other side sent and CAN 2.0 does not know.

    Raises
    ------
    UserError
        If there is no such bus.
    """

    def __init__(self, channel: str | None = None) -> None:
        self._lock: socket.socket | None = None
        if channel is None:
            channel, self._lock = own_channel()
        interface, _, name = channel.partition(":")
        if not interface or not name:
            raise UserError(f"'{channel}' is no CAN channel: write INTERFACE:CHANNEL, as in {DEFAULT}, or none")
        try:
            self._bus = open_channel(interface, name)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise UserError(f"cannot open the CAN channel {channel}: {error}; --can none does without") from error
        # A multicast group hands everything back to its sender; what we sent must not reach the boards again.
        self._echoes: deque[tuple[int, bytes]] | None = (
            deque(maxlen=ECHOES_KEPT) if interface == "udp_multicast" else None
        )
        self.channel = channel
        self.refused = 0

    def to_host(self, frames: list[Frame]) -> None:
        """Send the boards' frames to the other side.

        Raises
        ------
        UserError
            If the bus does not take them.
        """
        for frame in frames:
            if not frame.acknowledged:
                continue
            message = can.Message(
                timestamp=frame.time_s,
                arbitration_id=frame.identifier,
                is_extended_id=frame.extended,
                is_remote_frame=frame.remote,
                data=frame.data,
            )
            if self._echoes is not None:
                self._echoes.append((frame.identifier, frame.data))
            try:
                self._bus.send(message)
            except can.CanError as error:
                raise UserError(
                    f"cannot send on the CAN channel {self.channel}: {error}; --can none does without"
                ) from error

    def to_boards(self, rig: Rig) -> None:
        """Let the rig's adapter send what the other side has sent."""
        while (message := self._bus.recv(timeout=0.0)) is not None:
            data = bytes(message.data)
            if message.is_fd or message.is_error_frame or len(data) > 8:
                self.refused += 1
            elif not self._is_echo(message.arbitration_id, data):
                rig.can_write(
                    message.arbitration_id, data, extended=message.is_extended_id, remote=message.is_remote_frame
                )

    def _is_echo(self, identifier: int, data: bytes) -> bool:
        if self._echoes is None or (identifier, data) not in self._echoes:
            return False
        while self._echoes.popleft() != (identifier, data):
            pass  # frames come back in order: those before were lost
        return True

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()
        if self._lock is not None:
            self._lock.close()
