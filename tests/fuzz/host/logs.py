"""Recordings in each format that is told by its first bytes: every message is one, or the file is refused.

A message is a data frame of at most eight bytes, or a mark, whatever the file says; its time is a number.
"""

from __future__ import annotations

import math

from goldfield.link.marks import is_mark
from goldfield.link.recordings import CandumpReader
from goldfield.link.traffic import KINDS
from tests.fuzz.host.judging import answered, written

MOST_BYTES = 20_000


def one_input(data: bytes) -> None:
    """Read one file."""
    path = written(data[:MOST_BYTES], ".log")

    def read() -> None:
        reader = CandumpReader(path)
        for message in reader:
            assert is_mark(message) or len(message.data) <= 8
            assert 0 <= message.arbitration_id < 1 << 29
            assert math.isfinite(message.timestamp)
        assert set(reader.traffic) == set(KINDS)
        assert all(count >= 0 for count in reader.traffic.values())

    answered(read)
