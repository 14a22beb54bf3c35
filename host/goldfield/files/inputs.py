"""Files that a command reads, opened in one way: ``-`` is stdin, and nothing waits for a pipe that nobody writes."""

from __future__ import annotations

import io
import queue
import stat
import sys
import threading
from pathlib import Path
from typing import BinaryIO

from goldfield.errors import UserError

STREAM = "-"
"""The path that stands for stdin where a file is read, and for stdout where one is written."""

PIPE_S = 3.0
"""Longest wait for the other end of a named pipe, s."""


def name_of(path: str | Path) -> str:
    """Return what messages call an input: its path, or ``stdin``.

    Examples
    --------
    >>> name_of("room.toml"), name_of("-")
    ('room.toml', 'stdin')
    """
    return "stdin" if str(path) == STREAM else str(path)


def open_input(path: str | Path, what: str) -> BinaryIO:
    """Open a file, a pipe or stdin to be read.

    Parameters
    ----------
    path : path
        ``-`` is stdin.
    what : str
        What the file should be, for messages: "site file".

    Raises
    ------
    UserError
        If there is no such file, it is a directory, it cannot be opened, or nobody writes into a named pipe.
    """
    if str(path) == STREAM:
        if sys.stdin is None:
            raise UserError(f"stdin is closed: give a {what} in place of -")
        return sys.stdin.buffer
    try:
        if stat.S_ISFIFO(Path(path).stat().st_mode):
            return _other_end(Path(path), "rb", f"the {what} is a pipe into which nobody writes")
        return Path(path).open("rb")
    except FileNotFoundError as error:
        raise UserError(f"{path}: there is no such {what}: check the path") from error
    except IsADirectoryError as error:
        raise UserError(f"{path}: is a directory, not a {what}: give the file") from error
    except (OSError, ValueError) as error:  # ValueError: the path holds a zero byte
        raise UserError(f"{path}: the {what} cannot be read: {reason_of(error)}") from error


def read_bounded(path: str | Path, what: str, most: int) -> bytes:
    """Read a whole file that must be no larger than ``most`` bytes.

    Raises
    ------
    UserError
        As for `open_input`, and if the file is larger, or fails while it is read.
    """
    try:
        with open_input(path, what) as file:
            data = file.read(most + 1)
    except OSError as error:
        raise UserError(f"{name_of(path)}: the {what} cannot be read: {reason_of(error)}") from error
    if len(data) > most:
        raise UserError(f"{name_of(path)}: is larger than {most} bytes, which no {what} is: give a {what}")
    return data


def reason_of(error: BaseException) -> str:
    """Return what the system says of an error, in one line."""
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__


def open_pipe_end(path: Path) -> BinaryIO:
    """Open a named pipe to be written; `UserError` if nobody reads it within `PIPE_S`."""
    return _other_end(path, "wb", "is a pipe that nobody reads")


def _other_end(path: Path, mode: str, complaint: str) -> BinaryIO:
    """Open a named pipe, which waits for its other end: in a thread, so that the wait has an end."""
    opened: queue.SimpleQueue[io.FileIO | OSError] = queue.SimpleQueue()

    def wait() -> None:
        try:
            opened.put(io.FileIO(path, mode))
        except OSError as error:
            opened.put(error)

    threading.Thread(target=wait, name=f"open {path}", daemon=True).start()
    try:
        file = opened.get(timeout=PIPE_S)
    except queue.Empty:
        raise UserError(f"{path}: {complaint} (it was waited for {PIPE_S:g} s): start its other end first") from None
    if isinstance(file, OSError):
        raise file
    return io.BufferedReader(file) if mode == "rb" else file
