"""The serial ports and CAN interfaces of this machine: what they seem to be, and whether this user may open them."""

from __future__ import annotations

import getpass
import grp
import json
import os
import pwd
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from goldfield.link.line import VIRTUAL_OF_KERNEL

DETECTION_S = 3.0
"""Longest wait for the vendors' CAN interfaces to name their devices, s."""

NO_BUSES = ("virtual", "udp_multicast", "socketcand", "serial", "goldfield_serial")
"""Interfaces of python-can that name channels without hardware behind them, ports again, or machines of the network."""

NETWORK = Path("/sys/class/net")

ADAPTERS = {
    (0x0403, None): "USB serial adapter (FTDI)",
    (0x10C4, 0xEA60): "USB serial adapter (CP210x)",
    (0x1A86, None): "USB serial adapter (WCH)",
    (0x067B, None): "USB serial adapter (PL2303)",
    (0x0483, 0x3748): "ST-LINK probe",
    (0x0483, 0x374B): "ST-LINK probe with a serial port: a board on its target side",
    (0x0483, 0x374E): "ST-LINK probe with a serial port: a board on its target side",
    (0x0483, 0x5740): "STM32 board with USB of its own",
    (0xF055, 0x9800): "pyboard that runs MicroPython, not goldfield",
    (0x16D0, 0x117E): "CAN adapter (CANable, slcan): give it as --can slcan:PORT",
    (0xAD50, 0x60C4): "CAN adapter (CANable, slcan): give it as --can slcan:PORT",
    (0x2341, None): "Arduino, not goldfield",
}
"""What USB vendor and product, or vendor alone (None), seem to be."""


@dataclass(frozen=True)
class SerialPort:
    """A serial port.

    Attributes
    ----------
    path : str
    description, manufacturer, usb, serial_number : str or None
        What the device says of itself; ``usb`` is vendor and product as ``"0403:6001"``.
    seems : str
        What it seems to be.
    problem : str or None
        Why this user cannot open it, with what to do; None if nothing speaks against it.
    """

    path: str
    description: str | None
    manufacturer: str | None
    usb: str | None
    serial_number: str | None
    seems: str
    problem: str | None


@dataclass(frozen=True)
class CanInterface:
    """A CAN interface that python-can can open.

    Attributes
    ----------
    interface, channel : str
        As in ``--can INTERFACE:CHANNEL``.
    problem : str or None
        Why it cannot be used as it is, with what to do.
    """

    interface: str
    channel: str
    problem: str | None


def serial_ports() -> list[SerialPort]:
    """Return the serial ports of this machine in the order of their names."""
    from serial.tools import list_ports  # the platform's own search, needed here only

    found = []
    for port in sorted(list_ports.comports()):
        usb = None if port.vid is None else f"{port.vid:04x}:{port.pid:04x}"
        found.append(
            SerialPort(
                path=port.device,
                description=None if port.description in (None, "n/a") else port.description,
                manufacturer=port.manufacturer,
                usb=usb,
                serial_number=port.serial_number,
                seems=_seems(port.vid, port.pid),
                problem=permission_problem(port.device),
            )
        )
    return found


def _seems(vendor: int | None, product: int | None) -> str:
    if vendor is None:
        return "built-in serial port, whose baud rate may end far below 2,000,000"
    return ADAPTERS.get((vendor, product)) or ADAPTERS.get((vendor, None)) or "USB device of an unknown kind"


def permission_problem(path: str) -> str | None:
    """Return why this user may not read and write a port, with what to do; None if it may, or there is no such port."""
    try:
        owner = Path(path).stat()
    except OSError:
        return None
    if os.access(path, os.R_OK | os.W_OK, effective_ids=os.access in os.supports_effective_ids):
        return None
    group = _name_of(grp.getgrgid, owner.st_gid)
    if owner.st_mode & 0o060 != 0o060:
        return (
            f"you may not open {path}, which belongs to {_name_of(pwd.getpwuid, owner.st_uid)}: sudo chmod g+rw {path}"
        )
    return (
        f"you may not open {path}, which the group {group} may: sudo usermod -aG {group} {_user()}, "
        "then log out and in again"
    )


def _name_of(entry: object, number: int) -> str:
    try:
        return str(entry(number)[0])  # type: ignore[operator]  # one of the two look-ups, each with a name first
    except KeyError:
        return str(number)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a user id without an entry
        return "$USER"


def kernel_can_interfaces(network: Path = NETWORK) -> list[CanInterface]:
    """Return the CAN interfaces of the kernel, which lists its network interfaces in a folder."""
    return [_of_kernel(path) for path in sorted(network.glob("*")) if _text(path / "type") == "280"]


def kernel_can_errors(channel: str, network: Path = NETWORK) -> int:
    """Return how many errors the kernel has counted on one of its CAN interfaces; 0 if it is none."""
    return sum(int(_text(network / channel / "statistics" / f"{way}_errors") or 0) for way in ("rx", "tx"))


def can_interfaces(timeout_s: float = DETECTION_S, network: Path = NETWORK) -> list[CanInterface]:
    """Return the CAN interfaces of this machine: those of the kernel, and those that vendors' libraries name.

    Parameters
    ----------
    timeout_s : float
        Longest wait for the libraries, which run in a process of their own: one that hangs is ended with it, s.
    network : path
        Where the kernel lists its network interfaces.
    """
    command = [sys.executable, "-m", "goldfield.link.can_detection", str(timeout_s), *NO_BUSES, "socketcan"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s + 5.0, check=False)
        told = done.stdout.splitlines()[-1:] if done.returncode == 0 else []
    except subprocess.TimeoutExpired:
        told = []
    named: Sequence[Sequence[str]] = json.loads(told[0]) if told else []
    return kernel_can_interfaces(network) + [CanInterface(interface, channel, None) for interface, channel in named]


def _of_kernel(path: Path) -> CanInterface:
    """Return a kernel's interface, whose state is a file (``ARPHRD_CAN`` is type 280)."""
    name = path.name
    up = _text(path / "operstate") in ("up", "unknown") and int(_text(path / "flags") or "0x1", 16) & 1
    setting = "" if name.startswith(VIRTUAL_OF_KERNEL) else " type can bitrate 1000000"
    problem = None if up else f"{name} is down: sudo ip link set {name} up{setting}"
    return CanInterface("socketcan", name, problem)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return ""
