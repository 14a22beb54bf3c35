"""What the tests of the store share: a board that keeps sets in flash and can lose its power, and words of slots."""

import zlib

import numpy as np

from tests.firmware.core.storage.flash_cells import ONES, Cells, Torn

WORDS, HEAD, FIT = 40, 4, 3
"""Words of a slot, those of its head, and how many records of ten or eleven words fit: every third save erases."""


MARK, READY, COMMIT, SETTLED = 0x47465331, 0x2D5A1E69, 0x5AC3A53C, 0x3CA5C35A
ERASE = "erase"


class PowerLost(Exception):
    """The step at which the power goes has come."""


class Board:
    """A board that keeps sets in its flash; its power can be made to go at a step."""

    def __init__(self, core, seed=1, words=WORDS, memory=None):
        self._ffi, self._lib = core
        self._memory = memory or [self._ffi.new("uint32_t[]", max(words, 1)) for _ in range(2)]
        self.cells = Cells(self._memory, words, seed)
        self._flash = self._ffi.new("store_flash_t *", {"slot": self._memory, "words": words})
        self._store = self._ffi.new("store_t *")
        self.steps, self.cut, self.torn = 0, None, Torn.NOT
        self.log = []

    def start(self):
        """Switch on, and return the set that is read at once."""
        self.cells.start()
        self._lib.store_open(self._store, self._flash)
        return self.read()

    def read(self):
        count = self._ffi.new("uint32_t *", 99)
        words = self._lib.store_read(self._store, count)
        assert words != self._ffi.NULL or count[0] == 0
        return None if words == self._ffi.NULL else tuple(words[i] for i in range(count[0]))

    def work(self):
        """Carry out steps until there are none."""
        while True:
            step = self._lib.store_next(self._store)
            if step.kind == self._lib.STORE_NOTHING:
                return
            erase = step.kind == self._lib.STORE_ERASE
            if self.steps == self.cut:
                self.cut = None
                self.cells.tear(self.torn, step.slot, None if erase else step.index, step.value)
                raise PowerLost
            self.steps += 1
            assert self.steps < 5000
            self.log.append((step.slot, ERASE) if erase else (step.slot, step.index, step.value))
            if erase:
                self.cells.erase(step.slot)
            else:
                self.cells.program(step.slot, step.index, step.value)

    def save(self, values):
        """Save a set; return whether it is said to be kept."""
        data = self._ffi.new("uint32_t[]", list(values))
        if not self._lib.store_save(self._store, data, len(values)):
            return False
        self.work()
        return self._lib.store_outcome(self._store) == self._lib.STORE_SAVED

    def read_sequence(self):
        """Return the number of the newest record."""
        return self._lib.store_read(self._store, self._ffi.new("uint32_t *"))[-1]

    def torn_slots(self):
        return self._lib.store_torn(self._store)

    def wear(self, slot):
        return self._lib.store_wear(self._store, slot)


def fresh(core):
    board = Board(core)
    assert board.start() is None
    board.work()
    return board


def a_set(number):
    """Return a set that no other number has; some words look like those of a record."""
    return (*((number << 16 | i, 0x47520001, ONES, 0)[i % 4] for i in range(5 + number % 2)), number)


def head(erasures):
    """Return the words in front of a slot's records."""
    return [MARK, erasures, ~erasures & ONES, READY]


def record(sequence, values, mark=0x47520000):
    """Return the words of a record."""
    body = [mark | len(values), sequence, *values]
    return [*body, zlib.crc32(np.array(body, np.uint32).tobytes()), COMMIT, SETTLED]


def filled(core, *slots, words=WORDS):
    """Return a board in whose slots words lie from their beginning on."""
    board = Board(core, words=words)
    for slot, contents in enumerate(slots):
        board.cells.read[slot][0 : len(contents)] = contents
    return board


def forged(sequence=9, mark=0x47520000):
    """Return words that are a whole record, of no words, that nobody has saved; its settled word is not there."""
    return tuple(record(sequence, (), mark)[:-1])
