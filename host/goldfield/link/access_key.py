"""The key of a site's boards, and its file; it imports little, as every command line may name one."""

from __future__ import annotations

import hmac
import os
import stat
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from goldfield.errors import UserError
from goldfield.files.inputs import reason_of

KEY_BYTES = 16
PURPOSE = b"goldfield access 1"


@dataclass(frozen=True)
class AccessKey:
    """A key, and the file that it is from; what is printed of it is the file.

    Examples
    --------
    >>> key = AccessKey(bytes(range(16)), "site.key")
    >>> key, key.words[0] == 0x03020100
    (AccessKey(file='site.key'), True)
    >>> hex(key.answer(1, bytes(12)))
    '0x7690a28828fb1f95'
    """

    raw: bytes = field(repr=False)
    file: str

    @property
    def words(self) -> list[int]:
        """The elements of the parameter ``access_key``."""
        return [int.from_bytes(self.raw[i : i + 4], "little") for i in range(0, KEY_BYTES, 4)]

    def answer(self, number: int, unique_id: bytes) -> int:
        """Return the answer of a board with this unique id to a challenge."""
        told = hmac.digest(self.raw, PURPOSE + unique_id + number.to_bytes(8, "little"), "sha512")
        return int.from_bytes(told[:8], "little")


def load_key(path: str | Path) -> AccessKey:
    """Read a key from its file.

    Raises
    ------
    UserError
        If it cannot be read, others can read it, or it holds no key.
    """
    try:
        with Path(path).open(encoding="ascii") as file:
            mode = os.fstat(file.fileno()).st_mode
            text = file.read(1000)
    except (OSError, ValueError) as error:  # bytes that are no ASCII, or a zero byte in the path
        reason = reason_of(error) if isinstance(error, OSError) else "is no file of a key"
        raise UserError(f"{path}: the key cannot be read: {reason}") from error
    if stat.S_ISREG(mode) and mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise UserError(f"{path}: others than you can read this key: chmod 600 {path}, and think of who has read it")
    digits = text.strip()
    try:
        raw = bytes.fromhex(digits)
    except ValueError:
        raw = b""
    if len(raw) != KEY_BYTES or not any(raw):
        raise UserError(
            f"{path}: holds no key, which is {2 * KEY_BYTES} hexadecimal digits: make one with goldfield nodes key make"
        )
    return AccessKey(raw, str(path))


def make_key(path: str | Path) -> AccessKey:
    """Make up a key, and write its file, which its owner alone can read.

    Raises
    ------
    UserError
        If there is a file already, which stays as it is, or it cannot be written.
    """
    import secrets  # of this one command alone
    import tempfile

    raw = secrets.token_bytes(KEY_BYTES)
    place = Path(path)
    written: str | None = None
    try:
        handle, written = tempfile.mkstemp(dir=place.parent, prefix=f".{place.name}.")  # for the owner alone
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(f"{raw.hex()}\n")
            file.flush()
            os.fsync(file.fileno())
        os.link(written, place)  # There it is whole, and it replaces nothing.
    except FileExistsError as error:
        raise UserError(f"{path}: is there already, and a key is never overwritten: give another file") from error
    except (OSError, ValueError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else str(error)
        raise UserError(f"{path}: the key cannot be written: {reason}") from error
    finally:
        if written is not None:
            with suppress(OSError):
                Path(written).unlink()
    return AccessKey(raw, str(path))
