"""Lines of candump, in every spelling that it has: the log format of ``-l`` and ``-L``, and what it prints.

The log format is ``(1795817432.676801) can0 02000064#7C008011E10B0000``, printed is
`` (1795817432.676801)  can0  02000064   [8]  7C 00 80 11 E1 0B 00 00``; the time may be missing or a date (``-tA``),
count from zero (``-tz``) or from the line before (``-td``); ``-x`` adds a direction, ``-a`` letters, ``-c`` colours,
``-8`` the raw length. Identifiers of more than three digits are extended ones; leading zeros may be missing.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from enum import Enum, auto

import can

TIME = rb"\((?P<time>[^()]{1,40})\)"
LOGGED = re.compile(
    TIME + rb"\s+(?P<channel>\S{1,64})\s+(?P<id>[0-9A-Fa-f]{1,8})#(?P<data>\S*)(?:\s+[RTrt])?", re.ASCII
)
PRINTED = re.compile(
    rb"(?:" + TIME + rb"\s+)?(?P<channel>\S{1,64})\s+(?:[RT]X\s+\S\s+\S\s+)?(?P<id>[0-9A-Fa-f]{1,8})\s+"
    rb"(?:\[(?P<length>\d{1,2})\]|\{[0-9A-Fa-f]\})\s*(?P<data>.*)",
    re.ASCII,
)
LOGGED_DATA = re.compile(rb"(?P<bytes>(?:[0-9A-Fa-f]{2}\.?){0,8})(?:_[0-9A-Fa-f])?")
PRINTED_DATA = re.compile(rb"(?P<bytes>(?:[0-9A-Fa-f]{2}(?:\s+|$)){0,8})(?:'.*'?|ERRORFRAME.*)?", re.DOTALL)
COLOUR = re.compile(rb"\x1b\[[0-9;]*m")

STANDARD_DIGITS = 3
ERROR_FLAG, REMOTE_FLAG = 1 << 29, 1 << 30


class NoFrame(Enum):
    """What a line can be beside a message."""

    FOREIGN = auto()
    """A frame that goldfield does not use: 11-bit, remote, error, or of CAN FD."""
    UNREADABLE = auto()
    """No line of candump, or one that is torn."""


def parse(line: bytes) -> can.Message | NoFrame:
    """Return the message of a line, or why there is none.

    Examples
    --------
    >>> parse(b"(1.500000) can0 2000064#7C00").arbitration_id
    33554532
    >>> parse(b"  can0  7A1   [2]  11 22")
    <NoFrame.FOREIGN: 1>
    """
    line = COLOUR.sub(b"", line).strip()
    logged = LOGGED.fullmatch(line)
    found = logged or PRINTED.fullmatch(line)
    if found is None:
        return NoFrame.UNREADABLE
    time_s = _time_s(found["time"])
    if time_s is None:
        return NoFrame.UNREADABLE
    identifier, text = int(found["id"], 16), found["data"]
    if (
        len(found["id"]) <= STANDARD_DIGITS
        or identifier & (ERROR_FLAG | REMOTE_FLAG)
        or text[:1] in (b"#", b"R", b"r")  # FD, or remote
        or (logged is None and int(found["length"] or 0) > 8)
    ):
        return NoFrame.FOREIGN
    data = (LOGGED_DATA if logged else PRINTED_DATA).fullmatch(text)
    if data is None:
        return NoFrame.UNREADABLE
    content = bytes.fromhex(data["bytes"].replace(b".", b"").decode("ascii"))
    if logged is None and found["length"] is not None and len(content) != int(found["length"]):
        return NoFrame.UNREADABLE
    return can.Message(
        timestamp=time_s,
        arbitration_id=identifier & 0x1FFFFFFF,
        is_extended_id=True,
        data=content,
        channel=found["channel"].decode("ascii", "replace"),
    )


def _time_s(text: bytes | None) -> float | None:
    """Return the time of a line, 0 if it has none, None if it cannot be read."""
    if text is None:
        return 0.0
    try:
        if b":" in text or b"-" in text:
            return datetime.fromisoformat(text.strip().decode("ascii")).replace(tzinfo=UTC).timestamp()
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) < 1e12 else None
