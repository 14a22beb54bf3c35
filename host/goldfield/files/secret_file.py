"""Files that their owner alone may read, and that are never overwritten: keys."""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path

from goldfield.errors import SystemFailure, UserError
from goldfield.files.durable import NO_SYNC, sync_folder
from goldfield.files.inputs import read_bounded, reason_of

MODE = 0o600


def keep(path: str | Path, data: bytes, what: str) -> None:
    """Write a new file that nobody else may read, from its first byte on; it is there whole or not at all.

    Raises
    ------
    UserError
        There is such a file, which stays as it is, or it cannot be made there.
    SystemFailure
        The disk is full or broken; nothing is left of the file then.
    """
    try:
        place = Path(path).absolute()
        beside = place.with_name(f".{place.name[:200]}.{os.getpid()}.part")
        descriptor = os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, MODE)
    except (OSError, ValueError) as error:  # a zero byte in the path
        raise UserError(f"{path}: the {what} cannot be written: {reason_of(error)}") from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            os.fchmod(file.fileno(), MODE)
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.link(beside, place)  # Unlike a rename it fails if there is such a file.
        _sync(place.parent)
    except FileExistsError:
        raise UserError(
            f"{path}: exists, and a key is never overwritten, as boards may take no other: give a new file"
        ) from None
    except OSError as error:
        raise SystemFailure(f"{path}: the {what} cannot be written: {reason_of(error)}") from error
    finally:
        beside.unlink(missing_ok=True)


def read(path: str | Path, what: str, most: int) -> bytes:
    """Return what a file holds that nobody but its owner may use, or what comes from stdin or a pipe.

    Raises
    ------
    UserError
        The file is not there, is larger than ``most`` bytes, or others may read or write it.
    """
    data = read_bounded(path, what, most)
    with suppress(OSError):  # stdin, which is -
        mode = Path(path).stat().st_mode
        if stat.S_ISREG(mode) and mode & (stat.S_IRWXG | stat.S_IRWXO):
            raise UserError(
                f"{path}: others may read or write this {what}: chmod 600 {path}, and think of who has read it"
            )
    return data


def _sync(folder: Path) -> None:
    try:
        sync_folder(folder)
    except OSError as error:
        if error.errno not in NO_SYNC:
            raise
