"""Where messages come from: a bus with a thread that never lets its buffers overflow, or a recorded log."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Protocol

import can

from goldfield.errors import SystemFailure, UserError, option, tell
from goldfield.link.access_key import AccessKey
from goldfield.link.can_channel import is_virtual, kernel_bit_rate, open_channel, resynchronise
from goldfield.link.line import RATES, Line, Link, checked_rate
from goldfield.link.loopback_bus import LoopbackBus
from goldfield.link.recordings import CandumpReader
from goldfield.link.serial_bus import SerialBus
from goldfield.link.traffic import CORRUPT, GARBLED, added, kind_of, no_traffic

LOOK_S = 0.1
"""Longest wait of one look at a bus."""
LOOKS = 20
"""Most looks that are waited for before a bus counts as silent; an interface may wait longer than it is asked to."""
ECHOES = 64
"""Latest messages sent that may come back: udp_multicast hands a program what it sent itself."""
RETRY_S = 0.5
"""Time between attempts to open a link again."""


class Source(Protocol):
    """A stream of messages."""

    @property
    def traffic(self) -> Mapping[str, int]:
        """What came and was no data frame with a 29-bit identifier, by the kinds of `goldfield.link.traffic`."""
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
    shared : bool, optional
        Whether other boards may be on the link, as on CAN; a serial line has one board.
    listen_only : bool, optional
        Nothing is ever sent: `send` raises.
    opens : callable, optional
        Opens the bus again at a bit rate; it raises `UserError` or `can.CanError` as long as that is impossible.
    reconnects : bool, optional
        A link that is gone is opened again, and waited for without end; else it ends the source.
    bit_rate : int, optional
        Bits a second, of a bus that does not tell it itself.

    Attributes
    ----------
    reconnections : int
        How often the link was opened again.
    gone : str
        Why the link is gone, while it is waited for; else empty. Other threads may look at it.
    key : AccessKey or None
        The key with which boards on the link are unlocked, if they are locked.
    sender_waits : bool
        Whether the sender goes no faster than it is read: what waits here is then not late.
    virtual : bool
        Whether the link has no bit rate of its own, as a pseudo-terminal or a virtual CAN (`can_channel.is_virtual`).
    """

    shared = False
    listen_only = False
    reconnects = False
    reconnections = 0
    gone = ""
    sender_waits = False
    virtual = False
    key: AccessKey | None = None

    def __init__(
        self,
        bus: can.BusABC,
        name: str,
        *,
        shared: bool = False,
        listen_only: bool = False,
        opens: Callable[[int], can.BusABC] | None = None,
        reconnects: bool = False,
        bit_rate: int | None = None,
    ) -> None:
        self.name = name
        self.shared = shared
        self.listen_only = listen_only
        self.reconnects = reconnects
        self.sender_waits = isinstance(bus, SerialBus) and bus.sender_waits
        self.virtual = self.sender_waits or (shared and is_virtual(*name.partition(":")[::2]))
        self._opens = opens
        self._bit_rate = bit_rate or RATES[Link.CAN if shared else Link.SERIAL][0]
        self._traffic = no_traffic()
        self._sent: deque[tuple[int, bytes]] = deque(maxlen=ECHOES)
        self._queue: queue.SimpleQueue[list[can.Message] | Exception] = queue.SimpleQueue()
        self._taken: deque[can.Message] = deque()
        self._stop = threading.Event()
        self._begin(bus)

    @property
    def line(self) -> Line:
        """What the link is, and at which rate: that of a serial port is known when the first frame has come."""
        bit_rate = self._bus.bit_rate if isinstance(self._bus, SerialBus) else self._bit_rate
        return Line(Link.CAN if self.shared else Link.SERIAL, bit_rate)

    @property
    def traffic(self) -> Mapping[str, int]:
        """What came and was no data frame with a 29-bit identifier; corrupt frames a CAN controller drops itself."""
        return added(self._traffic, _bad_frames(self._bus))

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message, or None when none came in time; `UserError` after `close`.

        None is returned only when the link has been looked at after the time had passed, with nothing found: a process
        that was stopped, with its computer or by a signal, takes what came meanwhile.
        """
        if self._stop.is_set():
            raise UserError(_closed(self.name))
        if self._taken:
            return self._taken.popleft()
        try:
            item = self._queue.get(timeout=max(0.0, timeout_s))
        except queue.Empty:
            found = self._found_by_looking()
            if found is None:
                return None
            item = found
        if not isinstance(item, Exception):
            self._taken.extend(item)
            return self._taken.popleft()
        if self._opens is None or not self.reconnects:
            self._queue.put(item)
            raise SystemFailure(_sentence(self.name, item)) from item
        self._reconnect(item, self._opens)
        return None

    def send(self, identifier: int, data: bytes) -> None:
        """Send a message; `SystemFailure` if the link is gone and is not waited for, or listens only."""
        if self.listen_only:
            raise SystemFailure(f"{self.name}: nothing is sent to a link that is only listened to")
        self._sent.append((identifier, data))
        try:
            self._bus.send(can.Message(arbitration_id=identifier, is_extended_id=True, data=data), timeout=1.0)
        except (can.CanError, OSError) as error:
            if not self.reconnects:
                raise SystemFailure(_sentence(self.name, error)) from error

    def set_bit_rate(self, bit_rate: int) -> None:
        """Close the link, and open it at another rate.

        Raises
        ------
        UserError
            If the rate is not for this program to set; the link is then open as it was.
        SystemFailure
            If the link is gone.
        """
        if self._opens is None:
            raise UserError(f"{self.name}: its bit rate cannot be set: open it again")
        before = self.line.bit_rate
        self.close()
        self._queue, self._taken, self._stop = queue.SimpleQueue(), deque(), threading.Event()
        try:
            try:
                bus = self._opens(bit_rate)
            except UserError:
                self._begin(self._opens(before))
                raise
        except can.CanError as error:
            raise SystemFailure(_sentence(self.name, error)) from error
        self._bit_rate = bit_rate
        self._begin(bus)

    def close(self) -> None:
        """Stop the thread and shut the bus down."""
        self._stop.set()
        self._thread.join(timeout=2.0)
        self._shut_down()

    def _begin(self, bus: can.BusABC) -> None:
        self._bus = bus
        self._look = 0  # number of the look at the bus that is under way, or was the last one
        self._empty_look = 0  # number of the latest one that found no message
        self._thread = threading.Thread(target=self._read, args=(bus,), name=f"read {self.name}", daemon=True)
        self._thread.start()

    def _found_by_looking(self) -> list[can.Message] | Exception | None:
        """Return what the thread finds in a look that it begins after now; None for nothing."""
        next_look = self._look + 1
        for _ in range(LOOKS):
            empty = self._empty_look >= next_look  # it comes first: what an earlier look found is in the queue
            with contextlib.suppress(queue.Empty):
                return self._queue.get(timeout=0.0 if empty else LOOK_S)
            if empty:
                break
        return None

    def _read(self, bus: can.BusABC) -> None:
        while not self._stop.is_set():
            self._look += 1
            message = None
            try:
                message = bus.recv(timeout=LOOK_S)
            except Exception as error:  # each vendor's interface raises its own kinds
                if not _only_garbled(error):
                    self._queue.put(error)
                    return
                self._traffic[GARBLED] += 1
                resynchronise(bus)
            if message is None:
                self._empty_look = self._look
                continue
            # What came together is handed over together, so that who waits for it is woken once.
            together = [message, *bus.waiting()] if isinstance(bus, SerialBus) else [message]
            found = [one for one in together if self._is_ours(one)]
            if found:
                self._queue.put(found)

    def _is_ours(self, message: can.Message) -> bool:
        """Whether a message is a data frame of another node; what is none is counted."""
        kind = kind_of(message)
        if kind is not None:
            self._traffic[kind] += 1
        return kind is None and not self._is_echo(message)

    def _is_echo(self, message: can.Message) -> bool:
        """Whether a message is one of this source, and has not come back before."""
        try:
            self._sent.remove((message.arbitration_id, bytes(message.data)))
        except ValueError:
            return False
        return True

    def _reconnect(self, error: Exception, opens: Callable[[int], can.BusABC]) -> None:
        """Wait until the link can be opened again, and read on."""
        self.gone = f"{_sentence(self.name, error)}; waiting for it"
        tell(self.gone)
        self._traffic = added(self._traffic, _bad_frames(self._bus))
        self._shut_down()
        begin_s = time.monotonic()
        while True:
            try:
                bus = opens(self.line.bit_rate)
                break
            except (can.CanError, UserError):
                time.sleep(RETRY_S)
        self._begin(bus)
        self.reconnections += 1
        self.gone = ""
        tell(f"{self.name}: is back after {time.monotonic() - begin_s:.1f} s")

    def _shut_down(self) -> None:
        with contextlib.suppress(can.CanError, OSError):
            self._bus.shutdown()


class LogSource:
    """A recorded log, as fast as it can be read."""

    def __init__(self, reader: CandumpReader) -> None:
        self._reader = reader
        self._messages: Iterator[can.Message] = iter(reader)
        self._closed = False

    @property
    def traffic(self) -> Mapping[str, int]:
        """Lines that are no message, and frames that are no data frames with 29-bit identifiers."""
        return self._reader.traffic

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message, None at the end; `UserError` after `close`."""
        if self._closed:
            raise UserError(_closed(self._reader.name))
        return next(self._messages, None)

    def close(self) -> None:
        """Close the file."""
        self._closed = True
        self._reader.close()


def open_port(
    path: str, *, listen_only: bool = False, reconnect: bool = False, bit_rate: int | None = None
) -> BusSource:
    """Open a serial port; `UserError` if that fails. `BusSource` tells the options; without a rate it is found."""
    others = RATES[Link.SERIAL] if bit_rate is None else ()
    first = RATES[Link.SERIAL][0] if bit_rate is None else checked_rate(Link.SERIAL, bit_rate)

    def opened(rate: int) -> can.BusABC:
        return SerialBus(path, rate, listen_only, [other for other in others if other != rate])

    try:
        return BusSource(opened(first), path, listen_only=listen_only, opens=opened, reconnects=reconnect)
    except can.CanError as error:
        raise UserError(f"{error}: check {option('port')}") from error


def open_can(
    where: str, *, listen_only: bool = False, reconnect: bool = False, bit_rate: int | None = None
) -> BusSource:
    """Open ``INTERFACE:CHANNEL`` of python-can; `UserError` if that fails. `BusSource` tells the options.

    Without a rate it is that of the kernel's interface, where it has one, else the rate that boards have from the
    works.
    """
    interface, separator, channel = where.partition(":")
    given = option("can", where)
    if not (interface and separator and channel):
        raise UserError(f"{given}: is not INTERFACE:CHANNEL, as in socketcan:can0 or udp_multicast:239.74.163.2")
    if interface not in can.VALID_INTERFACES:
        raise UserError(f"{given}: python-can knows no interface {interface}; it knows {_known_interfaces()}")
    if bit_rate is not None:
        checked_rate(Link.CAN, bit_rate)
    kernels = kernel_bit_rate(channel) if interface == "socketcan" else None

    def opened(rate: int) -> can.BusABC:
        if kernels not in (None, rate):
            raise UserError(
                f"{option('bit_rate', rate)}: the kernel runs {channel} at {kernels} bit/s: sudo ip link set {channel} "
                f"down, then sudo ip link set {channel} up type can bitrate {rate}"
            )
        try:
            return open_channel(interface, channel, listen_only=listen_only, bitrate=rate)
        except Exception as error:  # each vendor's interface raises its own kinds
            raise UserError(f"{given}: cannot be opened: {_one_line(error)}") from error

    first = bit_rate or kernels or RATES[Link.CAN][0]
    return BusSource(
        opened(first),
        where,
        shared=True,
        listen_only=listen_only,
        opens=opened,
        reconnects=reconnect,
        bit_rate=first,
    )


def _bad_frames(bus: can.BusABC) -> dict[str, int]:
    """Return what a bus of ours dropped itself; python-can's own raise it, or do not tell."""
    if isinstance(bus, SerialBus):
        return {CORRUPT: bus.bad_frames}
    return {GARBLED: bus.bad_frames} if isinstance(bus, LoopbackBus) else {}


def _only_garbled(error: Exception) -> bool:
    """Whether an interface could not read what had come, while the link itself is alive."""
    if isinstance(error, can.CanError):
        return error.__cause__ is not None and not isinstance(error.__cause__, OSError)
    return isinstance(error, (ValueError, LookupError, TypeError, AttributeError))


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
