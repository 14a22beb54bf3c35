"""Formats of CAN logs, told apart by their first bytes, and their messages: candump's own, and those of python-can."""

from __future__ import annotations

import base64
import codecs
import gzip
import io
import logging
import sys
import zlib
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO, cast

import can

from goldfield.errors import UserError
from goldfield.files.inputs import STREAM
from goldfield.link.candump import LONGEST, parse
from goldfield.link.marks import is_mark
from goldfield.link.mcap_records import MAGIC, frames_of
from goldfield.link.traffic import CORRUPT, ERROR, FD, kind_of

HEAD = 256
"""Bytes at the begin of a file that tell its format."""

LONGEST_LINE = 1000
"""Bytes; candump prints 64 of a CAN FD frame in 250."""

LARGEST_IDENTIFIER = 0x1FFFFFFF
LARGEST_TIME_S = 1e12
"""Beyond any time since 1970; false for what is not a number."""

PATIENCE = 4_000_000
"""Bytes without any message after which a file, or /dev/zero, is no log."""

PADDING = 3
"""Most bytes between two containers of a .blf, which some programs leave out behind the last."""

UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)

Frames = Iterator[can.Message | str]


class _Damaged(Exception):
    """The rest of a file cannot be read."""


DAMAGE = (_Damaged, EOFError, zlib.error, gzip.BadGzipFile, UnicodeError)
"""What reading raises where a file is damaged or torn."""


def frames(path: str, file: BinaryIO) -> Frames:
    """Yield the messages of a log of any format, and for whatever else is in it its kind, as `candump.parse`.

    Parameters
    ----------
    path : str
        Where the file is; ``-`` is stdin.
    file : file
        The same, open to be read.

    Raises
    ------
    UserError
        If the format needs a package that is not installed, or a file in place of a stream.
    DAMAGE
        Where the rest cannot be read.
    """
    stream = cast(io.BufferedReader, file)
    packed = stream.peek(HEAD)[:2] == b"\x1f\x8b"
    if packed:
        stream = io.BufferedReader(gzip.GzipFile(fileobj=stream))
    head = stream.peek(HEAD)[:HEAD]
    if head.startswith(b"LOGG"):
        return _of_blf(stream)
    if head.startswith(b"SQLite format 3\0"):
        _need_file(path, packed, "a database")
        return _of_reader(lambda: can.SqliteReader(path))
    if head.startswith(b"MDF "):
        _need_file(path, packed, "an MF4 file")
        return _of_reader(lambda: _mf4_reader(path))
    if head.startswith(MAGIC):
        return _of_reader(lambda: frames_of(path, stream))
    encoding = "utf-16" if head.startswith(UTF_16) else "utf-8-sig"
    text = head.decode(encoding, "ignore").lstrip().lower()
    if text.startswith("date "):
        return _of_lines(stream, encoding, can.ASCReader)
    if text.startswith((";$fileversion", ";   ", ";#####")):
        return _of_lines(stream, encoding, can.TRCReader)
    if text.startswith("timestamp,arbitration_id"):
        return _of_csv(stream, encoding)
    return _of_candump(stream, encoding)


def _need_file(path: str, packed: bool, what: str) -> None:
    if packed or path == STREAM:
        raise UserError(f"{path}: holds {what}, which cannot be read from a stream: unpack it into a file first")


def _mf4_reader(path: str) -> can.MF4Reader:
    sys.unraisablehook = _told_unless_asammdf
    try:
        return can.MF4Reader(path)
    except NotImplementedError as error:
        raise UserError(
            f"{path}: an MF4 file needs the package asammdf: install it with pip install 'goldfield[mf4]'"
        ) from error


def _told_unless_asammdf(unraisable: sys.UnraisableHookArgs) -> None:
    """Tell an error in a destructor, but of asammdf, whose half-open files of what is damaged fail in theirs."""
    if not str(getattr(unraisable.object, "__module__", "")).startswith("asammdf"):
        sys.__unraisablehook__(unraisable)


class _Measured:
    """A binary file in the eyes of python-can, which takes a part of a container, cut off, for all of it."""

    closed = False

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.size = 0
        self.torn = False

    def read(self, size: int) -> bytes:
        """Return so many bytes, or what is left, and note where that is a part of them."""
        data = self._stream.read(size)
        self.size += len(data)
        self.torn = self.torn or (size > PADDING and 0 < len(data) < size)
        return data

    def close(self) -> None:
        """Leave the file to who opened it."""


def _of_blf(stream: BinaryIO) -> Frames:
    """Yield the messages of a .blf; it is torn amid a container, or where less is left than its header says."""
    measured: Any = _Measured(stream)
    told: list[int] = []

    def reader() -> can.BLFReader:
        opened = can.BLFReader(measured)
        told.append(opened.file_size)
        return opened

    yield from _of_reader(reader)
    if measured.torn or measured.size < told[0]:
        raise _Damaged


def _of_reader(make: Callable[[], Any]) -> Frames:
    """Yield the messages of a binary format; what python-can's reader raises ends it."""
    try:
        with make() as reader:
            for message in reader:
                yield _kind_of(message) or message
    except UserError:
        raise
    except Exception as error:  # each format raises its own kinds at what is torn
        raise _Damaged from error


def _kind_of(message: can.Message) -> str | None:
    """Return the kind of a frame that is no message of ours; what a format does not check is checked here.

    Some formats do not tell that a frame is of CAN FD, and the readers of text take numbers of any size.
    """
    if not 0 <= message.arbitration_id <= LARGEST_IDENTIFIER or not abs(message.timestamp) < LARGEST_TIME_S:
        return CORRUPT
    if is_mark(message):
        return None
    return FD if len(message.data) > LONGEST else kind_of(message)


def _of_candump(stream: BinaryIO, encoding: str) -> Frames:
    barren = 0
    frame: can.Message | str = CORRUPT
    for line in _lines(stream, encoding):
        if line.strip() and not (frame == ERROR and line[:1] == b"\t"):  # candump -e explains an error frame
            frame = parse(line)
            yield frame
            barren = -PATIENCE if isinstance(frame, can.Message) else barren + len(line)
        if barren > PATIENCE:
            return


def _lines(stream: BinaryIO, encoding: str) -> Iterator[bytes]:
    """Yield lines; one without an end, as of /dev/zero, comes in pieces."""
    if encoding == "utf-16":
        text = io.TextIOWrapper(stream, encoding="utf-16", errors="replace", newline="\n")
        yield from (line.encode("ascii", "replace") for line in iter(lambda: text.readline(LONGEST_LINE), ""))
        return
    first = stream.readline(LONGEST_LINE).removeprefix(codecs.BOM_UTF8)
    if first:
        yield first
        yield from iter(lambda: stream.readline(LONGEST_LINE), b"")


class _TextLines:
    """Lines for a text reader of python-can, which begins again behind a line that it cannot read.

    A last line without an end is torn, and left out: python-can would read half of its last byte as a whole one.
    """

    def __init__(self, text: Iterator[str]) -> None:
        self._text = text
        self._first: str | None = None
        self.taken = 0
        self.torn = False

    def read(self) -> str:
        """Make this a file in the eyes of python-can."""
        raise NotImplementedError

    write = read

    def close(self) -> None:
        """Leave the file to who opened it."""

    def begin_again(self) -> None:
        """Give an empty line first, which a reader takes for the header."""
        self._first = "\n"

    def __iter__(self) -> _TextLines:
        return self

    def __next__(self) -> str:
        if self._first is not None:
            first, self._first = self._first, None
            return first
        line = next(self._text)
        self.taken += 1
        if not line.endswith("\n"):
            self.torn = True
            raise StopIteration
        return line


def _of_lines(stream: BinaryIO, encoding: str, make: Callable[[Any], Any]) -> Frames:
    """Yield the messages of a text format of python-can; a line that its reader cannot read costs that line.

    A reader that fails again before it takes another line, for want of what only the header could have told, reads none
    of the lines that follow.
    """
    text = io.TextIOWrapper(stream, encoding=encoding, errors="replace")
    lines = _TextLines(iter(lambda: text.readline(LONGEST_LINE), ""))
    reader = make(lines)
    while True:
        before = lines.taken
        try:
            for message in reader:
                yield _kind_of(message) or message
            if lines.torn:
                yield CORRUPT
            return
        except (ValueError, IndexError, KeyError, TypeError, OverflowError) as error:
            yield CORRUPT
            if lines.taken == before:
                raise _Damaged from error
            lines.begin_again()


def _of_csv(stream: BinaryIO, encoding: str) -> Frames:
    """Yield the messages of python-can's CSV; each line stands for itself."""
    text = io.TextIOWrapper(stream, encoding=encoding, errors="replace", newline="\n")
    text.readline(LONGEST_LINE)
    for line in iter(lambda: text.readline(LONGEST_LINE), ""):
        cells = line.strip().split(",")
        if cells == [""]:
            continue
        try:
            time_s, identifier, extended, remote, error, length, data = cells
            message = can.Message(
                timestamp=float(time_s),
                arbitration_id=int(identifier, 16),
                is_extended_id=extended == "1",
                is_remote_frame=remote == "1",
                is_error_frame=error == "1",
                dlc=int(length),
                data=base64.b64decode(data, validate=True) if remote != "1" else None,
                check=True,
            )
        except ValueError:
            yield CORRUPT
            continue
        yield _kind_of(message) or message


logging.getLogger("can.io").addHandler(logging.NullHandler())  # what a reader leaves out is counted here
