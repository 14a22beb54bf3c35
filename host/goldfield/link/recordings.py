"""Recordings in candump's log format: ``(seconds.micros) channel ID#DATA``, readable by can-utils and SavvyCAN."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import can

from goldfield.errors import UserError, tell

CHANNEL = "goldfield"
LINE = re.compile(rb"\((\d{1,12}\.\d{1,9})\) (\S{1,64}) ([0-9A-Fa-f]{8})#((?:[0-9A-Fa-f]{2}){0,8})(?: [RT])?\s*")


class CandumpReader:
    """Messages of a recorded log.

    Attributes
    ----------
    name : str
        The path, for messages.
    bad_lines : int
        Lines so far that are no message of ours: torn, corrupt, or with an 11-bit identifier.

    Raises
    ------
    UserError
        If the file cannot be read or holds no message at all.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self.name = str(path)
        self.bad_lines = 0
        try:
            self._file = self._path.open("rb")
        except FileNotFoundError as error:
            raise UserError(f"{path}: there is no such log: check the path") from error
        except IsADirectoryError as error:
            raise UserError(f"{path}: is a directory, not a log: give a candump log") from error
        except OSError as error:
            raise UserError(f"{path}: the log cannot be read: {error.strerror}") from error

    def __iter__(self) -> Iterator[can.Message]:
        found = False
        with self._file:
            # readline with a limit: a file without line ends must not fill the memory
            for line in iter(lambda: self._file.readline(200), b""):
                match = LINE.fullmatch(line)
                if match is None or int(match[3], 16) >= 1 << 29:
                    self.bad_lines += bool(line.strip())
                    continue
                found = True
                yield can.Message(
                    timestamp=float(match[1]),
                    arbitration_id=int(match[3], 16),
                    is_extended_id=True,
                    data=bytes.fromhex(match[4].decode()),
                    channel=match[2].decode(errors="replace"),
                )
        if not found:
            raise UserError(
                f"{self._path}:1: the log holds no message like '(1.500000) can0 01000064#0011223344556677': "
                "give a candump log"
            )

    def close(self) -> None:
        """Close the file, which the end of the log does too."""
        self._file.close()


class CandumpWriter:
    """Writes a log so that a crash loses nothing: every message is handed to the system at once.

    A failing disk (full, removed) ends the recording with a message on stderr, cuts a torn last line off and lets the
    run go on.

    Raises
    ------
    UserError
        If the file cannot be made, or holds something already.
    """

    def __init__(self, path: str | Path) -> None:
        self._path = Path(path)
        self._size = 0
        self.failed = False
        try:
            if self._path.is_file() and self._path.stat().st_size > 0:
                raise UserError(f"{path}: exists and is not empty: give a new file to record into, or remove it")
            self._file = self._path.open("wb", buffering=0)
        except OSError as error:
            raise UserError(f"{path}: cannot be recorded into: {error.strerror}") from error

    def write(self, message: can.Message) -> None:
        """Append a message."""
        if self.failed:
            return
        line = b"(%.6f) %b %08X#%b\n" % (
            message.timestamp,
            CHANNEL.encode(),
            message.arbitration_id,
            bytes(message.data).hex().upper().encode(),
        )
        try:
            written = self._file.write(line)
            if written != len(line):
                raise OSError(0, f"only {written} of {len(line)} bytes were taken (disk full?)")
            self._size += len(line)
        except OSError as error:
            self._give_up(error)

    def close(self) -> None:
        """End the recording."""
        self._file.close()

    def _give_up(self, error: OSError) -> None:
        self.failed = True
        tell(f"{self._path}: recording stopped after {self._size} bytes: {error.strerror}; the run goes on")
        try:
            self._file.truncate(self._size)
        except OSError:
            return  # a device such as /dev/full; what was written before stands
