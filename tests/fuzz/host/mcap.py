"""MCAP files behind their magic: records of any kind and length are read, or the file is refused in a sentence.

What is read is no larger than the file: a length that lies costs no memory.
"""

from __future__ import annotations

import math

from goldfield.link.mcap_records import MAGIC, McapRecords
from goldfield.link.recordings import CandumpReader
from tests.fuzz.host.judging import answered, written

MOST_BYTES = 20_000


def one_input(data: bytes) -> None:
    """Read one file, as a log and record by record."""
    content = data if data.startswith(MAGIC) else MAGIC + data
    path = written(content[:MOST_BYTES], ".mcap")

    def read() -> None:
        for message in CandumpReader(path):
            assert math.isfinite(message.timestamp)
            assert len(message.data) <= 8

    answered(read)
    with path.open("rb") as stream:
        records = McapRecords(str(path), stream)
        try:
            size = sum(len(logged.data) for logged in records)
        except Exception:  # as log_formats has it: whatever the reader raises tells of damage
            return
    assert size <= 100 * MOST_BYTES  # chunks may be compressed
