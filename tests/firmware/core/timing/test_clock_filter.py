"""The chip clock's filter by single edges: the straight line that it begins with, its gains, its drift, its limits."""

from __future__ import annotations

import numpy as np
import pytest

from tests.firmware.core.timing.small_clock import CHIPS, CYCLE, NOMINAL, ONE, Board

MEMORY = {"wire": 6, "link": 16, "field": 16}
GATE = {"wire": 336, "link": 504, "field": 504}
LOCK = 84


@pytest.mark.parametrize("source", MEMORY)
@pytest.mark.parametrize("ahead", [0, 40])
def test_the_first_edges_make_the_straight_line_fitted_to_them(core, source, ahead):
    """As many as the source remembers, however many chips are planned ahead."""
    rng = np.random.default_rng(1)
    board, count = Board(core, source), MEMORY[source]
    edges = np.floor(1e5 + np.arange(count) * CYCLE * (1.0 + 60e-6) + rng.uniform(-30.0, 30.0, count))
    assert not board.edge(edges[0], ahead)
    for k in range(1, count):
        assert board.edge(edges[k], ahead)
        slope, begin = np.polyfit(np.arange(k + 1), edges[: k + 1], 1)
        assert board.period * CHIPS == pytest.approx(slope, abs=1e-2)
        assert board.begin(int(edges[k])) == pytest.approx(begin + k * slope, abs=1e-2)
    assert board.clock.edges_rejected == 0


@pytest.mark.parametrize("source", MEMORY)
@pytest.mark.parametrize("ahead", [0, 40])
@pytest.mark.parametrize("cycles", [1, 2, 3])
@pytest.mark.parametrize("off", [-60, 60])
def test_a_settled_clock_has_the_gains_of_its_memory(core, source, ahead, cycles, off):
    board, k = Board(core, source), MEMORY[source]
    edge = board.settled(edges=20) + cycles * CYCLE
    assert board.edge(edge + off, ahead)
    assert board.begin(edge) - edge == pytest.approx(off * (4 * k - 2) / (k * (k + 1)), abs=1e-3)
    assert board.period - NOMINAL == pytest.approx(off * 6 / (k * (k + 1)) / (cycles * CHIPS), abs=1e-5)


@pytest.mark.parametrize("since", [-800_000, -400_000, -100_000, 5_000, 400_000, 800_000])
@pytest.mark.parametrize("off", [-60, 60])
def test_a_message_has_the_gains_of_its_edge(core, since, off):
    """Whether that came before the moment which it tells of, or is to come."""
    board = Board(core, "link")
    edge = board.settled(edges=20) + 3 * CYCLE
    assert board.lib.chip_clock_message(board.clock, board.mark(edge + off + since), since)
    assert board.begin(edge) - edge == pytest.approx(off * 62 / 272, abs=1e-3)
    assert board.period - NOMINAL == pytest.approx(off * 6 / 272 / (3 * CHIPS), abs=1e-5)
    assert board.clock.phase_ticks == off


@pytest.mark.parametrize("source", GATE)
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("ahead", [0, 40])
def test_an_edge_within_the_gate_counts(core, source, sign, ahead):
    for off, counts in ((GATE[source], True), (GATE[source] + 1, False)):
        board = Board(core, source)
        edge = board.settled(edges=20) + CYCLE
        assert board.edge(edge + sign * off, ahead) == counts
        assert board.clock.edges_rejected == (not counts)
        assert (board.period == NOMINAL) != counts


@pytest.mark.parametrize("source", GATE)
@pytest.mark.parametrize("sign", [-1, 1])
def test_the_lock_holds_within_half_a_microsecond_of_phase(core, source, sign):
    for off, holds in ((LOCK, True), (LOCK + 1, False)):
        board = Board(core, source)
        edge = board.settled(edges=20) + CYCLE
        assert board.edge(edge + sign * off)
        assert board.clock.phase_ticks == sign * off
        assert board.clock.locked == holds


def on_the_own_edge(board):
    """Take an edge where the clock's next cycle begins."""
    board.plan(40)
    begin = max(i for i, chip in enumerate(board.planned) if chip[1] == 0)
    assert board.edge(board.starts[begin])
    assert abs(board.clock.phase_ticks) <= 1


def test_three_good_edges_make_the_lock_and_many_keep_it(core):
    board = Board(core)
    board.edge(board.settled() + CYCLE + LOCK + 1)
    for good in range(6):
        assert board.clock.locked == (good >= 3)
        on_the_own_edge(board)


def test_three_edges_lock_again_after_hold_over(core):
    """It ends with the hundred-and-first cycle that begins without an edge."""
    board = Board(core)
    edge = board.settled()
    for cycle in range(1, 103):
        board.until(edge + cycle * CYCLE)
        assert board.clock.locked == (cycle <= 100), cycle
    for good in range(4):
        assert board.clock.locked == (good >= 3)
        on_the_own_edge(board)


@pytest.mark.parametrize("near", [-300, 0, 20, 300])
def test_a_cycle_has_one_edge(core, near):
    """Another one near it is rejected, and so is one of a cycle that had begun before."""
    board = Board(core)
    edge = board.settled()
    before = board.clock.target
    assert not board.edge(max(edge + near, edge - 300))
    assert not board.edge(edge - CYCLE + near, 0)
    assert board.clock.edges_rejected == 2
    assert board.clock.target == before
    assert board.clock.locked


def test_rejected_edges_are_counted_up_to_the_largest_number(core):
    board = Board(core)
    board.clock.edges_rejected = 2**32 - 2
    for _ in range(2):
        board.lib.chip_clock_edge(board.clock, 0, 0)
        assert board.clock.edges_rejected == 2**32 - 1


@pytest.mark.parametrize("ppm", [-299, -301, 299, 301, -100_000, 100_000])
def test_a_period_is_within_300_ppm(core, ppm):
    board = Board(core)
    period = ONE * NOMINAL * (1_000_000 + ppm) // 1_000_000
    board.lib.chip_clock_jump(board.clock, 0, period)
    limited = min(max(ppm, -300), 300)
    assert board.period / NOMINAL - 1.0 == pytest.approx(limited * 1e-6, abs=1e-10)
    board.lib.chip_clock_jump(board.clock, 0, ONE * NOMINAL)
    board.lib.chip_clock_correct(board.clock, 0, period - ONE * NOMINAL, 0, True)
    assert board.period / NOMINAL - 1.0 == pytest.approx(limited * 1e-6, abs=1e-10)


# ---- Drift ----


@pytest.mark.parametrize("sign", [-1, 1])
def test_an_outlier_tells_no_more_drift_than_one_ppm_a_second(core, sign):
    board = Board(core)
    edge = board.settled(edges=5) + CYCLE
    board.edge(edge + sign * 300)  # The sixth: it is the first that the drift is told by.
    assert board.clock.drift == sign * (ONE // 600)


@pytest.mark.parametrize("cycles", [1, 2, 3])
def test_the_drift_is_the_mean_change_in_a_cycle(core, cycles):
    board = Board(core, "link")
    edge = board.settled(edges=19) + cycles * CYCLE  # The sixteenth was the first of four.
    board.edge(edge - 2)
    change = board.clock.period - ONE * NOMINAL
    assert board.clock.drift == pytest.approx(change / cycles / 5, abs=3)


N, PER_CYCLE = 255, 0.0008
"""A cycle, and how many ticks the chip lasts longer in each."""


def drifting(core, settled_edges, sign):
    """A board that follows a master whose chip becomes longer, up to some edges after the filter has settled."""
    board = Board(core, "link", chips=N)
    count = MEMORY["link"] + settled_edges - 1
    lengths = N * (NOMINAL + sign * PER_CYCLE * np.arange(count - 1))
    edges = np.floor(1e5 + np.concatenate([[0.0], np.cumsum(lengths)]) + 0.5)
    periods = []
    for edge in edges:
        board.edge(edge)
        periods.append(board.clock.period)
    return board, periods[-1 - settled_edges :]


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("settled_edges", "learnt"), [(31, False), (32, True), (60, True)])
def test_a_learnt_drift_goes_on_in_hold_over(core, sign, settled_edges, learnt):
    """After 32 edges and no less. The lock ends when the drift could have moved the phase by half a microsecond."""
    board, periods = drifting(core, settled_edges, sign)
    clock, d = board.clock, board.clock.drift / ONE
    if settled_edges <= 32:
        assert d * settled_edges == pytest.approx((periods[-1] - periods[0]) / ONE, abs=1e-6)
    assert d == pytest.approx(sign * PER_CYCLE, rel=0.1 if learnt else 0.2)
    allowed = int(np.sqrt(2.0 * LOCK / (abs(d) * N))) if learnt else 5
    held = [clock.period / ONE]
    for missed in range(1, allowed + 2):
        board.plan(N - clock.code_chip)
        assert clock.locked == (missed <= allowed or not learnt)
        held.append(clock.period / ONE)
    change = np.diff(held)
    assert change[0] == 0.0  # A cycle that has just begun has not missed its edge.
    assert change[2:] == pytest.approx(d if learnt else 0.0, abs=1e-9)
    if learnt:  # The filter's rate is that of alpha / beta cycles ago.
        k = MEMORY["link"]
        assert change[1] / d == pytest.approx(1.0 + (4 * k - 2) / 6.0, abs=0.5)
        masters = NOMINAL + sign * PER_CYCLE * (k + settled_edges)
        assert held[2] == pytest.approx(masters, abs=3.0 * PER_CYCLE)
    else:
        assert change[1] == 0.0


def test_the_drift_is_left_alone_after_a_thousand_cycles(core):
    board = Board(core)
    board.settled()
    board.clock.drift, board.clock.drift_edges = ONE // 1000, 32
    board.plan(999 * CHIPS)
    for _ in range(5):
        before, cycles = board.clock.period, board.clock.cycle - board.clock.edge_cycle
        board.plan(CHIPS - board.clock.code_chip)
        assert board.clock.period - before == (ONE // 1000 if cycles + 1 <= 1000 else 0)
    assert cycles > 1000


# ---- Search ----


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("cycles", "ticks"), [(1, 152), (2, 305), (3, 458), (4, 610)])
def test_two_edges_whole_cycles_apart_are_a_master(core, sign, cycles, ticks):
    """To 300 ppm, and four cycles at most."""
    for off, found in ((ticks, True), (ticks + 1, False)):
        board = Board(core)
        assert not board.edge(1e5)
        assert board.edge(1e5 + cycles * CYCLE + sign * off) == found
        assert board.clock.tracking == found
        assert board.clock.edges_rejected == (not found)
        if found:
            assert board.period == pytest.approx(NOMINAL * (1.0 + sign * off / (cycles * CYCLE)), abs=1e-4)


def test_edges_five_cycles_apart_are_no_master(core):
    board = Board(core)
    board.edge(1e5)
    assert not board.edge(1e5 + 5 * CYCLE)
    assert board.edge(1e5 + 6 * CYCLE)  # The later one is what the next is compared with.


@pytest.mark.parametrize(
    ("apart", "kept"), [(0.4, "first"), (0.99, "first"), (1.01, "second"), (1.5, "second"), (3.5, "second")]
)
def test_of_two_edges_that_do_not_fit_the_first_is_kept_for_a_cycle(core, apart, kept):
    for of in ("first", "second"):
        board, second = Board(core), 1e5 + round(apart * CYCLE)
        board.edge(1e5)
        assert not board.edge(second)
        assert board.clock.edges_rejected == 1
        third = 1e5 + 4 * CYCLE if of == "first" else second + CYCLE
        assert board.edge(third) == (of == kept)


def test_an_edge_of_long_ago_is_compared_with_nothing(core):
    """Positions wrap after 25 s: an edge that seems to be a cycle later is not."""
    board = Board(core, nominal=60_000)
    board.edge(1e5)
    assert not board.edge(1e5 + ONE + board.cycle)
    assert not board.clock.tracking
    assert board.clock.edges_rejected == 1
    assert board.edge(1e5 + ONE + 2 * board.cycle)


def test_a_master_that_moved_is_followed_from_its_third_edge(core):
    """Three of its edges may be missing each time; an edge of the own master between them begins the count anew."""
    for cycles in ((1, 2, 3), (1, 3, 4), (1, 2, 6), (1, 5, 9)):
        board = Board(core)
        moved = board.settled() + 77_777
        found = [board.edge(moved + cycle * CYCLE) for cycle in cycles]
        assert found == [False, False, True]
        assert not board.clock.locked
        assert board.clock.edges_rejected == 3
        assert board.begin(int(moved)) == pytest.approx(moved, abs=1e-3)
    board = Board(core)
    own = board.settled()
    for cycle in (1, 2):
        assert not board.edge(own + cycle * CYCLE + 77_777)
    assert board.edge(own + 3 * CYCLE)
    for cycle in (3, 4):
        assert not board.edge(own + cycle * CYCLE + 77_777)
    assert board.clock.locked


@pytest.mark.parametrize("later", [0, 40_000])
def test_two_moments_of_one_cycle_are_no_master(core, later):
    """Messages of one moment or of two that tell of the same edge are as good as one."""
    board = Board(core, "link")
    lib, edge = board.lib, 100_000
    board.until(edge + 5 * CYCLE)
    for since in (1000, 1000 + later):
        assert not lib.chip_clock_message(board.clock, board.mark(edge + 3 * CYCLE + since), since)
    assert not board.clock.tracking
    assert lib.chip_clock_message(board.clock, board.mark(edge + 4 * CYCLE + 500), 500)
    assert board.period == NOMINAL
