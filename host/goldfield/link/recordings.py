"""Recordings of messages: read in the formats that CAN tools write, written in candump's, which all of them read."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import can

from goldfield.errors import SystemFailure, UserError, counted, tell
from goldfield.files.inputs import STREAM, name_of, open_input, reason_of
from goldfield.link.log_formats import DAMAGE, frames
from goldfield.link.recording_file import RecordingFile
from goldfield.link.traffic import CORRUPT, no_traffic

CHANNEL = "goldfield"


class CandumpReader:
    """Messages of a recording in any format that `frames` knows, each with its channel.

    Parameters
    ----------
    path : path
        ``-`` is stdin.
    file : file, optional
        The same, if it is open to be read already.

    Attributes
    ----------
    name : str
        The path, for messages.
    traffic : dict of str to int
        What came so far and is no data frame with a 29-bit identifier, by kind (`goldfield.link.traffic`).

    Raises
    ------
    UserError
        If the file cannot be read or holds no message at all.
    """

    def __init__(self, path: str | Path, file: BinaryIO | None = None) -> None:
        self.name = name_of(path)
        self.traffic = no_traffic()
        self._path = str(path)
        self._first_bad: int | None = None
        self._count = 0
        self._told = False
        self._damaged = False
        self._file = open_input(path, "log") if file is None else file

    def __iter__(self) -> Iterator[can.Message]:
        yield from self._messages()
        self.close()
        if not self._count and self._damaged:
            raise UserError(f"{self.name}: is damaged or was cut off, and no message can be read: give another log")
        if not self._count:
            raise UserError(
                f"{self.name}:1: the log holds no message like '(1.500000) can0 01000064#0011223344556677': "
                "give a log of candump, or an .asc, .blf, .csv, .db, .mcap, .mf4 or .trc file"
            )

    def close(self) -> None:
        """Close the file, which the end of the log does too, and tell what could not be read."""
        if self._path != STREAM:
            self._file.close()
        if self._told or not self._count:
            return
        self._told = True
        bad_lines = self.traffic[CORRUPT]
        if bad_lines:
            said = counted(bad_lines, "lines could not be read and were left out")
            tell(f"{self.name}: {said} (first: number {self._first_bad})")

    def _messages(self) -> Iterator[can.Message]:
        """Yield the messages of all channels, and count what else there is."""
        try:
            for number, frame in enumerate(frames(self._path, self._file), start=1):
                if isinstance(frame, can.Message):
                    self._count += 1
                    yield frame
                    continue
                self.traffic[frame] += 1
                if frame == CORRUPT:
                    self._first_bad = self._first_bad or number
        except DAMAGE:
            self._damaged = True
            if not self._count:
                return
            said = f"is damaged or was cut off behind {counted(self._count, 'messages')}"
            tell(f"{self.name}: {said}: what comes before is used")
        except OSError as error:
            kind = SystemFailure if self._count else UserError
            raise kind(f"{self.name}: the log cannot be read any further: {reason_of(error)}") from error


class CandumpWriter:
    """Writes a log of candump so that a crash loses nothing, and a power cut little (`RecordingFile`).

    Parameters
    ----------
    path, force
        As for `RecordingFile`.

    Raises
    ------
    UserError
        If the file cannot be made, or holds something already.
    """

    def __init__(self, path: str | Path, *, force: bool = False) -> None:
        self._file = RecordingFile(path, force=force)

    @property
    def failed(self) -> bool:
        """Whether the recording is not whole."""
        return self._file.failed

    def write(self, message: can.Message) -> None:
        """Append a message; `BrokenPipeError` if nobody reads stdout any more."""
        content = "R" if message.is_remote_frame else bytes(message.data).hex().upper()
        line = f"({message.timestamp:.6f}) {CHANNEL} {message.arbitration_id:08X}#{content}\n"
        self._file.write(line.encode())

    def close(self) -> None:
        """End the recording, of which the disk may fail to take the last part."""
        self._file.close()
