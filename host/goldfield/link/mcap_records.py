"""The records of an MCAP file, and the frames of CAN among them, in the order in which they were written."""

from __future__ import annotations

import contextlib
import io
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, BinaryIO

import can

from goldfield.errors import UserError, counted, tell
from goldfield.link.ros_frame import NANOSECONDS, SCHEMA_NAME, unpacked

MAGIC = b"\x89MCAP0\r\n"
LARGEST_RECORD = 256 * 2**20
"""Bytes; a length above tells of damage, and not of so much memory that is needed."""
FREE_EXPANSION, MOST_EXPANSION = 16 * 2**20, 50
"""The chunks of a file make no more than so many bytes, and so many more a byte of theirs: 50 kB can make gigabytes."""
PIECE = 2**20
"""Bytes that are unpacked at a time."""
MOST_TOPICS = 5
"""Topics of a foreign file that are named."""


@dataclass(frozen=True)
class Logged:
    """One message of the file.

    Attributes
    ----------
    topic, schema, encoding : str
        Name of the topic, of its schema, and the encoding of its messages.
    arrived_s : float
        Its log time, s since 1970.
    data : bytes
    """

    topic: str
    schema: str
    encoding: str
    arrived_s: float
    data: bytes


class McapRecords:
    """Reads a file from its begin, whether it has an index or not.

    Parameters
    ----------
    path : str
        For messages.
    stream : file
        Open to be read, at its begin.

    Attributes
    ----------
    topics : dict of str to str
        The schema of each topic that was met so far.
    metadata : dict of str to dict
        The metadata that was met so far, by name.
    attachments : dict of str to bytes
        The attachments that were met so far, by name.
    ended : bool
        Whether the file was closed as it should be; known at its end.

    Raises
    ------
    UserError
        If the package that reads MCAP is not installed.
    """

    def __init__(self, path: str, stream: BinaryIO) -> None:
        try:
            from mcap.stream_reader import StreamReader
        except ModuleNotFoundError as error:
            raise UserError(
                f"{path}: an MCAP file needs the package mcap: install it with pip install 'goldfield[mcap]'"
            ) from error
        self.topics: dict[str, str] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.attachments: dict[str, bytes] = {}
        self.ended = False
        self._most = FREE_EXPANSION
        self._records = StreamReader(
            _Bounded(stream),  # type: ignore[arg-type]
            emit_chunks=True,
            validate_crcs=True,
            record_size_limit=LARGEST_RECORD,
        ).records

    def __iter__(self) -> Iterator[Logged]:
        """Yield the messages; whatever the reader raises tells that the rest cannot be read."""
        schemas: dict[int, str] = {0: ""}
        channels: dict[int, Any] = {}
        record: Any  # each kind has its own attributes
        for record in self._unpacked():
            kind = type(record).__name__
            if kind == "Message":
                channel = channels[record.channel_id]
                yield Logged(
                    channel.topic,
                    schemas[channel.schema_id],
                    channel.message_encoding,
                    record.log_time / NANOSECONDS,
                    record.data,
                )
            elif kind == "Schema":
                schemas[record.id] = record.name
            elif kind == "Channel":
                channels[record.id] = record
                self.topics[record.topic] = schemas[record.schema_id]
            elif kind == "Metadata":
                self.metadata[record.name] = record.metadata
            elif kind == "Attachment":
                self.attachments[record.name] = record.data
            elif kind == "Footer":
                self.ended = record.summary_start != 0

    def _unpacked(self) -> Iterator[Any]:
        """Yield the records, those of a chunk in its place."""
        from mcap.records import Chunk
        from mcap.stream_reader import breakup_chunk

        for record in self._records:
            if not isinstance(record, Chunk):
                yield record
                continue
            self._most += MOST_EXPANSION * len(record.data)
            data = _unpacked(record.compression, record.data, self._most)
            self._most -= len(data)
            plain = replace(record, compression="", data=data, uncompressed_size=len(data))
            yield from breakup_chunk(plain, validate_crc=True)


class _Bounded:
    """A stream of which no read asks for more than is left of a file: what is asked for is memory at once.

    Of what has no end to look for, as a pipe, a read asks for no more than a record may have.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._left: int | None = None
        with contextlib.suppress(OSError, ValueError):  # it cannot seek
            begin = stream.tell()
            self._left = stream.seek(0, os.SEEK_END) - begin
            stream.seek(begin)

    def read(self, length: int) -> bytes:
        """Return as many bytes, or what there is."""
        data = self._stream.read(min(length, LARGEST_RECORD if self._left is None else self._left))
        if self._left is not None:
            self._left -= len(data)
        return data


def _unpacked(compression: str, data: bytes, most: int) -> bytes:
    """Return the bytes of a chunk.

    Raises
    ------
    ValueError
        If they are more than may be.
    """
    packed, pieces, left = io.BytesIO(data), [], most
    if compression == "zstd":
        import zstandard

        source: Any = zstandard.ZstdDecompressor().stream_reader(packed)
    elif compression == "lz4":
        import lz4.frame

        source = lz4.frame.LZ4FrameFile(packed)
    else:
        source = packed
    while piece := source.read(PIECE):
        pieces.append(piece)
        left -= len(piece)
        if left < 0:
            raise ValueError(f"a chunk of {counted(len(data), 'bytes')} makes more than {most}")
    return b"".join(pieces)


def frames_of(path: str, stream: BinaryIO) -> contextlib.AbstractContextManager[Iterator[can.Message]]:
    """Return the frames of CAN of a file, as a reader of python-can's has them.

    Raises
    ------
    UserError
        As for `McapRecords`; while reading, if the file has topics and none with frames of CAN.
    """
    return contextlib.nullcontext(_frames(path, McapRecords(path, stream)))


def _frames(path: str, records: McapRecords) -> Iterator[can.Message]:
    for logged in records:
        if logged.schema == SCHEMA_NAME and logged.encoding == "cdr":
            yield unpacked(logged.data)
    if SCHEMA_NAME not in records.topics.values():
        raise UserError(f"{path}: {no_topic(records)}: give a recording that goldfield run --record made")
    if not records.ended:
        tell(f"{path}: was not ended, as when a program is killed: what came in its last second may be missing")


def no_topic(records: McapRecords, what: str = "messages of CAN") -> str:
    """Return that a file has not what is looked for, and what it has."""
    names = sorted(records.topics)
    shown = ", ".join(names[:MOST_TOPICS]) + (" ..." if len(names) > MOST_TOPICS else "")
    return f"holds no {what}" + (f", but {shown}" if names else ", and nothing else")
