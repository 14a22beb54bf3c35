"""A chip clock of a short cycle, driven edge by edge; for tests of single calls and of both sides of thresholds."""

from __future__ import annotations

import numpy as np

CHIPS, NOMINAL, MINIMUM, MAXIMUM = 31, 16422, 16000, 16900
CYCLE = CHIPS * NOMINAL
ONE = 2**32


class Board:
    """A chip clock that plans its chips as they are asked for, on a time line that begins with absolute chip 0."""

    def __init__(self, core, source="wire", *, chips=CHIPS, nominal=NOMINAL, follow=True):
        self.ffi, self.lib = core
        self.clock = self.ffi.new("chip_clock_t *")
        lengths = [nominal, MINIMUM, MAXIMUM] if nominal == NOMINAL else [nominal, nominal - 1000, nominal + 1000]
        assert self.lib.chip_clock_init(self.clock, self.ffi.new("chip_clock_config_t *", [chips, *lengths, follow]))
        if follow:
            self.lib.chip_clock_forget(self.clock, self.source(source))
        self.starts, self.planned = [0], []

    def source(self, name):
        return self.ffi.addressof(self.lib, f"chip_clock_{name}")

    def plan(self, chips=1):
        for _ in range(chips):
            chip = self.lib.chip_clock_plan(self.clock)
            self.planned.append((chip.cycle, chip.code_chip, chip.period_ticks, chip.position))
            self.starts.append(self.starts[-1] + chip.period_ticks)

    def until(self, time):
        """Plan each chip that begins at a time or before."""
        while self.starts[-1] <= time:
            self.plan()

    def place(self, time):
        """Return the chip in which a moment lies and the ticks into it."""
        self.until(time)
        chip = int(np.searchsorted(self.starts, time, side="right")) - 1
        return chip, int(time) - self.starts[chip]

    def edge(self, time, ahead=0):
        """Take an edge, with so many chips at least planned behind its own by then."""
        chip, ticks = self.place(time)
        self.plan(max(chip + 1 + ahead - len(self.planned), 0))
        return self.lib.chip_clock_edge(self.clock, chip, ticks)

    def mark(self, time):
        mark = self.ffi.new("chip_clock_mark_t *")
        assert self.lib.chip_clock_mark(self.clock, *self.place(time), mark)
        return mark

    def settled(self, start=100_000, edges=10):
        """Take edges at the nominal period; return the last. Phase and period then are exact, in whole ticks."""
        for edge in range(edges):
            self.edge(start + edge * self.cycle)
        assert self.clock.locked
        assert self.period == self.clock.config.nominal_ticks
        return start + (edges - 1) * self.cycle

    @property
    def cycle(self):
        return self.clock.config.chips * self.clock.config.nominal_ticks

    @property
    def period(self):
        return self.clock.period / ONE

    def begin(self, near):
        """Return when the estimate has the master begin a cycle, nearest to a time."""
        span = self.clock.config.chips * self.clock.period
        target = self.clock.target - self.clock.code_chip * self.clock.period - (near % ONE) * ONE
        away = (target + 2**63) % 2**64 - 2**63
        return near + (away - span * round(away / span)) / ONE


def used(core):
    """A board whose every state is set: it compared, is detuned and late, holds a candidate, and learnt."""
    board = Board(core)
    edge = board.settled(edges=20)
    board.edge(edge + CYCLE + 77_777)
    board.lib.chip_clock_compare(board.clock, *board.place(edge + 3))
    board.clock.detune_ticks, board.clock.late_ticks = 5, 6
    board.clock.drift, board.clock.drift_edges, board.clock.edges_rejected = 7, 32, 0
    return board, edge
