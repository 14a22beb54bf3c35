"""The name of a board: 16 ASCII characters in the four elements of its parameter ``name``."""

from __future__ import annotations

from collections.abc import Sequence

from goldfield.errors import UserError
from goldfield.link.requests import Value
from goldfield_protocol.parameters import PARAMETERS

NAME_IDS = tuple(PARAMETERS["name"].identifier(element) for element in range(PARAMETERS["name"].count))
"""Ids of the elements."""
LONGEST = 4 * len(NAME_IDS)


def words_of(name: str) -> list[int]:
    """Return the elements that hold a name; `UserError` for one that is too long or not printable ASCII.

    Examples
    --------
    >>> words_of("b1")
    [12642, 0, 0, 0]
    """
    if not (name.isascii() and (name.isprintable())) or len(name) > LONGEST:
        raise UserError(f"the name {name!r} is none: give up to {LONGEST} characters of ASCII")
    whole = name.encode().ljust(LONGEST, b"\0")
    return [int.from_bytes(whole[4 * i : 4 * i + 4], "little") for i in range(len(NAME_IDS))]


def name_of(words: Sequence[Value | None]) -> str:
    """Return the name that the elements hold; `words_of` inverts this.

    Examples
    --------
    >>> name_of(words_of("north wall, left"))
    'north wall, left'
    >>> name_of([None, None, None, None])
    ''
    """
    raw = b"".join(int(word or 0).to_bytes(4, "little") for word in words)
    return raw.split(b"\0")[0].decode("ascii", "replace")
