"""What a live run lets go when it falls behind, so that poses stay those of now."""

from __future__ import annotations

import math
from collections.abc import Callable

LIMIT_S = 0.2
"""What has waited for longer since it arrived is let go: poses are never much older, however slow the machine is."""


class Backlog:
    """Tells what is let go, and counts it.

    Parameters
    ----------
    now : callable
        Returns the time of the clock that arrivals are told by; None: nothing is ever let go, as in a recording.

    Attributes
    ----------
    skipped : int
        Blocks of chips, or poses of the sensor itself, that were let go.

    Examples
    --------
    >>> backlog = Backlog(lambda: 100.0)
    >>> [backlog.lets_go(arrived_s) for arrived_s in (99.7, 99.9)], backlog.skipped
    ([True, False], 1)
    """

    def __init__(self, now: Callable[[], float] | None) -> None:
        self._now = now
        self.skipped = 0

    def lets_go(self, arrived_s: float) -> bool:
        """Tell whether what arrived at a time has waited for too long; one that is not known is now."""
        if self._now is None or math.isnan(arrived_s) or self._now() - arrived_s <= LIMIT_S:
            return False
        self.skipped += 1
        return True
