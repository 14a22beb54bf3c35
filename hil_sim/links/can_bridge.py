"""The host's CAN adapter: the rig's bus on a python-can bus that another process can open."""

from __future__ import annotations

import errno
from collections import deque

import can

from goldfield.errors import SystemFailure, UserError
from goldfield.link.can_channel import open_channel
from goldfield.link.loopback_bus import INTERFACE, LoopbackBus
from hil_sim.rig import Frame, Rig

OWN = "own"
"""Asks for a channel of the loopback interface that no other bench has."""
QUEUE = 64
"""Frames that the adapter holds until the rig's bus is free; the others wait in the channel."""
MOST_BAD = 256
"""Frames that cannot be passed on, of those that one call takes: who floods the channel must not hold the bench."""
ECHOES_KEPT = 4096


class CanBridge:
    """Carries frames both ways.

    Parameters
    ----------
    channel : str
        `OWN`, or ``INTERFACE:CHANNEL`` of python-can, for example ``socketcan:vcan0``.

    Attributes
    ----------
    channel : str
        ``INTERFACE:CHANNEL``.
    taken : int
        Frames from outside that went to the rig's bus.
    lost : int
        Frames of the rig's bus for which the channel had no room.

    Raises
    ------
    UserError
        If there is no such bus, or another bench holds the channel.
    """

    def __init__(self, channel: str) -> None:
        interface, _, name = (INTERFACE, "", "") if channel == OWN else channel.partition(":")
        if channel != OWN and not (interface and name):
            raise UserError(f"--can {channel}: is no CAN channel: write own, INTERFACE:CHANNEL or none")
        try:
            self._bus = _open(interface, name)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise UserError(f"--can {channel}: cannot be opened: {error}; --can none does without") from error
        self.channel = f"{INTERFACE}:{self._bus.channel}" if isinstance(self._bus, LoopbackBus) else channel
        # A group of python-can's hands everything back to its sender; what we sent must not reach the boards again.
        self._echoes: deque[tuple[int, bytes]] | None = (
            deque(maxlen=ECHOES_KEPT) if interface == "udp_multicast" else None
        )
        self._waiting = self._refused = self.taken = self.lost = 0

    @property
    def refused(self) -> int:
        """What came from outside and is no frame of CAN 2.0: other datagrams, frames of CAN FD, error frames."""
        return self._refused + int(getattr(self._bus, "bad_frames", 0))

    def to_host(self, rig: Rig) -> None:
        """Send the boards' frames to the other side.

        Raises
        ------
        SystemFailure
            If the channel is gone.
        """
        for frame in rig.can_read():
            if frame.board == rig.host_node:
                self._waiting -= 1  # it came from the other side, where everybody has heard it
            elif frame.acknowledged:
                self._send(frame)

    def _send(self, frame: Frame) -> None:
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
            if error.error_code not in (errno.ENOBUFS, errno.EAGAIN):
                raise SystemFailure(f"the CAN channel {self.channel} is gone: {error}") from error
            self.lost += 1

    def to_boards(self, rig: Rig) -> None:
        """Let the rig's adapter send what the other side has sent, as far as it has room for it."""
        bad = 0
        while self._waiting < QUEUE and bad < MOST_BAD:
            try:
                message = self._bus.recv(timeout=0.0)
            except can.CanError:  # a datagram that is no frame; a channel that is gone is noticed when it is sent to
                self._refused += 1
                bad += 1
                continue
            if message is None:
                return
            data = bytes(message.data)
            if message.is_fd or message.is_error_frame or len(data) > 8:
                self._refused += 1
                bad += 1
            elif not self._is_echo(message.arbitration_id, data):
                rig.can_write(
                    message.arbitration_id, data, extended=message.is_extended_id, remote=message.is_remote_frame
                )
                self._waiting += 1
                self.taken += 1

    def _is_echo(self, identifier: int, data: bytes) -> bool:
        if self._echoes is None or (identifier, data) not in self._echoes:
            return False
        while self._echoes.popleft() != (identifier, data):
            pass  # frames come back in order: those before were lost
        return True

    def close(self) -> None:
        """Leave the bus."""
        self._bus.shutdown()


def _open(interface: str, name: str) -> can.BusABC:
    if interface == INTERFACE:
        return LoopbackBus(name or None, holds=True)
    if interface == "udp_multicast":
        return open_channel(interface, name, hop_limit=0)  # its frames do not leave the machine
    return open_channel(interface, name)
