"""Who leads: the waiting by rank, and which of two leaders steps back, both sides of each limit."""

from itertools import pairwise

import pytest

PERIODS_US = {5: (32, 96967), 6: (16, 98530), 7: (8, 99312), 9: (2, 99898), 10: (1, 99996), 11: (1, 200091)}
"""By degree: cycles in a sync period, and its length."""
START = 5_000_000


def election(core, rank, degree=10):
    ffi, lib = core
    made = ffi.new("election_t *")
    lib.election_start(made, rank, *PERIODS_US[degree], START)
    return made


@pytest.mark.parametrize("degree", PERIODS_US)
def test_the_waiting_grows_with_the_rank_and_ends_within_a_second(core, degree):
    _, lib = core
    period = PERIODS_US[degree][1]
    waits = [lib.election_wait_us(election(core, rank, degree), True, START) for rank in range(1, 16)]
    assert waits[0] == period * 9 // 4
    steps = {b - a for a, b in pairwise(waits)}
    assert len(steps) == 1
    assert 30_000 < steps.pop() <= 50_000
    assert waits[-1] <= 950_000


def test_one_lost_sign_is_no_reason_and_two_are(core):
    _, lib = core
    made = election(core, 1)
    lib.election_heard(made, START + 700_000)
    assert not lib.election_due(made, True, START + 700_000 + 2 * 99_996)
    assert lib.election_due(made, True, START + 700_000 + 3 * 99_996)


@pytest.mark.parametrize(("rank", "wait"), [(1, 224_991), (2, 274_991), (15, 924_991)])
def test_a_board_leads_when_its_wait_is_over_and_not_before(core, rank, wait):
    _, lib = core
    made = election(core, rank)
    for in_step in (False, True):  # Nobody else is in step.
        assert not lib.election_due(made, in_step, START + wait - 1)
        assert lib.election_due(made, in_step, START + wait)
    lib.election_heard(made, START + 50_000)
    assert not lib.election_due(made, True, START + 50_000 + wait - 1)
    assert lib.election_due(made, True, START + 50_000 + wait)


def test_rank_0_never_leads(core):
    _, lib = core
    assert not lib.election_due(election(core, 0), True, START + 10**12)


def test_a_board_out_of_step_lets_all_that_are_in_step_lead_first(core):
    _, lib = core
    made = election(core, 1)
    longest = lib.election_wait_us(election(core, 15), True, START)
    lib.election_held(made, START + 400_000)
    assert not lib.election_due(made, False, START + longest + 300_000 - 1)
    assert lib.election_due(made, True, START + 225_000)
    # It counts for a second.
    assert lib.election_wait_us(made, False, START + 1_399_999) == 1_250_000
    assert lib.election_wait_us(made, False, START + 1_400_000) == 224_991


class Rivals:
    """A leader of rank 2 and node 20 that hears another one's SYNCs."""

    def __init__(self, core, degree=10):
        self.ffi, self.lib = core
        self.cycles, self.period = PERIODS_US[degree]
        self.made = election(core, 2, degree)

    def hears(self, number, time_us, rank=1, node=5):
        other = self.ffi.new("election_leader_t *", [rank, node, number % 2**20])
        return self.lib.election_yields(self.made, 20, other, START + int(time_us))


@pytest.mark.parametrize(
    ("rank", "node", "yields"),
    [(1, 4000, True), (2, 19, True), (2, 20, False), (2, 21, False), (3, 1, False), (0, 1, False)],
)
def test_the_lower_rank_keeps_then_the_lower_number(core, rank, node, yields):
    rivals = Rivals(core)
    heard = [rivals.hears(70 + k, k * rivals.period, rank, node) for k in range(6)]
    assert heard == ([False, False, True, False, False, True] if yields else [False] * 6)


@pytest.mark.parametrize("degree", PERIODS_US)
@pytest.mark.parametrize("missing", [0, 1, 2])
def test_numbers_wrap_and_messages_may_be_missing(core, degree, missing):
    rivals = Rivals(core, degree)
    step = (1 + missing) * rivals.cycles
    first = 2**20 - step
    heard = [rivals.hears(first + k * step, k * (1 + missing) * rivals.period) for k in range(3)]
    assert heard == [False, False, True]


@pytest.mark.parametrize(("off", "yields"), [(-0.5, True), (0.5, True), (-0.51, False), (0.51, False)])
def test_a_message_must_come_when_its_number_says(core, off, yields):
    rivals = Rivals(core)
    heard = [rivals.hears(k, (k + (off if k == 2 else 0.0)) * rivals.period) for k in range(3)]
    assert heard[2] == yields


def test_neither_repeats_nor_strays_nor_a_flood_make_a_leader_step_back(core):
    rivals = Rivals(core)
    assert not any(rivals.hears(70, k * rivals.period) for k in range(50))  # One message again and again.
    assert not any(rivals.hears(70 + k, k * 130) for k in range(10_000))  # All the bus carries.
    assert not any(rivals.hears(70 + 4 * k, 4 * k * rivals.period) for k in range(20))  # Each alone.
    assert not any(rivals.hears(70 - k, k * rivals.period) for k in range(50))  # Backwards.
    assert not any(rivals.hears(70 + k, k * rivals.period, node=5 + k % 2) for k in range(50))  # By turns.
    assert [rivals.hears(900 + k, 10**9 + k * rivals.period) for k in range(3)][2]


@pytest.mark.parametrize(("off_us", "yields"), [(-49_998, True), (-49_999, False), (49_998, True), (49_999, False)])
def test_half_a_period_to_the_microsecond(core, off_us, yields):
    """The period is 99,996 us; as much counts before and behind the time that the number says."""
    rivals = Rivals(core)
    heard = [rivals.hears(k, k * rivals.period + (off_us if k == 2 else 0)) for k in range(3)]
    assert heard == [False, False, yields]


@pytest.mark.parametrize(("missing", "yields"), [(2, True), (3, False)])
def test_three_periods_between_two_messages_are_a_row_and_four_are_none(core, missing, yields):
    rivals = Rivals(core, 7)
    step = 1 + missing
    heard = [rivals.hears(70 + k * step * rivals.cycles, k * step * rivals.period) for k in range(3)]
    assert heard == [False, False, yields]


def test_a_rival_that_changes_its_rank_or_its_number_begins_anew(core):
    for rank, node in ((2, 5), (1, 6)):
        rivals = Rivals(core)
        rivals.made.rank = 3
        heard = [rivals.hears(70 + k, k * rivals.period) for k in range(2)]
        heard += [rivals.hears(70 + k, k * rivals.period, rank, node) for k in range(2, 5)]
        assert heard == [False] * 4 + [True]


def test_nothing_is_left_of_what_lay_there_before_the_start(core):
    ffi, lib = core
    made = ffi.new("election_t *")
    ffi.memmove(made, b"\1" * ffi.sizeof("election_t"), ffi.sizeof("election_t"))
    lib.election_start(made, 2, *PERIODS_US[10], START)
    assert lib.election_wait_us(made, False, START) == 274_991  # Nobody is known to be in step.
    assert not lib.election_due(made, True, START + 274_990)
    other = ffi.new("election_leader_t *", [1, 5, 70])
    assert not lib.election_yields(made, 20, other, START)
    assert made.rival_syncs == 1


def test_the_step_by_rank_is_what_the_time_allows(core):
    """50 ms where that fits below 950 ms, else as much less as fifteen ranks need."""
    ffi, lib = core
    for period, step in ((111_111, 50_000), (111_112, 49_999), (250_000, 27_678)):
        waits = []
        for rank in (1, 2, 15):
            made = ffi.new("election_t *")
            lib.election_start(made, rank, 1, period, START)
            waits.append(lib.election_wait_us(made, True, START))
        first = period * 9 // 4
        assert waits == [first, first + step, first + 14 * step]
        assert step == min(50_000, (950_000 - first) // 14)


def test_in_the_first_second_of_a_board_nobody_is_in_step_unless_told(core):
    """The clock begins at 0, and so does the time at which nobody told anything."""
    ffi, lib = core
    made = ffi.new("election_t *")
    lib.election_start(made, 1, *PERIODS_US[10], 0)
    assert lib.election_wait_us(made, False, 500_000) == 224_991
    lib.election_held(made, 0)
    assert lib.election_wait_us(made, False, 500_000) == 1_250_000


def test_a_board_in_step_waits_no_longer_because_others_are(core):
    _, lib = core
    made = election(core, 2)
    lib.election_held(made, START)
    assert lib.election_wait_us(made, True, START + 10) == 274_991
    assert lib.election_wait_us(made, False, START + 10) == 1_300_000


@pytest.mark.parametrize("degree", PERIODS_US)
def test_one_message_that_comes_again_at_once_is_no_row(core, degree):
    """Repeated, and with a number within the same sync period."""
    rivals = Rivals(core, degree)
    assert not any(rivals.hears(7000, 130 * k) for k in range(20))
    assert not any(rivals.hears(7000 + k % rivals.cycles, 10**7 + 130 * k) for k in range(20))
