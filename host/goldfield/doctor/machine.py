"""The machine: whether goldfield is installed whole, and whether the port can be opened and carries frames."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from importlib import import_module
from importlib.metadata import entry_points, version

import can
import serial

from goldfield.doctor.checks import Check, Fault, sound, wrong
from goldfield.errors import UserError, counted
from goldfield.link.buses import BusSource
from goldfield.link.line import RATES, Line, Link
from goldfield.link.ports import kernel_can_interfaces, permission_problem
from goldfield.nodes.opening import open_link
from goldfield_protocol.framing import FrameDecoder
from goldfield_protocol.messages import protocol_hash

PARTS = ("goldfield.locate.kernel", "goldfield.sensor.opening")
"""Modules that load what the build makes."""

OTHER_RATES = (*RATES[Link.SERIAL], 1_000_000, 230_400, 57_600, 38_400, 19_200, 9_600)
"""Baud rates at which a line whose frames are all bad is listened to, those of boards first."""
RATE_S = 0.6
"""How long each of them is tried, s."""
BYTES_S = 1.2
"""How long a port is listened to for any byte: a board sends a heartbeat once a second, s."""


def installation() -> Iterator[Check]:
    """Yield whether everything that a pose needs can be loaded."""
    for part in PARTS:
        try:
            import_module(part)
        except Exception as error:
            yield wrong(
                Fault.INSTALLATION,
                "installation",
                f"{part} cannot be loaded: {type(error).__name__}: {error}",
                "install goldfield again: make, or pip install of its wheel",
            )
            return
    plugins = [plugin.name for plugin in entry_points(group="can.interface")]
    if "goldfield_serial" not in plugins:
        yield wrong(
            Fault.INSTALLATION,
            "installation",
            "python-can does not know the interface goldfield_serial",
            "install goldfield again: make, or pip install of its wheel",
        )
        return
    versions = f"Python {'.'.join(map(str, sys.version_info[:3]))}, python-can {can.__version__}"
    yield sound("installation", f"goldfield {version('goldfield')}, protocol {protocol_hash():#010x}, {versions}")


def permission(kind: str, where: str) -> Check | None:
    """Return what keeps this user from a port, or a CAN interface from working; None if nothing does."""
    if kind == "port":
        problem = permission_problem(where)
        return None if problem is None else wrong(Fault.PERMISSION, "permission", *_parted(problem))
    interface, _, channel = where.partition(":")
    if interface != "socketcan":
        return None
    for known in kernel_can_interfaces():
        if known.channel == channel and known.problem is not None:
            return wrong(Fault.LINK, "CAN interface", *_parted(known.problem))
    return None


def _parted(problem: str) -> tuple[str, str]:
    """Return what is wrong and what to do, which a colon parts."""
    text, _, advice = problem.partition(": ")
    return text, advice


def opened(kind: str, where: str, bit_rate: int | None = None) -> BusSource | Check:
    """Open the link, or return why that fails."""
    try:
        return open_link(kind, where, bit_rate)
    except UserError as error:
        text, _, advice = str(error).rpartition(": ")
        return wrong(
            Fault.LINK,
            "port" if kind == "port" else "CAN",
            text or str(error),
            f"{advice}; goldfield ports lists what there is" if text else "goldfield ports lists what there is",
        )


def rate_of(path: str) -> int | None:
    """Return the baud rate at which frames are right on a line that was bad at another one; None if at none.

    Each of `OTHER_RATES` is listened to for `RATE_S`.
    """
    for rate in OTHER_RATES:
        decoder = FrameDecoder()
        try:
            with serial.Serial(path, rate, timeout=0.05, exclusive=True) as port:
                deadline = time.monotonic() + RATE_S
                while time.monotonic() < deadline:
                    for _ in decoder.feed(port.read(max(1, port.in_waiting))):
                        return rate
        except (serial.SerialException, OSError, ValueError):
            continue
    return None


def silence(kind: str, where: str, line: Line, bad_frames: int) -> Check:
    """Return why no node is heard on a link, which is closed by now: nothing arrives, or nothing that is right."""
    if kind == "port":
        return (
            _not_right(where, line)
            if bad_frames or _carries_bytes(where, line)
            else _nothing(where, "; TX and RX may be swapped")
        )
    if bad_frames:
        return wrong(
            Fault.LINK,
            "CAN",
            f"{counted(bad_frames, 'frames or bits were corrupt')} and no frame was right on {line}",
            f"{_bit_rate_of_can(where)}; check the termination",
        )
    return _nothing(where, f" and the termination; {_bit_rate_of_can(where)}")


def _bit_rate_of_can(where: str) -> str:
    """Return what to do about a bit rate that is not that of the boards, which no frame tells."""
    *rates, last = RATES[Link.CAN]
    told = f"the boards of a bus speak at {', '.join(map(str, rates))} or {last} bit/s: "
    interface, _, channel = where.partition(":")
    if interface == "socketcan":
        return f"{told}sudo ip link set {channel} down, then sudo ip link set {channel} up type can bitrate {last}"
    return f"{told}give another one with --bit-rate"


def _nothing(where: str, more: str) -> Check:
    return wrong(Fault.LINK, "link", f"no board is heard at {where}", f"check the board's power and the cable{more}")


def _carries_bytes(path: str, line: Line) -> bool:
    """Tell whether any byte arrives at a port within `BYTES_S`."""
    try:
        with serial.Serial(path, line.bit_rate, timeout=BYTES_S, exclusive=True) as port:
            return bool(port.read(1))
    except (serial.SerialException, OSError):
        return False


def _not_right(path: str, line: Line) -> Check:
    rate, ours = rate_of(path), RATES[Link.SERIAL]
    *rates, last = ours
    told = f"{', '.join(map(str, rates))} or {last} baud"
    if rate is None:
        return wrong(
            Fault.BAUD,
            "baud rate",
            "bytes arrive, and no frame of them is right at any rate",
            f"check that the adapter is able to do {told}, that a goldfield sensor is at its other end, the ground "
            "wire and the level (3.3 V)",
        )
    if rate in ours:
        text = f"the frames are right at {rate} baud, and the port was opened at {line.bit_rate}"
        return wrong(Fault.BAUD, "baud rate", text, f"leave --bit-rate out, or give --bit-rate {rate}")
    return wrong(
        Fault.BAUD,
        "baud rate",
        f"the frames are right at {rate} baud, and the boards of goldfield speak at {told}",
        "set what is at the other end (adapter, bridge) to the baud rate of the board",
    )
