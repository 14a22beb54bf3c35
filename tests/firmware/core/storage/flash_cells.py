"""Flash as its cells are: what loses its power within a word or an erasure reads otherwise at the next start."""

from __future__ import annotations

import random
from enum import StrEnum
from typing import Any

ONES = 0xFFFFFFFF


class Torn(StrEnum):
    """How far a step came before the power was gone."""

    NOT = "not begun"
    ALL = "complete, but nobody was told"
    SOME = "some cells changed, some did not"
    NEARLY = "all cells changed but one, which reads now so and now so"
    WEAK = "every cell reads now so and now so"
    MIXED = "each cell in one of these ways"


class Cells:
    """Two slots of flash; a cell is a one, a zero, or weak: it reads by chance, anew at each start.

    Parameters
    ----------
    memory : array of array of int
        The words of both slots as the processor reads them, which it may share with a C program.
    words : int
        Words of a slot.
    seed : int
        Seed of all that happens by chance.
    """

    def __init__(self, memory: list[Any], words: int, seed: int) -> None:
        self._random = random.Random(seed)
        self.read, self.words = memory, words
        self._weak: dict[tuple[int, int], int] = {}
        self.stuck: dict[tuple[int, int], int] = {}
        """Bits of a word that can no longer be cleared."""
        for slot in range(2):
            self.erase(slot)

    def start(self) -> None:
        """Switch the power on: weak cells read as they like."""
        for (slot, index), weak in self._weak.items():
            self.read[slot][index] = self.read[slot][index] & ~weak | self._random.getrandbits(32) & weak

    def program(self, slot: int, index: int, value: int) -> None:
        """Clear the bits of a word that are zero in a value; no bit can be set."""
        cleared = ~value & ONES & ~self.stuck.get((slot, index), 0)
        self.read[slot][index] &= ~cleared
        if (slot, index) in self._weak:
            self._weak[slot, index] &= ~cleared

    def erase(self, slot: int) -> None:
        """Set all bits of a slot."""
        self.read[slot][0 : self.words] = [ONES] * self.words
        self._weak = {place: weak for place, weak in self._weak.items() if place[0] != slot}

    def tear(self, how: Torn, slot: int, index: int | None, value: int) -> None:
        """Program a word, or erase a slot (no index), and lose the power before the end."""
        if how is Torn.ALL and index is None:
            self.erase(slot)
        elif how is Torn.ALL and index is not None:
            self.program(slot, index, value)
        elif how is not Torn.NOT:
            for one in range(self.words) if index is None else [index]:
                # An erasure begins by clearing all cells, so that it may leave either value anywhere.
                # A cell that has been cleared before only gets clearer.
                unclear = self.read[slot][one] | self._weak.get((slot, one), 0)
                touched = ONES if index is None else ~value & unclear
                self._tear_word(how, (slot, one), touched, self._random.getrandbits(32) if index is None else 0)

    def _tear_word(self, how: Torn, place: tuple[int, int], touched: int, new: int) -> None:
        weak = {Torn.SOME: 0, Torn.WEAK: ONES}.get(how, self._random.getrandbits(32)) & touched
        changed = self._random.getrandbits(32) & touched & ~weak
        if how is Torn.NEARLY:
            weak = 1 << self._random.choice([bit for bit in range(32) if touched >> bit & 1]) if touched else 0
            changed, new = touched & ~weak, ONES if new else 0
        slot, index = place
        self.read[slot][index] = self.read[slot][index] & ~changed | new & changed
        self._weak[place] = self._weak.get(place, 0) & ~changed | weak

    def copy_to(self, other: Cells) -> None:
        """Bring other cells into the state of these; what happens by chance to them stays their own."""
        for slot in range(2):
            other.read[slot][0 : self.words] = self.read[slot][0 : self.words]
        other._weak = dict(self._weak)
