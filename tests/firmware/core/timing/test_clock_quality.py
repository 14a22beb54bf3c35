"""How well the chip clock has the time, in the terms of its manual; what contests it, and how it leads."""

from __future__ import annotations

import pytest

from tests.firmware.core.timing.small_clock import CHIPS, CYCLE, NOMINAL, ONE, Board, used

UNKNOWN = 2**32 - 1


# ---- How well it has the time ----


@pytest.mark.parametrize("slope", [-3, 0, 3])
@pytest.mark.parametrize(("scatter", "memory"), [(0.0, 16), (3.0, 16), (30.0, 4)])
@pytest.mark.parametrize("chips", [31, 1023])
def test_the_stated_error_is_that_of_the_manual(core, slope, scatter, memory, chips):
    """In the manual's terms and SI units: floor, scatter, the rate's error, the learnt drift, and one never seen."""
    board, drift = Board(core, "link", chips=chips), 1.001 * slope / 256.0 / chips  # The error counts in 1/256 ticks.
    clock = board.clock
    board.lib.chip_clock_jump(clock, 0, int(ONE * NOMINAL * (1.0 - 30e-6)))
    clock.scatter, clock.memory, clock.drift = round(scatter * 256), memory, round(drift * ONE)
    for cycles in (0, 1, 2, 3, 50, 1000, 1001):
        for code_chip in (0, chips - 1):
            clock.cycle, clock.code_chip = clock.edge_cycle + cycles, code_chip
            told = board.lib.chip_clock_quality(clock, 168)
            assert told.rate_ppb == pytest.approx(-30_000, abs=1)
            if cycles > 1000:
                assert (told.age_us, told.error_ns) == (UNKNOWN, UNKNOWN)
                continue
            age_s = (cycles * chips + code_chip) * NOMINAL / 168e6
            assert told.age_us == pytest.approx(age_s * 1e6, abs=1)
            n = cycles if cycles > 1 else 0
            ticks = 42 + 2 * scatter + n * 2 * scatter / memory + abs(drift) * chips * n**2 / 2
            error_s = ticks / 168e6 + 0.02e-6 * age_s**2 / 2
            assert told.error_ns == pytest.approx(error_s * 1e9, rel=0.002, abs=30)


def test_an_error_beyond_all_numbers_is_unknown(core):
    board = Board(core, "link", chips=2047)
    clock = board.clock
    board.lib.chip_clock_jump(clock, 0, ONE * NOMINAL)
    clock.edge_cycle, clock.drift, clock.scatter = (clock.cycle - 1000) % 2**32, ONE // 600, 0
    held_s = (1000 * 2047 + clock.code_chip) * NOMINAL / 168e6
    error_s = ONE // 600 / ONE * 2047 * 1000**2 / 2 / 168e6 + 0.02e-6 * held_s**2 / 2
    told = board.lib.chip_clock_quality(clock, 168)
    assert told.error_ns == pytest.approx(error_s * 1e9, rel=0.01)
    clock.drift = ONE
    assert board.lib.chip_clock_quality(clock, 168).error_ns == UNKNOWN


def test_a_searching_clock_and_a_master_tell_their_rate(core):
    for follow, told_of in ((True, (UNKNOWN, UNKNOWN)), (False, (0, 0))):
        board = Board(core, follow=follow)
        board.plan(70)
        board.clock.period += board.clock.period // 20_000
        told = board.lib.chip_clock_quality(board.clock, 168)
        assert (told.age_us, told.error_ns) == told_of
        assert told.rate_ppb == pytest.approx(50_000, abs=1)


def test_the_scatter_is_the_mean_size_of_the_last_eight_or_so(core):
    """Each edge takes it an eighth of the way to what it was off, of either sign."""
    board, expected = Board(core), 21.0
    edge = 1e5
    for off in (0, 0, 0, 0, 0, 0, 0, 0, -40, 40, 25, -60):
        begin = round(board.begin(int(edge))) if board.clock.tracking else int(edge)
        tracked = board.clock.tracking
        board.edge(begin + off)
        if tracked:
            expected += (abs(off) - expected) / 8.0
            assert board.clock.scatter / 256.0 == pytest.approx(expected, abs=0.6)
        edge = begin + CYCLE


def test_an_edge_that_does_not_fit_contests_a_hold_over_for_a_cycle(core):
    """A cycle of chips from the one that was next when it came, while the own edges are missing for more than one."""
    contested = core[1].chip_clock_contested
    board = Board(core)
    edge = board.settled()
    assert not contested(board.clock)
    board.edge(edge + CYCLE // 2)
    assert not contested(board.clock)  # The own edge may still come.
    board.until(edge + CYCLE)
    assert not contested(board.clock)
    for off in (7_000, 77_000, 277_000):
        board = Board(core)
        edge = board.settled()
        board.until(edge + 2 * CYCLE)
        assert not contested(board.clock)
        board.edge(edge + 2 * CYCLE + off)
        for _ in range(CHIPS):
            assert contested(board.clock)
            board.plan()
        assert contested(board.clock)
        board.plan()
        assert not contested(board.clock)


def test_an_edge_half_a_cycle_before_the_own_one_contests_when_that_is_missing(core):
    board = Board(core)
    edge = board.settled()
    board.edge(edge + CYCLE + CYCLE // 2)
    assert not core[1].chip_clock_contested(board.clock)
    board.until(edge + 2 * CYCLE)
    assert core[1].chip_clock_contested(board.clock)
    board.lib.chip_clock_jump(board.clock, (edge - 3 * CYCLE) * ONE, NOMINAL * ONE)
    assert not core[1].chip_clock_contested(board.clock)  # The stranger may be who is followed now.
    board.lib.chip_clock_forget(board.clock, board.source("wire"))
    board.edge(edge + 2 * CYCLE + 1000)
    assert not core[1].chip_clock_contested(board.clock)  # A search has nothing to contest.


# ---- Leading ----


@pytest.mark.parametrize("anew", [False, True])
def test_a_clock_that_leads_is_locked_whatever_it_was(core, anew):
    board, _ = used(core)
    clock = board.clock
    period, cycle, code_chip = clock.period, clock.cycle, clock.code_chip
    board.lib.chip_clock_lead(clock, anew)
    assert (clock.locked, clock.tracking, clock.compared, clock.detune_ticks, clock.phase_ticks) == (1, 0, 0, 0, 0)
    assert not clock.config.follow
    assert clock.period == period
    board.plan(2 * CHIPS)
    assert [chip[:2] for chip in board.planned[-2 * CHIPS :]] == [
        ((0 if anew else cycle) + c // CHIPS, c % CHIPS)
        for c in range(0 if anew else code_chip, (0 if anew else code_chip) + 2 * CHIPS)
    ]
    board.plan(150 * CHIPS)  # Longer than any hold-over, and what was learnt of a drift changes nothing.
    assert clock.locked
    assert clock.period == period
    assert board.lib.chip_clock_quality(clock, 168).age_us == 0


def test_a_clock_that_followed_nobody_leads_and_follows(core):
    """Its cycle under way is cut short and counts as the one before the first; it is locked, and stays so."""
    board, told = Board(core), core[0].new("chip_clock_chip_t *")
    board.plan(3 * CHIPS + 5)
    board.lib.chip_clock_lead(board.clock, True)
    assert board.clock.locked
    assert board.lib.chip_clock_at(board.clock, 3 * CHIPS + 4, told)
    assert told.cycle == 2**32 - 1
    board.plan(3 * CHIPS)
    assert [chip[:2] for chip in board.planned[-3 * CHIPS :]] == [(c // CHIPS, c % CHIPS) for c in range(3 * CHIPS)]
    board.lib.chip_clock_yield(board.clock, board.source("wire"))
    board.plan(CHIPS)
    assert board.edge(board.starts[3 * CHIPS + 5 + 3 * CHIPS])
    assert board.clock.locked


def test_a_leader_that_yields_keeps_its_lock_and_learns_anew(core):
    """The first edge counts as the third of a search, with its gains; one beyond the lock's limit ends it."""
    for off in (60, -85):
        board, _ = used(core)
        board.lib.chip_clock_late(board.clock, 0)
        clock = board.clock
        board.lib.chip_clock_lead(clock, False)
        board.plan(5 * CHIPS)
        board.lib.chip_clock_compare(clock, *board.place(board.starts[-3]))
        board.lib.chip_clock_yield(clock, board.source("field"))
        assert (clock.locked, clock.tracking, clock.compared, clock.candidate_edges) == (1, 1, 0, 0)
        assert (clock.drift, clock.drift_edges, clock.config.follow, clock.source.gate_ticks) == (0, 0, True, 504)
        assert (clock.cycle - clock.edge_cycle, clock.good_edges) == (1, 3)
        begin = max(s for s, chip in zip(board.starts, board.planned, strict=False) if chip[1] == 0)
        board.plan(CHIPS)
        before = board.begin(begin)
        assert board.edge(begin + off)
        assert board.begin(begin) - before == pytest.approx(off * 10 / 12, abs=1.0)
        assert clock.phase_ticks == off
        assert clock.locked == (off == 60)


def test_a_message_numbers_the_cycle_of_its_edge(core):
    """The count wraps, and goes on from the last good edge however many cycles begin by then."""
    board = Board(core)
    edge = board.settled()
    board.until(edge + CYCLE // 2)
    number = board.planned[-1][0]
    board.lib.chip_clock_number_cycle(board.clock, 2**32 - 1)
    board.plan()
    assert board.planned[-1][0] == 2**32 - 1
    assert number != 2**32 - 1
    board.until(edge + CYCLE)
    assert board.planned[-1][0] == 0
