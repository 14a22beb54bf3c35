"""The times at which a track by blocks has poses: what two kinds of track share."""

from __future__ import annotations

import math
from collections.abc import Iterator

from goldfield.link.reports import CYCLE_MODULUS
from goldfield.site import Site
from goldfield.types import Block

SAME_RATE = 0.01
"""A rate that differs from that of the blocks by a smaller share is theirs: each pose is that of a block's end."""

NEAR = 1e-6
"""Share of a step by which times that are the same differ by rounding. Where they differ because the sensor's clock
goes at another rate than the nominal one, half a block or half a chip is allowed for."""


class BlockTimes:
    """Tells the times of poses, by the clock of the sensor.

    Parameters
    ----------
    site : Site
    rate_hz : float or None
        Poses a second, at whole multiples of its inverse on the sensor's clock, or at the ends of the blocks if it is
        their rate (`SAME_RATE`).
    """

    def __init__(self, site: Site, rate_hz: float | None) -> None:
        self._chips, self._cycle_s = site.chips, site.cycle_s
        self._chip_s = site.cycle_s / site.chips
        self._rate_hz = rate_hz

    def duration_s(self, block: Block) -> float:
        """Return the nominal duration of a block."""
        return block.chips * self._chip_s

    def due(self, block: Block, after_s: float, until_s: float) -> Iterator[float]:
        """Yield the times at the rate behind one time and up to another; a block tells where blocks end."""
        if self._rate_hz is None:
            return
        step_s, one_s, near = 1.0 / self._rate_hz, 0.0, NEAR
        if abs(step_s / self.duration_s(block) - 1.0) < SAME_RATE:
            step_s, one_s, near = self.duration_s(block), block.time_s, 0.5
        first = math.floor((after_s - one_s) / step_s + near) + 1
        last = math.floor((until_s - one_s) / step_s + near)
        yield from (one_s + number * step_s for number in range(first, last + 1))

    def ends(self, block: Block, after_s: float, until_s: float) -> Iterator[tuple[int, float]]:
        """Yield the cycles that end behind one time and up to another, with their ends, counted from a block."""
        zero_s = block.time_s - (block.chip + block.chips) * self._chip_s  # the begin of the cycle of its first chip
        near = 0.5 / self._chips
        first = math.floor((after_s - zero_s) / self._cycle_s + near)
        last = math.floor((until_s - zero_s) / self._cycle_s + near)
        for number in range(first, last):
            yield (block.cycle + number) % CYCLE_MODULUS, zero_s + (number + 1) * self._cycle_s

    def cycle_at(self, block: Block, time_s: float) -> int:
        """Return the cycle in which a time lies, counted from a block; its end is the last of its times."""
        chips = block.chip + block.chips + (time_s - block.time_s) / self._chip_s
        return (block.cycle + math.ceil(chips / self._chips - NEAR) - 1) % CYCLE_MODULUS
