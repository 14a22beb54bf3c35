"""The records of an MCAP file, and the frames of CAN among them, in the order in which they were written."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO

import can

from goldfield.errors import UserError, tell
from goldfield.link.ros_frame import NANOSECONDS, SCHEMA_NAME, unpacked

MAGIC = b"\x89MCAP0\r\n"
LARGEST_RECORD = 256 * 2**20
"""Bytes; a length above tells of damage, and not of so much memory that is needed."""
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
        self._records = StreamReader(stream, validate_crcs=True, record_size_limit=LARGEST_RECORD).records

    def __iter__(self) -> Iterator[Logged]:
        """Yield the messages; whatever the reader raises tells that the rest cannot be read."""
        schemas: dict[int, str] = {0: ""}
        channels: dict[int, Any] = {}
        record: Any  # each kind has its own attributes
        for record in self._records:
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
