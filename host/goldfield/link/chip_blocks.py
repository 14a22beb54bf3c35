"""Blocks of 31 samples from the chips that a sensor streams (parameter ``stream`` = 1, serial only)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from goldfield.link.blocks import BLOCK_CHIPS
from goldfield.link.chips import SATURATED, Calibration
from goldfield.link.cycle_clock import CycleClock
from goldfield.link.reports import CYCLE_MODULUS, distance
from goldfield.types import Block, FloatArray
from goldfield_protocol.messages import Message

CYCLE_LOW_MODULUS = 1 << 16
LONGEST_GAP_CYCLES = 8
"""Cycles without a chip after which they are taken for numbered anew."""


class ChipBlockAssembler:
    """Puts the chips of one sensor together to blocks; feed it every message of that node in order of arrival.

    A block with a chip missing is left out. The next one begins where it would have, so that blocks end with those of
    the firmware, whose chips come together.

    Parameters
    ----------
    chips : int
        Chips in a cycle.
    chip_s : float
        Nominal length of a chip.
    calibration : Calibration
        The sensor's own.

    Attributes
    ----------
    lost : int
        Blocks between two that were handed out, of which chips were lost.
    """

    def __init__(self, chips: int, chip_s: float, calibration: Calibration) -> None:
        self.lost = 0
        self._chips = chips
        self._calibration = calibration
        self._clock = CycleClock(chips, chip_s)
        self._begin: tuple[int, int] | None = None
        """Cycle and chip at which the block begins that is put together."""
        self._sums: list[list[float]] = []
        self._after: tuple[int, int] | None = None
        """Where the block that was handed out last ended."""

    def feed(self, message: Message, arrival_s: float) -> Iterator[Block]:
        """Yield the block that this chip completes.

        Parameters
        ----------
        message : Message
            Chips before the first header are left out, since nobody can tell their time.
        arrival_s : float
            Time of arrival, on any clock that does not run backwards.
        """
        runs = self._clock.runs
        self._clock.take(message, arrival_s)
        if self._clock.runs != runs:
            self.restart()
        if message.name != "CHIP" or message.index >= self._chips or not self._clock.known:
            return
        cycle = self._clock.cycle(int(message.signals["cycle_low"]), CYCLE_LOW_MODULUS)
        place = cycle, message.index
        ahead = 0 if self._begin is None else self._ahead(place, self._begin)
        if self._begin is None or not -self._chips <= ahead <= LONGEST_GAP_CYCLES * self._chips:
            self.restart()
            self._begin, ahead = place, 0
        if ahead < len(self._sums):
            return  # repeated or late
        if ahead > len(self._sums):
            self._sums.clear()
            self._begin = self._moved(self._begin, -(-ahead // BLOCK_CHIPS) * BLOCK_CHIPS)
            if ahead % BLOCK_CHIPS:
                return
        values = [message.signals[axis] for axis in "xyz"]
        self._sums.append([np.nan if value == SATURATED else value for value in values])
        if len(self._sums) == BLOCK_CHIPS:
            yield self._block()

    def restart(self) -> None:
        """Forget the chips of a block that is not complete: the sensor says that it has started."""
        self._begin = self._after = None
        self._sums.clear()

    def _block(self) -> Block:
        assert self._begin is not None
        cycle, chip = self._begin
        samples_T: FloatArray = self._calibration.field_T(np.array(self._sums))
        if self._after is not None:
            self.lost += self._ahead(self._begin, self._after) // BLOCK_CHIPS
        self._begin = self._after = self._moved(self._begin, BLOCK_CHIPS)
        self._sums.clear()
        time_s = self._clock.time_s(cycle, chip + BLOCK_CHIPS - 1)
        return Block(cycle, chip, time_s, BLOCK_CHIPS, samples_T, sampled=True)

    def _ahead(self, place: tuple[int, int], reference: tuple[int, int]) -> int:
        """Return how many chips a place in the code lies behind another one."""
        return distance(place[0], reference[0]) * self._chips + place[1] - reference[1]

    def _moved(self, place: tuple[int, int], chips: int) -> tuple[int, int]:
        """Return the place so many chips later."""
        cycles, chip = divmod(place[1] + chips, self._chips)
        return (place[0] + cycles) % CYCLE_MODULUS, chip
