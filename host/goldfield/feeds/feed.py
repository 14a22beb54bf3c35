"""What a feed is: it takes poses from a thread of its own, and may be as slow as its consumers are."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from goldfield.feeds.stamped import StampedPose
from goldfield.site import Site

Clock = Callable[[], float]
"""Returns the time by the wall clock, s since 1970."""


class Feed(Protocol):
    """Sends poses somewhere.

    Attributes
    ----------
    whole : bool
        Whether it is to get every pose of a recording, however long that takes: a file is.
    """

    whole: bool

    @property
    def dropped(self) -> int:
        """How many messages consumers have missed, beyond the poses that this feed did not get."""
        ...

    def write(self, stamped: StampedPose, /) -> None:
        """Send the next pose; it may block."""
        ...

    def close(self) -> None:
        """End, within seconds; nothing is written afterwards."""
        ...


@dataclass(frozen=True)
class Setting:
    """What a feed may need to know of the run.

    Attributes
    ----------
    site : Site
    force : bool
        Whether files that hold something may be overwritten.
    clock : callable
    """

    site: Site
    force: bool = False
    clock: Clock = time.time
