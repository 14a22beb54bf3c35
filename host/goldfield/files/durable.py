"""A growing file that survives a power cut: the system is told now and then to put it on the disk.

What a program writes is the system's at once and survives the end of the program, but stays in the memory of the
system for half a minute and more.
"""

from __future__ import annotations

import errno
import os
import threading
from pathlib import Path
from typing import BinaryIO

SYNC_S = 1.0
"""Time from one sync to the next, s: as much of a recording a power cut costs, and the time that the disk takes."""

NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.EROFS, errno.ENOSYS)
"""Errors of a file system that knows no sync."""


class Durable:
    """Syncs a file every `SYNC_S` in a thread of its own, so that a disk that takes long holds no writer up.

    Parameters
    ----------
    file : file
        Unbuffered, as long as this object is not closed.
    folder : path
        The file's folder, in which its name must survive, too.
    """

    def __init__(self, file: BinaryIO, folder: Path) -> None:
        self._file = file
        self._folder = folder
        self._written = False
        self._stop = threading.Event()
        self._error: OSError | None = None
        self._thread = threading.Thread(target=self._run, name=f"sync {file.name}", daemon=True)
        self._thread.start()

    def note(self) -> None:
        """Note that something was written; `OSError` if an earlier sync failed, which is raised once."""
        self._written = True
        self._raise_error()

    def close(self) -> None:
        """Sync what is left; `OSError` if that fails."""
        self._stop.set()
        self._thread.join()
        self._sync()
        self._raise_error()

    def _run(self) -> None:
        while not self._stop.wait(SYNC_S):
            self._sync()

    def _sync(self) -> None:
        if not self._written:
            return
        self._written = False  # before the sync: what is written during it is for the next one
        try:
            os.fdatasync(self._file.fileno())
            sync_folder(self._folder)
        except OSError as error:
            if error.errno not in NO_SYNC:
                self._error = error

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            raise error


def sync_folder(folder: Path) -> None:
    """See that the names in a folder are on the disk; `OSError` if they cannot be, of `NO_SYNC` where none is known."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
