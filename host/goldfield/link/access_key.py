"""The key of a site's boards, and its file; it imports little, as every command line may name one."""

from __future__ import annotations

import hmac
from dataclasses import dataclass, field
from pathlib import Path

from goldfield.errors import UserError
from goldfield.files import secret_file

KEY_BYTES = 16
PURPOSE = b"goldfield access 1"
WHAT = "key"
MOST_BYTES = 1000
"""More than any file of a key has."""


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
    text = secret_file.read(path, WHAT, MOST_BYTES)
    try:
        raw = bytes.fromhex(text.decode("ascii").strip())
    except ValueError:
        raw = b""
    if len(raw) != KEY_BYTES or not any(raw):
        raise UserError(
            f"{path}: holds no key, which is {2 * KEY_BYTES} hexadecimal digits: make one with goldfield nodes key make"
        )
    return AccessKey(raw, str(path))


def make_key(path: str | Path) -> AccessKey:
    """Make up a key, and write its file; the errors are those of `goldfield.files.secret_file.keep`."""
    import secrets  # of this one command alone

    raw = secrets.token_bytes(KEY_BYTES)
    secret_file.keep(path, f"{raw.hex()}\n".encode(), WHAT)
    return AccessKey(raw, str(path))
