"""The chip clock's calls one by one, and both sides of what they decide."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from tests.firmware.core.timing.small_clock import CHIPS, CYCLE, MAXIMUM, MINIMUM, NOMINAL, ONE, Board, used

UNKNOWN = 2**32 - 1


@pytest.mark.parametrize(
    ("config", "fits"),
    [
        ((31, 16422, 16258, 16586), True),  # A hundredth is 164 ticks.
        ((2047, 16422, 16258, 16586), True),
        ((30, 16422, 16258, 16586), False),
        ((2048, 16422, 16258, 16586), False),
        ((31, 16422, 16259, 16586), False),
        ((31, 16422, 16258, 16585), False),
        ((31, 50, 1, 50), True),
        ((31, 50, 0, 50), False),
        ((31, 0, 0, 0), False),
        ((31, 0, 1, 1), False),
    ],
)
def test_a_configuration_within_its_limits_is_taken(core, config, fits):
    ffi, lib = core
    clock = ffi.new("chip_clock_t *")
    ffi.memmove(clock, bytes([0x45]) * ffi.sizeof(clock[0]), ffi.sizeof(clock[0]))
    before = bytes(ffi.buffer(clock))
    for follow in (True, False):
        assert lib.chip_clock_init(clock, ffi.new("chip_clock_config_t *", [*config, follow])) == fits
        if fits:
            assert (clock.chip, clock.cycle, clock.code_chip, clock.locked) == (0, 0, 0, not follow)
            assert bytes(ffi.buffer(ffi.addressof(clock, "source"))) == bytes(
                ffi.buffer(ffi.addressof(lib, "chip_clock_wire"))
            )
        else:
            assert bytes(ffi.buffer(clock)) == before


@pytest.mark.parametrize("detune", [-50, 0, 48, 477, 478, 479, 700, -422, -423, -700])
def test_a_detuned_chip_is_so_much_longer(core, detune):
    """Within the allowed lengths; what is beyond them is left over for the next chips."""
    board = Board(core)
    board.clock.detune_ticks = detune
    board.plan()
    board.clock.detune_ticks = 0
    board.plan(3)
    lengths = [chip[2] for chip in board.planned]
    assert lengths[0] == np.clip(NOMINAL + detune, MINIMUM, MAXIMUM)
    assert sum(lengths) == 4 * NOMINAL + detune
    assert [chip[3] for chip in board.planned] == board.starts[:-1]


@pytest.mark.parametrize("ppm", [-200.0, 0.0, 200.0])
def test_a_mark_tells_the_nearest_beginning_of_a_cycle(core, ppm):
    """As the clock really ran: in the first half of the code that of its own cycle, then that of the next."""
    board = Board(core)
    board.lib.chip_clock_jump(board.clock, 7 * ONE, int(ONE * NOMINAL * (1.0 + ppm * 1e-6)))
    board.plan(8 * CHIPS)
    board.lib.chip_clock_number_cycle(board.clock, 1000)
    shift = (1000 - board.clock.edge_cycle) % 2**32
    mark = board.ffi.new("chip_clock_mark_t *")
    chosen = range(len(board.planned) - 128, len(board.planned) - 20)
    for chip in chosen:
        cycle, code_chip, length, position = board.planned[chip]
        for ticks in (0, 77, length - 1, 2 * MAXIMUM):
            assert board.lib.chip_clock_mark(board.clock, chip, ticks, mark)
            first = chip - code_chip if code_chip <= 15 else chip - code_chip + CHIPS
            assert mark.position == position + ticks
            assert mark.cycle_ticks == pytest.approx(position + ticks - board.starts[first], abs=1)
            assert mark.cycle == (cycle + (code_chip > 15) + shift) % 2**32


def test_what_is_planned_is_told_for_a_history(core):
    ffi, lib = core
    board, told = Board(core), ffi.new("chip_clock_chip_t *")
    board.plan(500)
    for age in (1, 2, 127, 128):
        assert lib.chip_clock_at(board.clock, 500 - age, told)
        assert (told.cycle, told.code_chip, told.period_ticks, told.position) == board.planned[-age]
    for age in (0, 129, 128 + 128):
        assert not lib.chip_clock_at(board.clock, 500 - age, told)
    lib.chip_clock_number_cycle(board.clock, board.clock.edge_cycle + 5)
    assert lib.chip_clock_at(board.clock, 499, told)
    assert told.cycle == board.planned[-1][0] + 5
    board.plan()
    assert board.planned[-1][0] == 500 // CHIPS + 5


# ---- Messages ----


@pytest.mark.parametrize("ppm", [-200.0, 0.0, 70.0])
def test_own_ticks_are_told_as_nominal_ones(core, ppm):
    """Rounded to the nearest: so many chips of the estimate, times their nominal ticks."""
    board = Board(core)
    board.lib.chip_clock_jump(board.clock, 0, int(ONE * NOMINAL * (1.0 + ppm * 1e-6)))
    for own in [*np.random.default_rng(1).integers(-1_000_000, 1_000_000, 60).tolist(), 0, 1, -1]:
        exact = Fraction(own * NOMINAL * ONE, board.clock.period)
        assert abs(board.lib.chip_clock_told(board.clock, own) - exact) < 0.52


@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_a_phase_is_that_against_the_nearest_cycle(core, ppm):
    """The mark may lie anywhere, and the message tell of any cycle; being late on purpose is no error."""
    board, phase = Board(core), core[0].new("int32_t *")
    rate = 1.0 + ppm * 1e-6
    board.lib.chip_clock_jump(board.clock, 0, int(ONE * NOMINAL * rate))
    board.plan(6 * CHIPS)
    for late in (0, 123):
        board.clock.late_ticks = late
        for at in (0.05, 0.45, 0.55, 0.95):
            for early in (-0.52, -0.48, -0.001, 0.0, 0.3, 0.49, 0.51):
                for cycles in (-60, 0, 1, 60):
                    mark = board.mark((3 + at) * CYCLE * rate)
                    ticks = round((at - early + cycles) * CYCLE)
                    assert board.lib.chip_clock_phase(board.clock, mark, ticks, phase)
                    nearest = early - round(early)
                    assert phase[0] == pytest.approx(nearest * CYCLE * rate + late, abs=3)


@pytest.mark.parametrize("ticks", [2**26, -(2**26)])
def test_a_message_tells_at_most_two_to_the_26_ticks(core, ticks):
    board, phase = Board(core, "link"), core[0].new("int32_t *", 7)
    edge = board.settled()
    board.until(edge + 3 * CYCLE)
    mark, beyond = board.mark(edge + 2 * CYCLE + 5000), ticks + (1 if ticks > 0 else -1)
    assert not board.lib.chip_clock_phase(board.clock, mark, beyond, phase)
    assert phase[0] == 7
    assert not board.lib.chip_clock_message(board.clock, mark, beyond)
    assert board.clock.candidate_edges == 0
    assert board.clock.edges_rejected == 1
    assert board.lib.chip_clock_phase(board.clock, mark, ticks, phase)
    away = (5000 - ticks) % CYCLE
    assert phase[0] == pytest.approx(away - CYCLE * (away > CYCLE / 2), abs=2)
    board.lib.chip_clock_message(board.clock, mark, ticks)
    assert board.clock.candidate_edges == 1  # It is an edge, if of nobody.


# ---- An estimate made elsewhere ----


@pytest.mark.parametrize("late", [0.0, 0.4, 0.6, 15.0, 30.4, 30.6, 31.0, 100.7, -0.4, -0.6, -31.0, -40.2])
def test_a_jump_goes_to_the_masters_nearest_chip(core, late):
    """However many chips ago the master began a cycle, or is to begin it."""
    board, period = Board(core), int(ONE * NOMINAL * (1.0 + 100e-6))
    board.settled()
    board.clock.scatter = 1
    position, cycle = board.clock.position, board.clock.cycle
    edge = position * ONE - int(late * period)
    board.lib.chip_clock_jump(board.clock, edge % 2**64, period)
    chips = round(late)
    clock = board.clock
    assert (clock.code_chip, clock.cycle) == (chips % CHIPS, cycle + 1)
    assert clock.edge_cycle == cycle + 1 - chips // CHIPS
    assert clock.target == edge + chips * period
    assert (clock.tracking, clock.locked, clock.good_edges, clock.candidate_edges) == (True, False, 0, 0)
    board.plan(25)
    assert board.starts[-1] == pytest.approx(clock.target / ONE, abs=1)  # At most 22 chips of slew.


def test_a_jump_forgets_what_was_learnt(core):
    """The scatter is then a quarter of the lock's limit, and the next edge is one of three."""
    board = Board(core)
    edge = board.settled(edges=20)
    board.edge(edge + CYCLE + 77_777)
    board.clock.drift, board.clock.drift_edges = ONE // 1000, 32
    board.lib.chip_clock_jump(board.clock, edge * ONE, NOMINAL * ONE)
    clock = board.clock
    assert (clock.drift, clock.drift_edges, clock.candidate_edges) == (0, 0, 0)
    assert board.lib.chip_clock_quality(clock, 168).error_ns == pytest.approx((8 + 2 * 21) / 0.168, abs=2)
    begin = round(board.begin(edge + 2 * CYCLE))
    assert board.edge(begin + 60)
    assert board.begin(begin) - begin == pytest.approx(60 * 10 / 12, abs=1e-3)
    assert board.period - NOMINAL == pytest.approx(60 * 6 / 12 / CHIPS / 2, rel=1e-3)


@pytest.mark.parametrize("locked", [True, False])
def test_a_correction_moves_phase_and_rate(core, locked):
    board = Board(core, "field")
    board.settled(edges=20)
    clock = board.clock
    clock.drift, clock.drift_edges, clock.scatter, clock.locked = ONE // 1000, 32, 8 * 256, not locked
    board.plan(3 * CHIPS)
    target, period = clock.target, clock.period
    board.lib.chip_clock_correct(clock, 5 * ONE + 9, -(ONE // 7), -16, locked)
    assert clock.target - target == 5 * ONE + 9
    assert clock.period - period == -(ONE // 7)
    assert (clock.phase_ticks, clock.locked, clock.edge_cycle) == (-16, locked, clock.cycle)
    assert (clock.drift, clock.drift_edges) == (0, 0)
    assert clock.scatter == 9 * 256  # An eighth of the way from 8 to 16 ticks.
    board.lib.chip_clock_correct(clock, 0, 0, 1, locked)
    assert clock.scatter == 8 * 256


def test_a_master_takes_no_estimate(core):
    board = Board(core, follow=False)
    board.plan(5)
    before = bytes(board.ffi.buffer(board.clock))
    board.lib.chip_clock_jump(board.clock, 7 * ONE, NOMINAL * ONE)
    board.lib.chip_clock_correct(board.clock, ONE, ONE, 5, False)
    assert not board.lib.chip_clock_edge(board.clock, 3, 5)
    assert not board.lib.chip_clock_message(board.clock, board.mark(1000), 2**27)
    assert bytes(board.ffi.buffer(board.clock)) == before


def test_chips_are_late_by_what_is_asked(core):
    """In place of what was asked before; a wire that is compared allows for it."""
    board = Board(core)
    edge = board.settled()
    for late in (300, -50, 0):
        board.lib.chip_clock_late(board.clock, late)
        board.plan(3 * CHIPS)
        begins = [start for start, chip in zip(board.starts, board.planned, strict=False) if chip[1] == 0]
        assert (begins[-1] - edge) % CYCLE == late % CYCLE
        assert board.clock.late_ticks == late
        assert board.clock.locked


# ---- Another source, and a wire beside it ----


@pytest.mark.parametrize("late", [0, 200, -200])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_wire_is_compared_to_the_gate(core, late, sign):
    """From then on the phase is that against the wire."""
    board = Board(core, "link")
    edge = board.settled(edges=20)
    board.lib.chip_clock_late(board.clock, late)
    board.plan(4 * CHIPS)
    begin = max(
        s for s, chip in zip(board.starts, board.planned, strict=False) if chip[1] == 0 and s < board.starts[-20]
    )
    assert (begin - edge) % CYCLE == late % CYCLE
    for off, within in ((504, True), (505, False)):
        chip, ticks = board.place(begin - late + sign * off)
        assert board.lib.chip_clock_compare(board.clock, chip, ticks) == within
        assert board.clock.phase_ticks == sign * off - late
        assert board.clock.compared
    board.lib.chip_clock_correct(board.clock, 0, 0, 33, True)
    assert board.clock.phase_ticks == sign * 505 - late
    board.lib.chip_clock_late(board.clock, 0)
    board.plan(2 * CHIPS)
    again = edge + round((board.starts[-1] - edge) / CYCLE) * CYCLE
    assert board.edge(again + 10)
    assert board.clock.phase_ticks == sign * 505 - late


def test_what_is_compared_lies_in_a_planned_chip(core):
    board = Board(core)
    board.plan(200)
    compare = board.lib.chip_clock_compare
    for chip, ticks in ((200, 0), (71, 0), (190, MAXIMUM + 1)):
        assert not compare(board.clock, chip, ticks)
    assert (board.clock.compared, board.clock.phase_ticks) == (False, 0)
    assert not compare(board.clock, 190, MAXIMUM)
    assert board.clock.compared
    assert compare(board.clock, 186, 5)  # The sixth cycle begins there.


def test_an_edge_lies_in_a_planned_chip(core):
    board = Board(core)
    board.plan(200)
    for rejected, (chip, ticks) in enumerate(((200, 0), (71, 0), (190, MAXIMUM + 1)), 1):
        assert not board.lib.chip_clock_edge(board.clock, chip, ticks)
        assert (board.clock.edges_rejected, board.clock.candidate_edges) == (rejected, 0)
    assert not board.lib.chip_clock_edge(board.clock, 190, MAXIMUM)  # The first of two.
    assert (board.clock.edges_rejected, board.clock.candidate_edges) == (3, 1)


def test_a_clock_that_forgets_searches(core):
    """It has the other source's gate, its period, and no edge of before counts."""
    board, edge = used(core)
    period = board.clock.period
    board.lib.chip_clock_forget(board.clock, board.source("link"))
    clock = board.clock
    assert (clock.locked, clock.tracking, clock.compared, clock.detune_ticks, clock.late_ticks) == (0, 0, 0, 0, 0)
    assert clock.source.gate_ticks == 504
    assert clock.period == period
    assert not board.edge(edge + 2 * CYCLE + 77_777)  # The first of two.
    assert clock.edges_rejected == 0
    assert board.edge(edge + 3 * CYCLE + 77_777)
    assert not clock.locked
    for good in range(1, 4):
        board.plan(40)
        begin = max(i for i, chip in enumerate(board.planned) if chip[1] == 0)
        assert board.edge(board.starts[begin])
        assert clock.locked == (good == 3)


def test_a_clock_that_changes_its_source_keeps_the_rest(core):
    """Phase, period, drift and lock; the gains are those of a settled clock from the first edge on."""
    board, edge = used(core)
    clock = board.clock
    clock.detune_ticks = 0
    board.lib.chip_clock_change(clock, board.source("link"))
    assert (clock.locked, clock.tracking, clock.drift, clock.drift_edges, clock.late_ticks) == (1, 1, 7, 32, 6)
    assert (clock.compared, clock.candidate_edges, clock.source.memory_edges) == (0, 0, 16)
    assert board.edge(edge + 2 * CYCLE + 70)
    assert clock.phase_ticks == 70
    begin = edge + 2 * CYCLE
    assert board.begin(begin) - begin == pytest.approx(70 * 62 / 272, abs=0.02)
    assert clock.memory == 16
