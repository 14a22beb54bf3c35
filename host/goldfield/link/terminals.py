"""Terminals that people sit at, which are no ports of boards; and what a port was set to before it was opened."""

from __future__ import annotations

import contextlib
import os
import stat
import sys
from pathlib import Path
from types import ModuleType

termios: ModuleType | None
try:
    import termios
except ImportError:  # Windows has none
    termios = None

PROCESSES = Path("/proc")
TERMINAL_FIELD = 4
"""Place of the controlling terminal's device number in /proc/PID/stat, behind the name in parentheses."""


def whose_terminal(path: str) -> str | None:
    """Return in a few words whose terminal a path is; None if it is nobody's, as the port of a board.

    A terminal is what one of the standard streams of this process is, and, where there is /proc, the controlling
    terminal of any process that this user may see.

    Parameters
    ----------
    path : str
        The path need not exist.
    """
    try:
        status = Path(path).stat()
    except OSError:
        return None
    if not stat.S_ISCHR(status.st_mode):
        return None
    if path == "/dev/tty" or any(_is(descriptor, status.st_rdev) for descriptor in range(3)):
        return "the terminal of this command"
    if not sys.platform.startswith("linux"):
        return None
    for process in PROCESSES.glob("[0-9]*/stat"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            before, _, behind = process.read_text(encoding="utf-8", errors="replace").rpartition(")")
            number, name = before.split(" (", 1)
            if _device(int(behind.split()[TERMINAL_FIELD])) == status.st_rdev:
                return f"the terminal of process {number} ({name})"
    return None


def settings_of(path: str) -> list[object] | None:
    """Return what a terminal or serial port is set to; None for anything else."""
    if termios is None:
        return None
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        return list(termios.tcgetattr(descriptor))
    except termios.error:
        return None
    finally:
        os.close(descriptor)


def put_back(descriptor: int, settings: list[object] | None) -> None:
    """Set an open port to what `settings_of` returned; a port that is gone stays as it is."""
    if termios is not None and settings is not None:
        with contextlib.suppress(termios.error, OSError):
            termios.tcsetattr(descriptor, termios.TCSANOW, settings)


def _is(descriptor: int, device: int) -> bool:
    with contextlib.suppress(OSError):
        return os.isatty(descriptor) and os.fstat(descriptor).st_rdev == device
    return False


def _device(number: int) -> int:
    """Return a device number as ``os.stat`` has it, of the kernel's in /proc (``new_encode_dev``)."""
    number &= 0xFFFFFFFF
    return os.makedev(number >> 8 & 0xFFF, number & 0xFF | number >> 12 & 0xFFF00)
