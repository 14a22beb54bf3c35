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


class Latency:
    """Takes the latency of each pose; what it needs of memory does not grow with them.

    Examples
    --------
    >>> latency = Latency()
    >>> for milliseconds in range(1, 101):
    ...     latency.add(1e-3 * milliseconds)
    >>> {name: 0.98 < value / (0.1 * SHARES[name]) < 1.02 for name, value in latency.quantiles().items()}
    {'median': True, 'p95': True, 'p99': True}
    """

    def __init__(self) -> None:
        self.count = 0
        self._classes: Counter[int] = Counter()
        self._begin_s, self._begin_cpu_s = time.monotonic(), time.process_time()

    def add(self, seconds: float) -> None:
        """Take the latency of the next pose; where a clock that was set back made it negative it counts as none."""
        self.count += 1
        self._classes[math.floor(math.log(max(seconds, 1e-6), STEP))] += 1

    def quantiles(self) -> dict[str, float]:
        """Return the latency, s, that each of the `SHARES` of the poses does not exceed; empty without poses."""
        found: dict[str, float] = {}
        below = 0
        for number, count in sorted(self._classes.items()):
            below += count
            middle = STEP ** (number + 0.5)
            found |= {n: middle for n, share in SHARES.items() if n not in found and below >= share * self.count}
        return found

    @property
    def processor_share(self) -> float:
        """What this process has taken of one processor since it began to look, 1 for a whole one."""
        elapsed_s = time.monotonic() - self._begin_s
        return (time.process_time() - self._begin_cpu_s) / elapsed_s if elapsed_s > 0.0 else math.nan

    def text(self) -> str:
        """Return one line, of poses that there are."""
        median, most, nearly_all = (f"{value * 1e3:.2f} ms" for value in self.quantiles().values())
        return (
            f"from the last message to the line: median {median}, 95 % within {most}, 99 % within {nearly_all}; "
            f"{100.0 * self.processor_share:.0f} % of a processor"
        )

    def record(self) -> dict[str, Any]:
        """Return the same for JSON, in seconds."""
        return {
            **{f"{name}_s": value for name, value in self.quantiles().items()},
            "processor_share": self.processor_share,
        }
