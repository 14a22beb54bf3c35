"""Files that a command writes: a mistyped option must not cost a file, nor a full disk or a crash what was written.

`check_outputs` is called before anything is opened, `check_writable` before long work. `OutputFile` is then the one way
in which a file is written:

- a table, a site or a picture is written beside its place and renamed at the end, so that it is there whole or not;
- a recording (``live``) grows in its place record by record, each handed to the system at once and to the disk within
  a second, and a record that a full disk tears is cut away.

In both the path ``-`` is stdout; what the program prints meanwhile goes to stderr.
"""

from __future__ import annotations

import errno
import fcntl
import io
import os
import stat
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, Self, TextIO

from goldfield.errors import SystemFailure, UserError
from goldfield.files.durable import Durable
from goldfield.files.inputs import STREAM, open_pipe_end, reason_of

STREAMS = {0: "stdin", 1: "stdout", 2: "stderr"}


def check_outputs(
    outputs: Mapping[str, str | Path | None], inputs: Mapping[str, str | Path | None], *, force: bool = False
) -> None:
    """Check that no file is written twice, or written and read, or replaced, before any of them is opened.

    Parameters
    ----------
    outputs, inputs : mapping of str to path or None
        The files by the option that names them; None or an empty path is an option that was not given, ``-`` stdout or
        stdin. Files into which stdout and stderr were redirected count as outputs, too. Whatever exists and is no
        regular file, such as ``/dev/null``, may be named more than once.
    force : bool
        Whether an output may replace a file that holds something.

    Raises
    ------
    UserError
        If an output is also an input or another output, or holds something already; if two inputs are stdin.

    Examples
    --------
    >>> check_outputs({"--fields": "room.toml"}, {"--site": "./room.toml"})
    Traceback (most recent call last):
    goldfield.errors.UserError: room.toml: is the file of --site and would be overwritten by --fields: give another
    """
    read = [_Named(option, str(path), 0) for option, path in inputs.items() if path]
    written = [_Named(option, str(path), 1) for option, path in outputs.items() if path]
    for stream, named in ((0, read), (1, written)):
        options = [one.option for one in named if one.path == STREAM]
        if len(options) > 1:
            raise UserError(f"{options[0]} and {options[1]} are both {STREAMS[stream]}: give a file for one of them")
    earlier = read.copy()
    for one in written:
        for other in earlier:
            if one.is_file_of(other):
                raise UserError(
                    f"{one.name}: is the file of {other.option} and would be overwritten by {one.option}: give another"
                )
        earlier.append(one)
    for stream in (1, 2):
        redirected = _Named(STREAMS[stream], STREAM, stream)
        for other in earlier:
            if (other.path != STREAM or other.stream != 1) and redirected.is_file_of(other):
                raise UserError(f"{other.name}: is the file of {other.option}, and {STREAMS[stream]} goes into it")
    for one in written:
        if not force and one.path != STREAM:
            _refuse_filled(one.path, one.option)


def check_writable(path: str | Path | None, what: str) -> None:
    """Check, before the work that leads to it, that a file can be written at its end.

    Parameters
    ----------
    path : path or None
        None and an empty path are an option that was not given.
    what : str
        What the file will hold, as for `OutputFile`.

    Raises
    ------
    UserError
        If the path is a directory, or in none that can be written, or no path.
    """
    if not path or str(path) == STREAM:
        return
    try:
        place = Path(os.path.realpath(path))
        try:
            is_directory = stat.S_ISDIR(place.stat().st_mode)
        except FileNotFoundError:
            is_directory = False
            reason = errno.ENOENT if not place.parent.is_dir() else errno.EACCES
            if not os.access(place.parent, os.W_OK):
                raise OSError(reason, os.strerror(reason)) from None
        if is_directory:
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    except (OSError, RuntimeError, ValueError) as error:  # a name that is too long, a zero byte in it
        raise UserError(f"{path}: {what} cannot be written: {reason_of(error)}") from error


@dataclass(frozen=True)
class _Named:
    """A file that an option names.

    Attributes
    ----------
    option, path : str
    stream : int
        File descriptor that ``-`` stands for.
    """

    option: str
    path: str
    stream: int

    @property
    def name(self) -> str:
        """Path for messages."""
        return STREAMS[self.stream] if self.path == STREAM else str(Path(self.path))

    def is_file_of(self, other: _Named) -> bool:
        """Tell whether the two are one regular file, by whatever name; a link has another."""
        first, second = (_status(one.stream if one.path == STREAM else one.path) for one in (self, other))
        if first is not None and second is not None:
            return stat.S_ISREG(first.st_mode) and (first.st_dev, first.st_ino) == (second.st_dev, second.st_ino)
        return STREAM not in (self.path, other.path) and _resolved(self.path) == _resolved(other.path)


def _resolved(path: str) -> str:
    return os.path.realpath(path) if "\0" not in path else path


def _status(place: int | str) -> os.stat_result | None:
    """Return what the system says of a path or an open stream; None if it is not there."""
    try:
        return os.fstat(place) if isinstance(place, int) else Path(place).stat()
    except (OSError, ValueError):
        return None


def _filled(path: str | Path) -> bool:
    """Tell whether a path is a regular file that holds something."""
    status = _status(str(path))
    return status is not None and stat.S_ISREG(status.st_mode) and status.st_size > 0


def _refuse_filled(path: str, option: str) -> None:
    if _filled(path):
        raise UserError(f"{path}: exists and is not empty: give a new file for {option}, or --force to overwrite it")


class OutputFile:
    """A file that is written record by record; as a context manager it is kept, or discarded if an error comes.

    Parameters
    ----------
    path : path
        ``-`` is stdout; a device or a pipe is written as it is.
    what : str
        What is written, for messages: "the fields".
    live : bool
        Whether the file grows in its place. Else it is written beside, and is in its place after `close`.
    force : bool
        Whether it may replace a file that holds something. A live file does so with its first record.

    Raises
    ------
    UserError
        If the file cannot be made, holds something already, or is being written by another program.
    """

    def __init__(self, path: str | Path, what: str, *, live: bool = False, force: bool = False) -> None:
        self.size = 0
        self._what = what
        self._name = str(path)
        self._live = live
        self._beside: Path | None = None
        self._stdout: TextIO | None = None
        self._durable: Durable | None = None
        if self._name == STREAM:
            self._name = "stdout"
            self._file = self._take_stdout()
            return
        if not force:
            _refuse_filled(self._name, what)
        try:
            self._place = Path(path).resolve()  # a link stays one, and what it points at is written
            self._file = self._open(force)
            if live and stat.S_ISREG(os.fstat(self._file.fileno()).st_mode):
                self._durable = Durable(self._file, self._place.parent)
        except UserError:
            raise
        except (OSError, RuntimeError, ValueError) as error:  # a loop of links, a zero byte in the path
            raise UserError(f"{self._name}: {what} cannot be written: {reason_of(error)}") from error

    def write(self, data: bytes, at: int | None = None) -> None:
        """Append a record, or write it over what stands at an offset of a file that is `rewritable`.

        Raises
        ------
        SystemFailure
            If the disk is full, gone or broken; what was written before stands, to the end of the last record.
        BrokenPipeError
            If nobody reads stdout any more.
        """
        try:
            if at is not None:
                self._file.seek(at)
            written = self._file.write(data)
            if written != len(data):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            if self._stdout is not None:
                self._file.flush()
            if self._durable is not None:
                self._durable.note()
        except BrokenPipeError:
            raise
        except OSError as error:
            with suppress(OSError):  # a device such as /dev/full cannot be cut
                self._file.truncate(self.size)
                self._file.seek(self.size)
            raise self._failure(error) from error
        self.size = self.size + len(data) if at is None else max(self.size, at + len(data))
        if at is not None:
            self._file.seek(self.size)
        if self._live:
            self._settle()

    @property
    def rewritable(self) -> bool:
        """Whether what was written can be written over: a regular file, neither a pipe nor stdout."""
        return self._stdout is None and stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)

    def close(self) -> None:
        """End the file and keep it; `SystemFailure` if it cannot be put in its place or on the disk."""
        if self._stdout is not None:
            sys.stdout, self._stdout = self._stdout, None
            return
        try:
            if self._beside is not None and not self._live:
                os.fsync(self._file.fileno())
                self._settle()
            durable, self._durable = self._durable, None
            if durable is not None:
                durable.close()
        except OSError as error:
            raise self._failure(error) from error
        finally:
            self.discard()

    def discard(self) -> None:
        """End the file; what is not in its place yet is dropped, and what was there before stays."""
        if self._stdout is not None:
            self.close()
        elif self._name != "stdout":
            with suppress(OSError):
                if self._durable is not None:
                    self._durable.close()
            with suppress(OSError):
                self._file.close()
            if self._beside is not None:
                self._beside.unlink(missing_ok=True)
                self._beside = None

    def __enter__(self) -> Self:
        """Return the file itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Keep the file, or discard it after an error."""
        self.close() if kind is None else self.discard()

    def _open(self, force: bool) -> BinaryIO:
        status = _status(str(self._place))
        if status is not None and stat.S_ISFIFO(status.st_mode):
            return open_pipe_end(self._place)
        if status is not None and not stat.S_ISREG(status.st_mode):
            return self._place.open("wb", buffering=0)
        if self._live and not _filled(self._place):
            return _locked(_opened_empty(self._place), self._name)
        if status is not None and not os.access(self._place, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        self._beside = self._place.with_name(f".{self._place.name[:200]}.{os.getpid()}.part")
        file = self._beside.open("wb", buffering=0)
        self._force = force
        if status is not None:
            os.fchmod(file.fileno(), stat.S_IMODE(status.st_mode))
        return file

    def _settle(self) -> None:
        """Rename the file into its place, if it is not there yet."""
        if self._beside is None:
            return
        if not self._force:
            _refuse_filled(str(self._place), self._what)  # another program may have been faster
        try:
            self._beside.replace(self._place)
        except OSError as error:
            raise self._failure(error) from error
        self._beside = None

    def _take_stdout(self) -> BinaryIO:
        """Return stdout, and let what is printed from now on go to stderr."""
        self._stdout = sys.stdout
        sys.stdout.flush()
        sys.stdout = sys.stderr
        return self._stdout.buffer

    def _failure(self, error: OSError) -> SystemFailure:
        return SystemFailure(f"{self._name}: {self._what} cannot be written: {reason_of(error)}")


def write_file(path: str | Path, data: bytes, what: str, *, force: bool = False) -> None:
    """Write a whole file at once; the parameters and errors are those of `OutputFile`."""
    with OutputFile(path, what, force=force) as file:
        file.write(data)


def holds(path: str | Path, data: bytes) -> bool:
    """Tell whether a regular file holds exactly these bytes: to write them again replaces nothing."""
    status = _status(str(path))
    if status is None or not stat.S_ISREG(status.st_mode) or status.st_size != len(data):
        return False
    with suppress(OSError):
        return Path(path).read_bytes() == data
    return False


def _opened_empty(place: Path) -> BinaryIO:
    """Open a file that holds nothing, or make it; one that another program fills meanwhile is not cut."""
    descriptor = os.open(place, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
    return io.FileIO(descriptor, "wb")


def _locked(file: BinaryIO, name: str) -> BinaryIO:
    """Claim a file for this program, as long as it is open."""
    try:
        fcntl.flock(file.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        file.close()
        raise UserError(f"{name}: another program is recording into it: give another file") from error
    except OSError:
        pass  # a file system without locks
    return file
