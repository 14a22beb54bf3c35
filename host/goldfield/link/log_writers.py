"""Recordings in the formats of Vector's tools, .asc and .blf, as python-can writes them."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import can

from goldfield.files.now_and_then import NowAndThen
from goldfield.link.recording_file import FLUSH_S, RecordingFile

CONTAINER_BYTES = 4096
"""A .blf is packed in containers of so many bytes, 85 messages, or fewer where they come slowly."""


class _Text:
    """A text file in the eyes of python-can."""

    closed = False

    def __init__(self, file: RecordingFile) -> None:
        self._file = file

    def write(self, text: str) -> int:
        """Append a line."""
        self._file.write(text.encode())
        return len(text)

    def read(self) -> str:
        """Do nothing: python-can knows a file by it."""
        raise NotImplementedError

    def close(self) -> None:
        """Leave the file to who opened it."""


class _Binary:
    """A binary file in the eyes of python-can; what is written in parts becomes one record."""

    closed = False

    def __init__(self, file: RecordingFile) -> None:
        self._file = file
        self._parts: list[bytes] = []
        self._at: int | None = None

    def write(self, data: bytes) -> int:
        """Take a part of a record."""
        self._parts.append(bytes(data))
        return len(data)

    def settle(self) -> None:
        """Write the record."""
        if self._parts:
            self._file.write(b"".join(self._parts), self._at)
            self._parts.clear()
            self._at = None

    def seekable(self) -> bool:
        """Tell whether the header can be written again at the end."""
        return self._file.rewritable

    def seek(self, offset: int) -> int:
        """Go to where the header is written again."""
        self.settle()
        self._at = offset
        return offset

    def tell(self) -> int:
        """Return how long the file is."""
        self.settle()
        return self._file.size

    def read(self) -> bytes:
        """Do nothing: python-can knows a file by it."""
        raise NotImplementedError

    def close(self) -> None:
        """Write the last record; the file is left to who opened it."""
        self.settle()


class _LogWriter:
    """Writes a log by a writer of python-can, which begins with the first message: that one replaces an earlier file.

    Parameters
    ----------
    path, force
        As for `RecordingFile`, with its errors.
    """

    def __init__(self, path: str | Path, *, force: bool = False) -> None:
        self._file = RecordingFile(path, force=force)
        self._writer: can.ASCWriter | can.BLFWriter | None = None

    def _begun(self) -> can.ASCWriter | can.BLFWriter:
        """Return the writer of python-can."""
        raise NotImplementedError

    @property
    def failed(self) -> bool:
        """Whether the recording is not whole."""
        return self._file.failed

    def write(self, message: can.Message) -> None:
        """Append a message; `BrokenPipeError` if nobody reads stdout any more."""
        if self._writer is None:
            self._writer = self._begun()
        self._writer.on_message_received(message)

    def close(self) -> None:
        """End the recording, of which the disk may fail to take the last part."""
        if self._writer is not None:
            self._writer.stop()
        self._file.close()


class AscWriter(_LogWriter):
    """Writes an .asc, line by line, so that a crash loses nothing (`RecordingFile`)."""

    def _begun(self) -> can.ASCWriter:
        text: Any = _Text(self._file)
        return can.ASCWriter(text)


class BlfWriter(_LogWriter):
    """Writes a .blf; a crash costs what came in the last `FLUSH_S`, or since the last container was full."""

    def __init__(self, path: str | Path, *, force: bool = False) -> None:
        super().__init__(path, force=force)
        self._binary = _Binary(self._file)
        self._blf: can.BLFWriter | None = None
        self._error: BrokenPipeError | None = None
        self._lock = threading.Lock()
        self._flushing = NowAndThen(self.flush, FLUSH_S, f"flush {path}")

    def _begun(self) -> can.BLFWriter:
        binary: Any = self._binary
        self._blf = can.BLFWriter(binary, max_container_size=CONTAINER_BYTES)
        return self._blf

    def write(self, message: can.Message) -> None:
        """Append a message, as `_LogWriter.write`; a container that is full goes to the file as one record."""
        with self._lock:
            super().write(message)
            self._binary.settle()
            error, self._error = self._error, None
        if error is not None:
            raise error

    def flush(self) -> None:
        """End the container, however little it holds, which is done every `FLUSH_S` anyway."""
        with self._lock:
            if self._blf is None:
                return
            try:
                self._blf._flush()  # python-can offers nothing else: it ends a container that is full, and the last
                self._binary.settle()
            except BrokenPipeError as error:  # for the next message
                self._error = error

    def close(self) -> None:
        """End the recording, as `_LogWriter.close`."""
        self._flushing.end()
        super().close()
