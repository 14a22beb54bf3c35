"""Raw chips of a sensor (parameter ``stream`` = 1, serial only), put together to cycles of samples.

``CHIP`` carries the sum of a burst of eight conversions relative to mid-scale. The field is M (counts - zero) with the
mean count of the burst and the sensor's own calibration (docs/parameters.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from goldfield.types import FloatArray
from goldfield_protocol.messages import Message

BURST = 8
MID_SCALE = 2048.0
SATURATED = -32768


@dataclass(frozen=True, eq=False)
class Calibration:
    """What makes a field of counts.

    Attributes
    ----------
    zero : ndarray, shape (3,)
        Counts, mean of a burst, at zero field.
    matrix : ndarray, shape (3, 3)
        T per count.
    """

    zero: FloatArray
    matrix: FloatArray

    def field_T(self, sums: FloatArray) -> FloatArray:
        """Return the fields of burst sums, each of shape (N, 3).

        An axis that is missing makes those missing that need it: with a matrix that mixes axes, all.
        """
        counts = sums / BURST + MID_SCALE - self.zero
        spoiled = np.isnan(counts).astype(np.float64) @ (self.matrix != 0.0).T > 0.0
        return np.asarray(np.where(spoiled, np.nan, np.nan_to_num(counts) @ self.matrix.T))


class ChipAssembler:
    """Puts the chips of one sensor together; feed it every message of that node in order of arrival.

    Parameters
    ----------
    chips : int
        Chips in a cycle.
    """

    def __init__(self, chips: int) -> None:
        self._chips = chips
        self._cycle: int | None = None
        self._sums = np.full((chips, 3), np.nan)

    def feed(self, message: Message) -> Iterator[FloatArray]:
        """Yield the burst sums, shape (N, 3), of a cycle that this message ends; NaN where lost or saturated.

        The first cycle, of which the begin was not heard, is left out.
        """
        if message.name != "CHIP" or message.index >= self._chips:
            return
        cycle = int(message.signals["cycle_low"])
        if cycle != self._cycle:
            if np.isfinite(self._sums[0]).any():
                yield self._sums
            self._cycle = cycle
            self._sums = np.full((self._chips, 3), np.nan)
        values = [message.signals[axis] for axis in "xyz"]
        self._sums[message.index] = [np.nan if value == SATURATED else value for value in values]
