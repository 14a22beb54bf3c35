"""A growing MCAP file that can be opened at any moment: a crash costs what came in the last quarter of a second.

The Foxglove SDK packs messages into chunks. Here each chunk is ended four times a second and goes to the file at once,
in one piece, with an end behind it that makes the file a whole one, without an index; the next chunk is written over
that end. When the file is closed the SDK's own end with the index takes its place.
"""

from __future__ import annotations

import struct
import threading
import zlib
from pathlib import Path
from typing import Any

import foxglove
from foxglove.mcap import MCAPWriteOptions

from goldfield.files.now_and_then import NowAndThen
from goldfield.foxglove.channels import Channels
from goldfield.link.recording_file import FLUSH_S, RecordingFile
from goldfield.link.ros_frame import nanoseconds

MAGIC = b"\x89MCAP0\r\n"
_FOOTER = struct.pack("<BQQQ", 0x02, 20, 0, 0)  # no summary, no offsets of it
END = struct.pack("<BQI", 0x0F, 4, 0) + _FOOTER + struct.pack("<I", zlib.crc32(_FOOTER)) + MAGIC
"""The end of an MCAP file without an index: DataEnd, Footer and the magic bytes."""


class McapFile:
    """Writes messages on the topics of `goldfield.foxglove`; any thread may call it.

    Parameters
    ----------
    path : path
        ``-`` is stdout.
    force : bool
        Whether a file that holds something may be replaced, which the first message does.

    Raises
    ------
    UserError
        If the file cannot be made, or holds something already.
    """

    def __init__(self, path: str | Path, *, force: bool = False) -> None:
        self._file = RecordingFile(path, force=force)
        self._medium = _Medium(self._file)
        context = foxglove.Context()
        options = MCAPWriteOptions(profile="", disable_seeking=True, compression_threads=0)
        self._writer = foxglove.open_mcap(self._medium, context=context, writer_options=options)
        self._channels = Channels(context)
        self._lock = threading.Lock()  # the SDK calls back into Python: two threads in it could wait for each other
        self._filled = False
        self._flushing = NowAndThen(self.flush, FLUSH_S, f"flush {path}")

    @property
    def failed(self) -> bool:
        """Whether the recording is not whole."""
        return self._file.failed

    def log(self, topic: str, message: Any, arrived_s: float) -> None:
        """Append a message, as `Channels.log`; `BrokenPipeError` if nobody reads stdout any more."""
        with self._lock:
            self._channels.log(topic, message, arrived_s)
            self._filled = True
        self._medium.raise_error()

    def metadata(self, name: str, values: dict[str, str]) -> None:
        """Append a record of metadata."""
        with self._lock:
            self._writer.write_metadata(name, values)

    def attach(self, name: str, media_type: str, data: bytes, unix_s: float) -> None:
        """Append an attachment."""
        time_ns = nanoseconds(unix_s)
        with self._lock:
            self._writer.attach(log_time=time_ns, create_time=time_ns, name=name, media_type=media_type, data=data)

    def flush(self) -> None:
        """Hand what came to the system, which is done every `FLUSH_S` anyway."""
        with self._lock:
            if self._filled:
                self._writer.flush()

    def close(self) -> None:
        """Write the index and end the file, of which the disk may fail to take the last part."""
        self._flushing.end()
        with self._lock:
            self._medium.last, self._medium.empty = True, not self._filled
            self._writer.close()
            self._medium.flush()
        self._file.close()
        self._medium.raise_error()


class _Medium:
    """The file in the eyes of the SDK; nothing that fails here reaches it, and each flush is one write.

    Attributes
    ----------
    last : bool
        Whether the SDK's own end comes next.
    empty : bool
        Whether nothing is to be written, since no message came: an earlier file stays.
    """

    def __init__(self, file: RecordingFile) -> None:
        self.last = self.empty = False
        self._file = file
        self._parts: list[bytes] = []
        self._position = 0
        self._end = 0
        """Where the file ends but for `END`."""
        self._error: BrokenPipeError | None = None

    def write(self, data: bytes | bytearray) -> int:
        """Take a part of a chunk."""
        self._parts.append(bytes(data))
        self._position += len(data)
        return len(data)

    def seek(self, _offset: int, _whence: int = 0) -> int:
        """Return the position, which is all that the SDK asks of what cannot be sought in."""
        return self._position

    def flush(self) -> None:
        """Write what came, with an end behind it."""
        data = b"".join(self._parts)
        self._parts.clear()
        if not data or self.empty or self._error is not None:
            return
        try:
            if not self._file.rewritable:
                self._file.write(data)
            elif self._file.write(data if self.last else data + END, at=self._end):
                self._end += len(data)
            elif self._end:
                self._file.mend(END, at=self._end)
        except BrokenPipeError as error:
            self._error = error

    def raise_error(self) -> None:
        """Raise the `BrokenPipeError` of an earlier flush, once."""
        error, self._error = self._error, None
        if error is not None:
            self._parts.clear()
            raise error
