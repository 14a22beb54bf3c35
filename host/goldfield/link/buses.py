"""Where messages come from: a bus with a thread that never lets its buffers overflow, or a recorded log."""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Iterator
from typing import Protocol

import can

from goldfield.errors import SystemFailure, UserError, option
from goldfield.link.can_channel import open_channel
from goldfield.link.recordings import CandumpReader
from goldfield.link.serial_bus import SerialBus

CAN_BIT_RATE = 1_000_000


class Source(Protocol):
    """A stream of messages."""

    @property
    def bad_frames(self) -> int:
        """Frames or lines that were dropped as corrupt."""
        ...

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message, None when none came in time or, for a log, at its end.

        Raises
        ------
        SystemFailure
            If the link is gone.
        """
        ...

    def close(self) -> None:
        """Let go of the link."""
        ...


class BusSource:
    """A python-can bus, read by its own thread so that slow work on a pose costs no message.

    Parameters
    ----------
    bus : can.BusABC
        The bus; `close` shuts it down.
    name : str
        The link's name, for error messages.
    """

    def __init__(self, bus: can.BusABC, name: str) -> None:
        self.name = name
        self._bus = bus
        self._queue: queue.SimpleQueue[can.Message | Exception] = queue.SimpleQueue()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read, name=f"read {name}", daemon=True)
        self._thread.start()

    @property
    def bad_frames(self) -> int:
        """Frames dropped as corrupt; a CAN controller drops them itself, so 0 there."""
        return self._bus.bad_frames if isinstance(self._bus, SerialBus) else 0

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message, or None when none came in time; `UserError` after `close`."""
        if self._stop.is_set():
            raise UserError(_closed(self.name))
        try:
            item = self._queue.get(timeout=max(0.0, timeout_s))
        except queue.Empty:
            return None
        if isinstance(item, Exception):
            self._queue.put(item)
            raise SystemFailure(_sentence(self.name, item)) from item
        return item

    def send(self, identifier: int, data: bytes) -> None:
        """Send a message; `SystemFailure` if the link is gone."""
        try:
            self._bus.send(can.Message(arbitration_id=identifier, is_extended_id=True, data=data), timeout=1.0)
        except (can.CanError, OSError) as error:
            raise SystemFailure(_sentence(self.name, error)) from error

    def close(self) -> None:
        """Stop the thread and shut the bus down."""
        self._stop.set()
        self._thread.join(timeout=2.0)
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()

    def _read(self) -> None:
        while not self._stop.is_set():
            try:
                message = self._bus.recv(timeout=0.2)
            except Exception as error:  # whatever a vendor's interface raises ends this link, and is reported
                self._queue.put(error)
                return
            if (
                message is not None
                and message.is_extended_id
                and not (message.is_error_frame or message.is_remote_frame)
            ):
                self._queue.put(message)


class LogSource:
    """A recorded log, as fast as it can be read."""

    def __init__(self, reader: CandumpReader) -> None:
        self._reader = reader
        self._messages: Iterator[can.Message] = iter(reader)
        self._closed = False

    @property
    def bad_frames(self) -> int:
        """Lines that are no message."""
        return self._reader.bad_lines

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message, None at the end; `UserError` after `close`."""
        if self._closed:
            raise UserError(_closed(self._reader.name))
        return next(self._messages, None)

    def close(self) -> None:
        """Close the file."""
        self._closed = True
        self._reader.close()


def open_port(path: str) -> BusSource:
    """Open a serial port; `UserError` if that fails."""
    try:
        return BusSource(SerialBus(path), path)
    except can.CanError as error:
        raise UserError(f"{error}: check {option('port')}") from error


def open_can(where: str) -> BusSource:
    """Open ``INTERFACE:CHANNEL`` of python-can; `UserError` if that fails."""
    interface, separator, channel = where.partition(":")
    given = option("can", where)
    if not (interface and separator and channel):
        raise UserError(f"{given}: is not INTERFACE:CHANNEL, as in socketcan:can0 or udp_multicast:239.74.163.2")
    if interface not in can.VALID_INTERFACES:
        raise UserError(f"{given}: python-can knows no interface {interface}; it knows {_known_interfaces()}")
    try:
        return BusSource(open_channel(interface, channel, bitrate=CAN_BIT_RATE), where)
    except Exception as error:  # each vendor's interface raises its own kinds
        raise UserError(f"{given}: cannot be opened: {_one_line(error)}") from error


def _closed(name: str) -> str:
    """Return the sentence for who reads a link that was closed."""
    return f"{name}: is closed: read it before, or open it again"


def _known_interfaces() -> str:
    return ", ".join(sorted(can.VALID_INTERFACES))


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _sentence(name: str, error: Exception) -> str:
    text = _one_line(error)
    return text if text.startswith(name) else f"{name}: the link failed: {text}"
