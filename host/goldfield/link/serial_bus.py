"""The serial link as a python-can interface named ``goldfield_serial``: the frames of ``protocol/framing.md``."""

from __future__ import annotations

import errno
import os
import time
from collections import deque
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import can
import serial

from goldfield.errors import tell
from goldfield.link.terminals import put_back, settings_of, whose_terminal
from goldfield_protocol.framing import FrameDecoder, RawFrame, encode_frame
from goldfield_protocol.messages import mismatch
from goldfield_protocol.rates import SERIAL_RATES

ENOUGH_BYTES = 64
"""So many bytes hold three whole frames: if none of them is right, they were sent at another rate."""

POLL_S = 0.05
"""Longest wait in one read: setting pyserial's time-out for each read would reconfigure the port each time."""

PSEUDO_TERMINALS = Path("/dev/pts")

KNOWN_REASONS = {
    errno.ENOENT: "there is no such port",
    errno.ENOTTY: "is no serial port",
    errno.EISDIR: "is a directory, no serial port",
    errno.EAGAIN: "is in use by another program",
}


class SerialBus(can.BusABC):
    """A serial port or pseudo-terminal that carries CAN messages.

    Parameters
    ----------
    channel : str
        Path of the port.
    baudrate : int
    listen_only : bool
        Nothing is ever sent.
    others : sequence of int
        Rates at which the port is listened to, one after the other, as long as bytes come and no frame is right.

    Attributes
    ----------
    bit_rate : int
        The rate that it is set to.

    Raises
    ------
    can.CanInitializationError
        If the port cannot be opened, or is the terminal of a process.

    Notes
    -----
    At the end the port is set to what it was set to before.
    A bad frame costs that frame only and is counted in `bad_frames`. A lost port raises `can.CanOperationError`.
    """

    def __init__(
        self,
        channel: str,
        baudrate: int = SERIAL_RATES[0],
        listen_only: bool = False,
        others: Sequence[int] = (),
        **kwargs: Any,
    ) -> None:
        self._port_name = channel
        self.bit_rate = self._first_rate = baudrate
        self._rates = cycle([*others, baudrate]) if others else None
        self._bytes = self._frames = 0  # since the rate was set, as long as it is looked for
        self._decoder = FrameDecoder()
        self._received: deque[can.Message] = deque()
        self._in_step = False
        self._listen_only = listen_only
        whose = whose_terminal(channel)
        if whose is not None:
            raise can.CanInitializationError(f"{channel}: is {whose}, not the port of a board")
        self._settings = settings_of(channel)
        try:
            self._port = serial.Serial(channel, baudrate, timeout=POLL_S, write_timeout=1.0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise can.CanInitializationError(f"{channel}: {_reason(error)}") from error
        self.channel_info = f"goldfield serial {channel}"
        self._can_protocol = can.CanProtocol.CAN_20
        super().__init__(channel=channel, **kwargs)
        if not listen_only:
            self._port.write(b"\0")  # ends a torn frame in the receiver

    @property
    def bad_frames(self) -> int:
        """Frames dropped since the start: checksum, coding or length wrong."""
        return self._decoder.bad_crc + self._decoder.malformed + self._decoder.overlong

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a message; `can.CanOperationError` if the port is gone or takes no bytes for a second."""
        if self._listen_only:
            raise can.CanOperationError("the serial link is only listened to")
        if msg.is_remote_frame or msg.is_error_frame or msg.is_fd or not msg.is_extended_id:
            raise can.CanOperationError("the serial link carries extended data frames of up to 8 bytes only")
        try:
            self._port.write(encode_frame(msg.arbitration_id, bytes(msg.data)))
        except (serial.SerialException, OSError) as error:
            raise self._gone(error) from error

    @property
    def sender_waits(self) -> bool:
        """Whether the port is a pseudo-terminal, whose other end, a simulated bench, waits until it is read."""
        return Path(self._port_name).resolve().is_relative_to(PSEUDO_TERMINALS)

    def waiting(self) -> list[can.Message]:
        """Return what came together with the last message that `recv` returned, and `recv` has yet to return."""
        waiting = list(self._received)
        self._received.clear()
        return waiting

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        deadline = None if timeout is None else time.monotonic() + timeout
        while not self._received:
            try:
                waiting = self._port.in_waiting
                chunk = b"" if timeout == 0.0 and not waiting else self._port.read(max(1, waiting))
                if chunk and not waiting:  # the first byte of what comes now
                    chunk += self._port.read(self._port.in_waiting)
            except (serial.SerialException, OSError, TypeError) as error:
                raise self._gone(error) from error  # TypeError: pyserial's answer to a port closed in another thread
            found = self._decode(chunk)
            if self._rates is not None:
                self._look_for_rate(len(chunk), found)
            if not self._received and deadline is not None and time.monotonic() >= deadline:
                break
        return (self._received.popleft() if self._received else None), False

    def _look_for_rate(self, count: int, frames: Sequence[RawFrame]) -> None:
        """Judge the rate by so many bytes, and the frames in them: it is right, wrong, or not known yet."""
        self._bytes += count
        self._frames += len(frames)
        ours = any(mismatch(frame.identifier, len(frame.data)) is None for frame in frames)
        if ours or self._frames > 1:  # one frame with a right checksum may be chance
            self._rates = None
            if self.bit_rate != self._first_rate:
                tell(f"{self._port_name}: the frames are right at {self.bit_rate} baud")
        elif self._bytes >= ENOUGH_BYTES and self._rates is not None:
            self._set_rate(next(self._rates))

    def _set_rate(self, bit_rate: int) -> None:
        try:
            self._port.baudrate = bit_rate
            self._port.reset_input_buffer()
            if not self._listen_only:
                self._port.write(b"\0")
        except ValueError:  # the adapter has no such rate: the next one is tried
            pass
        except (serial.SerialException, OSError, TypeError) as error:
            raise self._gone(error) from error
        self.bit_rate = bit_rate
        self._decoder = FrameDecoder()
        self._in_step = False
        self._bytes = self._frames = 0

    def _decode(self, chunk: bytes) -> list[RawFrame]:
        found: list[RawFrame] = []
        now = time.time()
        head, delimiter, rest = chunk.partition(b"\0")
        for part in (chunk,) if self._in_step else (head + delimiter, rest):
            for frame in self._decoder.feed(part):
                found.append(frame)
                message = can.Message(
                    timestamp=now, arbitration_id=frame.identifier, data=frame.data, channel=self._port_name
                )
                self._received.append(message)
            if delimiter and not self._in_step:
                # Listening began in the middle of a frame, which is no fault of the line.
                self._in_step = True
                self._decoder.bad_crc = self._decoder.malformed = self._decoder.overlong = 0
        return found

    def fileno(self) -> int:
        """Return the port's file descriptor."""
        return int(self._port.fileno())

    def shutdown(self) -> None:
        """Set the port to what it was set to before, and close it."""
        super().shutdown()
        if self._port.is_open:
            put_back(self._port.fileno(), self._settings)
        self._port.close()

    def _gone(self, error: Exception) -> can.CanOperationError:
        return can.CanOperationError(
            f"{self._port_name}: the port is gone ({_reason(error)}): cable pulled or sender ended"
        )


def _reason(error: Exception) -> str:
    """Say in a few words why a port failed; pyserial wraps the system's number in a sentence of its own."""
    if isinstance(error, serial.SerialTimeoutException):
        return "it takes no bytes"
    cause = error.__context__ or error
    number = cause.args[0] if cause.args and isinstance(cause.args[0], int) else getattr(error, "errno", None)
    if number is None:
        return " ".join(str(error).split())
    return KNOWN_REASONS.get(number, os.strerror(number))
