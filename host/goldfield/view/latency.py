"""How late poses are on this machine: from the arrival of the last message that one needs to its line on stdout."""

from __future__ import annotations

import math
import time
from collections import Counter
from typing import Any

STEP = 1.02
"""Ratio of the bounds of a class: a quantile is told to 1 %, whatever the number of poses."""

SHARES = {"median": 0.5, "p95": 0.95, "p99": 0.99}
"""The quantiles that are told."""


class Spread:
    """Takes times, of which it tells quantiles; what it needs of memory does not grow with their number.

    Attributes
    ----------
    count : int
    most : float
        The longest, s.

    Examples
    --------
    >>> spread = Spread()
    >>> for milliseconds in range(1, 101):
    ...     spread.add(1e-3 * milliseconds)
    >>> {name: 0.98 < value / (0.1 * SHARES[name]) < 1.02 for name, value in spread.quantiles().items()}, spread.most
    ({'median': True, 'p95': True, 'p99': True}, 0.1)
    """

    def __init__(self) -> None:
        self.count = 0
        self.most = 0.0
        self._classes: Counter[int] = Counter()

    def add(self, seconds: float) -> None:
        """Take the next time; where a clock that was set back made it negative it counts as none."""
        self.count += 1
        self.most = max(self.most, seconds)
        self._classes[math.floor(math.log(max(seconds, 1e-6), STEP))] += 1

    def quantiles(self) -> dict[str, float]:
        """Return the time, s, that each of the `SHARES` of them does not exceed; empty if there are none."""
        found: dict[str, float] = {}
        below = 0
        for number, count in sorted(self._classes.items()):
            below += count
            middle = STEP ** (number + 0.5)
            found |= {n: middle for n, share in SHARES.items() if n not in found and below >= share * self.count}
        return found


class Latency:
    """Takes how late each pose is by the clock, and how long this process computed meanwhile.

    The clock has in it what else the machine does; the processor time of this process, all its threads together, is
    what the machine would need that has nothing else to do, and one processor.

    Attributes
    ----------
    late : Spread
        From the arrival of the last message to the line.
    work : Spread
        What this process computed from taking that message to the line.
    """

    def __init__(self) -> None:
        self.late, self.work = Spread(), Spread()
        self._begin_s, self._begin_cpu_s = time.monotonic(), time.process_time()

    @property
    def count(self) -> int:
        """How many poses there were."""
        return self.late.count

    def add(self, seconds: float, work_s: float = math.nan) -> None:
        """Take the next pose: how late it is, and the processor time that it took, NaN if that is not known."""
        self.late.add(seconds)
        if math.isfinite(work_s):
            self.work.add(work_s)

    @property
    def processor_share(self) -> float:
        """What this process has taken of one processor since it began to look, 1 for a whole one."""
        elapsed_s = time.monotonic() - self._begin_s
        return (time.process_time() - self._begin_cpu_s) / elapsed_s if elapsed_s > 0.0 else math.nan

    def text(self) -> str:
        """Return one line, of poses that there are."""
        work = f" ({_told(self.work)} of it computing)" if self.work.count else ""
        return f"from the last message to the line: {_told(self.late)}{work}; {self._share} of a processor"

    @property
    def _share(self) -> str:
        return f"{100.0 * self.processor_share:.0f} %"

    def record(self) -> dict[str, Any]:
        """Return the same for JSON, in seconds."""
        return {
            **_record(self.late),
            "processor_share": self.processor_share,
            "work": _record(self.work) if self.work.count else None,
        }


def _told(spread: Spread) -> str:
    """Return quantiles as words."""
    median, most, nearly_all = (f"{value * 1e3:.2f} ms" for value in spread.quantiles().values())
    return f"median {median}, 95 % within {most}, 99 % within {nearly_all}"


def _record(spread: Spread) -> dict[str, float]:
    """Return quantiles for JSON."""
    return {**{f"{name}_s": value for name, value in spread.quantiles().items()}, "most_s": spread.most}
