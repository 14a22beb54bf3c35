"""What a live run lets go when it falls behind, so that poses stay those of now."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

LIMIT_S = 0.2
"""What has waited for longer since it arrived is let go: poses are never much older, however slow the machine is."""

CAUGHT_UP_S = 0.05
"""It is let go until what comes has waited no longer than this: blocks of ten messages are lost as a whole, not each
for one of them."""

AT_FIRST_S = 2.0
"""The limit until the run has been in time once: what came while the sensor was looked for is worked off first."""


class Backlog:
    """Tells what is let go, and counts it.

    Parameters
    ----------
    now : callable, optional
        Returns the time of the clock that arrivals are told by; None: the wall clock.

    Attributes
    ----------
    let_go : int
        Messages that were let go.

    Examples
    --------
    >>> backlog = Backlog(lambda: 100.0)
    >>> [backlog.lets_go(arrived_s) for arrived_s in (98.1, 99.96, 99.9, 99.7, 99.9, 99.96)], backlog.let_go
    ([False, False, False, True, True, False], 2)
    """

    def __init__(self, now: Callable[[], float] | None = None) -> None:
        self._now = time.time if now is None else now
        self._behind, self._limit_s = False, AT_FIRST_S
        self.let_go = 0
        self._told = 0

    def lets_go(self, arrived_s: float) -> bool:
        """Tell whether what arrived at a time is let go; never if the time is not known, NaN."""
        if math.isnan(arrived_s):
            return False
        waited_s = self._now() - arrived_s
        if waited_s <= CAUGHT_UP_S:
            self._limit_s = LIMIT_S
        self._behind = waited_s > (CAUGHT_UP_S if self._behind else self._limit_s)
        self.let_go += self._behind
        return self._behind

    def broke(self) -> bool:
        """Tell whether anything was let go since the last call."""
        before, self._told = self._told, self.let_go
        return self.let_go > before
