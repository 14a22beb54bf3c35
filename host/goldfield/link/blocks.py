"""Sums of blocks of 31 chips (parameter ``blocks``), put together from messages that may be lost, repeated or late.

A block is a `BLOCK`, which tells where in which cycle it begins, and a `BLOCK_SUM` for each code (framing.md). It is
handed out at the message that completes it, and never behind a later one. One with a message missing is given up.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from goldfield.link.cycle_clock import CycleClock
from goldfield.link.reports import CYCLE_MODULUS, vector
from goldfield.types import Block, FloatArray
from goldfield_protocol.messages import Message, database

BLOCK_CHIPS = 31
BLOCK_MODULUS, CYCLE_LOW_MODULUS = 16, 8
WINDOW = 3
"""Blocks whose messages are still taken: that of the newest message, and the two before it."""
WAITING_BLOCKS = 128
"""Most blocks that wait for the next header, which tells their time; a cycle of degree 11 has 67."""


def _step_T(name: str) -> float:
    return float(database().get_message_by_name(name).get_signal_by_name("x").scale)


LIMIT_T = 524288 * _step_T("BLOCK_SUM")
"""An axis at the negative limit was not measured."""

QUANTISATION_SD_T = (BLOCK_CHIPS / 12.0) ** 0.5 * _step_T("BLOCK"), (BLOCK_CHIPS / 12.0) ** 0.5 * _step_T("BLOCK_SUM")
"""Standard deviation, T, of noise in each sample that adds as much to the plain sum, and to the sum with a code, as
their rounding on the wire does: ``sigma^2 + QUANTISATION_SD_T^2`` is what a sum of 31 samples has in each."""


@dataclass(frozen=True, eq=False)
class _Head:
    """What a `BLOCK` tells."""

    cycle_low: int
    chip: int
    number_low: int
    plain_T: FloatArray


@dataclass(eq=False)
class _Open:
    """What arrived of a block."""

    head: _Head | None = None
    sums_T: dict[int, FloatArray] = field(default_factory=dict)
    complete: bool = False
    """It was handed out; what else comes of it is repeated."""


class BlockAssembler:
    """Puts the blocks of one sensor together; feed it every message of that node in order of arrival.

    Parameters
    ----------
    codes : sequence of int
        The codes that the sums are wanted of, in the order of the rows of `Block.data_T`.
    chips : int
        Chips in a cycle.
    chip_s : float
        Nominal length of a chip.

    Attributes
    ----------
    lost : int
        Blocks between two that were handed out: messages of them were lost, or the sensor did not send them, because a
        chip was not sampled or the link was full.
    late : int
        Blocks that became complete behind a later one, and were left out.
    repeated : int
        Messages that had been received already.
    breaks : int
        Times that the code did not go on from the block before as the count of the blocks does: the chip clock jumped,
        its cycles were numbered anew, or the sensor restarted. What follows waits for the next header.

    Examples
    --------
    >>> assembler = BlockAssembler((2,), 1023, 97.75e-6)
    >>> signals = {"x": 1e-6, "y": 0.0, "z": 0.0, "block_low": 1}
    >>> messages = [
    ...     Message("EPOCH", 100, 0, {"cycle": 7, "time": 1.0}),
    ...     Message("BLOCK", 100, 62, signals | {"cycle_low": 8}),
    ...     Message("BLOCK_SUM", 100, 2, signals),
    ... ]
    >>> for message in messages:
    ...     for block in assembler.feed(message, 0.0):
    ...         print(block.cycle, block.chip, block.chips, round(block.time_s, 6), block.data_T[:, 0].round(9))
    8 62 31 1.05909 [3.1e-05 3.1e-05]
    """

    def __init__(self, codes: Sequence[int], chips: int, chip_s: float) -> None:
        self.lost = self.late = self.repeated = self.breaks = 0
        self._codes = tuple(codes)
        self._chips = chips
        self._clock = CycleClock(chips, chip_s)
        self._open: dict[int, _Open] = {}
        """The blocks of the window by the low bits of their numbers."""
        self._number_low = 0
        """Those of the newest message."""
        self._newest: _Head | None = None
        self._waiting: list[_Open] = []
        """Blocks that are complete and of which nobody knows the time."""
        self._latest: tuple[int, _Head] | None = None
        """The block that was handed out last, and the number of its cycle."""

    def feed(self, message: Message, arrival_s: float) -> Iterator[Block]:
        """Yield the block that this message completes, or those that wait for the header that it is.

        Parameters
        ----------
        message : Message
        arrival_s : float
            Time of arrival, on any clock that does not run backwards.
        """
        runs = self._clock.runs
        header = self._clock.take(message, arrival_s)
        if self._clock.runs != runs:  # low bits mean something else from here on
            self._open.clear()
            self._newest = self._latest = None
        if header:
            waiting, self._waiting = self._waiting, []
            for complete in waiting:
                yield from self._placed(complete)
        elif message.name == "BLOCK" and message.index < self._chips:  # of a longer code, the sensor has another degree
            yield from self._begin(message)
        elif message.name == "BLOCK_SUM" and message.index in self._codes:
            yield from self._add(message)

    def restart(self) -> None:
        """Forget everything but the counts: the sensor says that it has started."""
        self._clock.lose()
        self._open.clear()
        self._waiting.clear()
        self._newest = self._latest = None

    def _begin(self, message: Message) -> Iterator[Block]:
        signals = message.signals
        low = int(signals["block_low"])
        head = _Head(int(signals["cycle_low"]), message.index, low, vector(message, LIMIT_T))
        ahead = None if self._newest is None else self._chips_ahead(head, self._newest)
        if ahead is None or abs(ahead) >= WINDOW * BLOCK_CHIPS:
            self._open.clear()  # their low bits are those of other blocks
        if ahead is None or ahead > 0:
            self._newest = head
        block = self._of_window(low)
        if block.head is not None:
            self.repeated += 1
            return
        block.head = head
        yield from self._completed(block)

    def _add(self, message: Message) -> Iterator[Block]:
        block = self._of_window(int(message.signals["block_low"]))
        if message.index in block.sums_T:
            self.repeated += 1
            return
        block.sums_T[message.index] = vector(message, LIMIT_T)
        yield from self._completed(block)

    def _of_window(self, low: int) -> _Open:
        """Return the block with these low bits; what is not in the window begins a new block and moves it there."""
        if not self._open or (self._number_low - low) % BLOCK_MODULUS >= WINDOW:
            self._number_low = low
            kept = self._open.items()
            self._open = {n: block for n, block in kept if (low - n) % BLOCK_MODULUS < WINDOW}
        return self._open.setdefault(low, _Open())

    def _completed(self, block: _Open) -> Iterator[Block]:
        """Yield a block if it is complete now."""
        head = block.head
        if head is None or block.complete or len(block.sums_T) < len(self._codes):
            return
        block.complete = True
        if self._latest is not None and self._chips_ahead(head, self._latest[1]) is None:
            self.breaks += 1
            self._clock.lose()
            self._latest = None
        if self._clock.known:
            yield from self._placed(block)
        else:
            self._waiting.append(block)
            del self._waiting[:-WAITING_BLOCKS]

    def _placed(self, block: _Open) -> Iterator[Block]:
        assert block.head is not None
        head = block.head
        if self._latest is None:
            cycle = self._clock.cycle(head.cycle_low, CYCLE_LOW_MODULUS)
        else:
            before, latest = self._latest
            ahead = self._chips_ahead(head, latest)
            if ahead is None or ahead <= 0:
                self.late += 1
                return
            self.lost += ahead // BLOCK_CHIPS - 1
            cycle = (before + (latest.chip + ahead) // self._chips) % CYCLE_MODULUS
        self._latest = cycle, head
        rows = [*(block.sums_T[code] for code in self._codes), head.plain_T]
        time_s = self._clock.time_s(cycle, head.chip + BLOCK_CHIPS - 1)
        yield Block(cycle, head.chip, time_s, BLOCK_CHIPS, BLOCK_CHIPS * np.array(rows))

    def _chips_ahead(self, head: _Head, reference: _Head) -> int | None:
        """Return how many chips a block lies behind another one, the nearest of what the low bits may mean.

        None if no number of chips suits both the code and the count of the blocks.
        """
        half = CYCLE_LOW_MODULUS // 2
        cycles = (head.cycle_low - reference.cycle_low + half) % CYCLE_LOW_MODULUS - half
        nearest = cycles * self._chips + head.chip - reference.chip
        for turns in (0, 1, -1):
            ahead = nearest + turns * CYCLE_LOW_MODULUS * self._chips
            blocks, rest = divmod(ahead, BLOCK_CHIPS)
            if rest == 0 and (blocks - head.number_low + reference.number_low) % BLOCK_MODULUS == 0:
                return ahead
        return None
