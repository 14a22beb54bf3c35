"""Names of files with the time of the start in them: a service that starts again writes a new file each time."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self, overload

TIME = "{time}"
"""What stands in a name for the time."""
FORM = "%Y%m%dT%H%M%SZ"
"""Names of this form are in the order of time; the time is UTC, which never comes twice."""


class DatedNames:
    """The names of one start; a context manager that takes away the files that got nothing.

    A service whose board is not plugged in starts every few seconds, and would leave an empty file each time.

    Parameters
    ----------
    now_s : float
        The time, s since 1970.

    Examples
    --------
    >>> names = DatedNames(1_700_000_000.0)
    >>> names.of("{time}.mcap"), names.of("walk.mcap"), names.of(None)
    ('20231114T221320Z.mcap', 'walk.mcap', None)
    """

    def __init__(self, now_s: float) -> None:
        self._text = time.strftime(FORM, time.gmtime(now_s))
        self._made: list[Path] = []

    @overload
    def of(self, path: str) -> str: ...
    @overload
    def of(self, path: None) -> None: ...
    def of(self, path: str | None) -> str | None:
        """Return a path with the time in place of `TIME`."""
        if path is None or TIME not in path:
            return path
        name = path.replace(TIME, self._text)
        self._made.append(Path(name))
        return name

    def of_url(self, url: str) -> str:
        """Return the URL of a feed, as ``tum:{time}.txt``, with the time in it."""
        scheme, colon, rest = url.partition(":")
        return f"{scheme}{colon}{self.of(rest)}"

    def __enter__(self) -> Self:
        """Return the names themselves."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take away the files that are empty."""
        for path in self._made:
            with suppress(OSError, ValueError):
                if path.is_file() and path.stat().st_size == 0:
                    path.unlink()
