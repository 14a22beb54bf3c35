"""Lines of candump, in every spelling that it has: the log format of ``-l`` and ``-L``, and what it prints.

The log format is ``(1795817432.676801) can0 02000064#7C008011E10B0000``, printed is
`` (1795817432.676801)  can0  02000064   [8]  7C 00 80 11 E1 0B 00 00``; the time may be missing or a date (``-tA``),
count from zero (``-tz``) or from the line before (``-td``); ``-x`` adds a direction, ``-a`` letters, ``-c`` colours,
``-8`` the raw length. Identifiers of more than three digits are extended ones; leading zeros may be missing.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime

import can

from goldfield.link.marks import is_mark
from goldfield.link.traffic import CORRUPT, ELEVEN_BIT, ERROR, FD, REMOTE

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
LONGEST = 8
"""Bytes of a frame that is not one of CAN FD."""
ERROR_FLAG, REMOTE_FLAG = 1 << 29, 1 << 30


def parse(line: bytes) -> can.Message | str:
    """Return the message of a line, or what it is in its place: a kind of `goldfield.link.traffic`.

    A message is a data frame or a mark (`goldfield.link.marks`). A line that is none of candump's, or torn, is
    `CORRUPT`.

    Examples
    --------
    >>> parse(b"(1.500000) can0 2000064#7C00").arbitration_id
    33554532
    >>> parse(b"  can0  7A1   [2]  11 22")
    'frames with 11-bit identifiers'
    """
    line = COLOUR.sub(b"", line).strip()
    logged = LOGGED.fullmatch(line)
    found = logged or PRINTED.fullmatch(line)
    if found is None:
        return CORRUPT
    time_s = _time_s(found["time"])
    if time_s is None:
        return CORRUPT
    identifier, text = int(found["id"], 16), found["data"]
    if identifier & ERROR_FLAG:
        return ERROR
    if text.startswith(b"#") or (logged is None and int(found["length"] or 0) > LONGEST):
        return FD
    if len(found["id"]) <= STANDARD_DIGITS:
        return ELEVEN_BIT
    if identifier & REMOTE_FLAG or text[:1] in (b"R", b"r"):
        return _remote(time_s, identifier, found["channel"])
    data = (LOGGED_DATA if logged else PRINTED_DATA).fullmatch(text)
    if data is None:
        return CORRUPT
    content = bytes.fromhex(data["bytes"].replace(b".", b"").decode("ascii"))
    if logged is None and found["length"] is not None and len(content) != int(found["length"]):
        return CORRUPT
    return can.Message(
        timestamp=time_s,
        arbitration_id=identifier & 0x1FFFFFFF,
        is_extended_id=True,
        data=content,
        channel=found["channel"].decode("ascii", "replace"),
    )


def _remote(time_s: float, identifier: int, channel: bytes) -> can.Message | str:
    """Return a remote frame that is a mark; any other is of the kind `REMOTE`."""
    message = can.Message(
        timestamp=time_s,
        arbitration_id=identifier & 0x1FFFFFFF,
        is_extended_id=True,
        is_remote_frame=True,
        channel=channel.decode("ascii", "replace"),
    )
    return message if is_mark(message) else REMOTE


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
