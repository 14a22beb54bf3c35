"""What keeps a drive off, for how long, and over which resets."""

import pytest

S = 1_000_000
NONE, OVER, DRIVER, WATCHDOG = 0, 1, 3, 12


class Memory:
    """Words that outlive a reset, and the latch of each life."""

    def __init__(self, core):
        self.ffi, self.lib = core
        self.kept = self.ffi.new("uint32_t[2]")
        self.reset(watchdog=False)

    def reset(self, watchdog, now=0):
        self.latch = self.ffi.new("latch_t *")
        self.lib.latch_start(self.latch, self.kept, watchdog, now)

    def trip(self, cause, now):
        self.lib.latch_set(self.latch, cause)
        self.lib.latch_step(self.latch, now)

    def may_drive(self, now):
        self.lib.latch_step(self.latch, now)
        return self.lib.latch_open(self.latch)

    def clear(self, now):
        return self.lib.latch_clear(self.latch, now)

    def on(self, on=True):
        self.lib.latch_on(self.latch, on)


@pytest.fixture
def memory(core):
    return Memory(core)


def test_a_board_with_power_may_drive(memory):
    assert memory.may_drive(0)
    assert (memory.latch.trips, memory.latch.locked_out) == (0, False)


def test_the_first_cause_stays_until_it_is_cleared(memory):
    memory.trip(OVER, 0)
    memory.trip(DRIVER, S)
    assert memory.latch.cause == OVER
    assert not memory.may_drive(3600 * S)
    assert memory.clear(3600 * S)
    assert memory.latch.cause == NONE
    assert memory.may_drive(3600 * S)


@pytest.mark.parametrize(("given", "kept"), [(12, 12), (13, WATCHDOG), (0x30, WATCHDOG), (NONE, WATCHDOG)])
def test_a_cause_that_is_none_is_told_as_the_processors(memory, given, kept):
    """One with more bits than a cause has was told as none, and its other bits were kept as trips."""
    memory.trip(given, 0)
    assert memory.latch.cause == kept
    memory.reset(watchdog=False)
    assert (memory.latch.cause, memory.latch.trips) == (kept, 1)
    assert not memory.may_drive(3600 * S)


def test_each_trip_in_a_row_waits_twice_as_long(memory):
    now = 0
    for wait in (1, 2, 4, 8):
        memory.trip(OVER, now)
        assert memory.clear(now + 1)
        assert not memory.may_drive(now + wait * S - 1)
        assert memory.lib.latch_wait_s(memory.latch, now + wait * S - 1) == 1
        assert memory.may_drive(now + wait * S)
        now += 100 * S


def test_after_five_in_a_row_it_is_locked_out_over_any_reset(memory):
    for trip in range(5):
        assert memory.may_drive(100 * S * trip)
        memory.trip(OVER, 100 * S * trip)
        assert memory.clear(100 * S * trip + 1) == (trip < 4)
    for watchdog in (False, True):
        memory.reset(watchdog)
        assert memory.latch.locked_out
        assert not memory.clear(1000 * S)
        assert not memory.may_drive(1000 * S)
    memory.kept[0] = memory.kept[1] = 0  # Power off and on.
    memory.reset(watchdog=False)
    assert memory.may_drive(0)


@pytest.mark.parametrize("watchdog", [False, True])
def test_a_cause_outlives_a_reset_and_is_counted_once(memory, watchdog):
    memory.trip(OVER, 5 * S)
    memory.reset(watchdog)
    assert (memory.latch.cause, memory.latch.trips) == (OVER, 1)
    assert not memory.may_drive(100 * S)
    assert memory.clear(100 * S)
    assert memory.may_drive(100 * S)


def test_a_cause_that_nobody_had_time_to_count_outlives_a_reset(memory):
    memory.on()
    memory.lib.latch_set(memory.latch, OVER)
    memory.reset(watchdog=True)
    assert (memory.latch.cause, memory.latch.trips) == (OVER, 1)


def test_a_watchdog_that_struck_while_driving_has_it_wait_and_locks_out_in_the_end(memory):
    for wait in (1, 2, 4, 8):
        memory.on()
        memory.reset(watchdog=True)
        assert memory.latch.cause == NONE
        assert not memory.may_drive(wait * S - 1)
        assert memory.may_drive(wait * S)
    memory.on()
    memory.reset(watchdog=True)
    assert (memory.latch.cause, memory.latch.locked_out) == (WATCHDOG, True)
    assert not memory.may_drive(10**6 * S)


def test_a_watchdog_that_struck_while_nothing_was_driven_is_no_trip(memory):
    memory.on()
    memory.on(False)
    memory.reset(watchdog=True)
    assert memory.may_drive(0)
    memory.on()
    memory.reset(watchdog=False)  # Somebody pressed the button.
    assert memory.may_drive(0)


def test_ten_good_minutes_end_the_row(memory):
    memory.trip(OVER, 0)
    memory.clear(1)
    memory.on()
    memory.may_drive(S)
    memory.may_drive(601 * S - 1)
    assert memory.latch.trips == 1
    memory.may_drive(601 * S)
    assert memory.latch.trips == 0


def test_minutes_with_the_bridge_off_do_not_count(memory):
    memory.trip(OVER, 0)
    memory.clear(1)
    for minute in range(1, 20):
        memory.on(minute % 5 != 0)
        memory.may_drive(60 * S * minute)
    assert memory.latch.trips == 1


@pytest.mark.parametrize(("word", "check"), [(0xFFFFFFFF, 0xFFFFFFFF), (0xC0110051, 0x12345678), (0x00000011, ~0x11)])
def test_words_that_nobody_wrote_count_as_power_on(memory, word, check):
    memory.kept[0], memory.kept[1] = word, check & 0xFFFFFFFF
    memory.reset(watchdog=True)
    assert memory.may_drive(0)
    assert memory.kept[0] == ~memory.kept[1] & 0xFFFFFFFF


def test_who_is_switched_off_no_longer_counts_as_driving(memory):
    """A watchdog that strikes behind a trip which was cleared is none more."""
    memory.on()
    memory.trip(OVER, 0)
    memory.clear(1)
    memory.reset(watchdog=True)
    assert memory.latch.trips == 1


def test_what_is_left_of_a_wait_begins_anew_with_a_reset(memory):
    """After each trip of a row that was cleared: 2^(n-1) s from the reset, with no cause."""
    for trip, wait in enumerate((1, 2, 4, 8)):
        memory.trip(OVER, 1000 * S * trip)
        memory.clear(1000 * S * trip + 1)
        memory.reset(watchdog=False, now=7 * S)
        assert (memory.latch.cause, memory.latch.trips) == (NONE, trip + 1)
        assert not memory.may_drive(7 * S + wait * S - 1)
        assert memory.may_drive(7 * S + wait * S)


MARK = 0xC0110000


@pytest.mark.parametrize(
    ("word", "spoilt", "cause", "trips", "locked_out"),
    [
        (MARK | 0x41, 0, OVER, 4, False),
        (MARK | 0x51, 0, OVER, 5, True),
        (MARK | 0x50, 0, WATCHDOG, 5, True),
        (MARK | 0x40, 0, NONE, 4, False),
        (MARK | 0x61, 0, NONE, 0, False),
        (MARK | 0x60, 0, NONE, 0, False),
        (MARK | 0x41, 1, NONE, 0, False),
        (MARK | 0x41, 1 << 31, NONE, 0, False),
        (MARK ^ 1 << 31 | 0x41, 0, NONE, 0, False),
        (MARK ^ 1 << 16 | 0x41, 0, NONE, 0, False),
    ],
)
def test_words_that_no_latch_wrote_count_as_power_on(memory, word, spoilt, cause, trips, locked_out):
    memory.kept[0], memory.kept[1] = word, ~word & 0xFFFFFFFF ^ spoilt
    memory.reset(watchdog=False)
    latch = memory.latch
    assert (latch.cause, latch.trips, latch.locked_out) == (cause, trips, locked_out)
    assert memory.kept[1] == ~memory.kept[0] & 0xFFFFFFFF
    assert memory.kept[0] == MARK | trips << 4 | cause


def test_a_reset_within_the_first_second_counts_the_cause_once(memory):
    """With no trip before, and as often as it is reset."""
    memory.on()
    memory.lib.latch_set(memory.latch, OVER)
    for _ in range(3):
        memory.reset(watchdog=False)
        assert (memory.latch.cause, memory.latch.trips) == (OVER, 1)
        memory.lib.latch_step(memory.latch, 10)
        assert memory.latch.trips == 1


@pytest.mark.parametrize(("left_us", "seconds"), [(0, 0), (1, 1), (999_999, 1), (S, 1), (S + 1, 2), (2 * S, 2)])
def test_seconds_to_wait_are_rounded_up(memory, left_us, seconds):
    memory.trip(OVER, 0)
    memory.clear(1)
    memory.trip(OVER, 10 * S)
    assert memory.lib.latch_wait_s(memory.latch, 12 * S - left_us) == seconds
    assert memory.lib.latch_wait_s(memory.latch, 13 * S) == 0


def test_the_row_ends_only_with_the_bridge_on_throughout(memory):
    """Ten minutes less a step, a pause, and ten minutes again."""
    memory.trip(OVER, 0)
    memory.clear(1)
    memory.on()
    memory.may_drive(2 * S)
    memory.may_drive(601 * S)
    memory.on(False)
    memory.may_drive(601 * S + 1)
    memory.on()
    memory.may_drive(700 * S)
    memory.may_drive(1300 * S - 1)
    assert memory.latch.trips == 1
    memory.may_drive(1300 * S)
    assert memory.latch.trips == 0
    memory.reset(watchdog=False)
    assert memory.latch.trips == 0


def test_a_row_never_grows_beyond_the_one_that_locks_out(memory):
    """Five trips, no cause and the bridge on: no latch writes that, and the watchdog's trip is not a sixth."""
    memory.kept[0], memory.kept[1] = MARK | 0x1050, ~(MARK | 0x1050) & 0xFFFFFFFF
    memory.reset(watchdog=True)
    assert (memory.latch.cause, memory.latch.trips, memory.latch.locked_out) == (WATCHDOG, 5, True)
    assert not memory.clear(1000 * S)


def test_a_trip_is_not_forgotten_in_the_step_that_counts_it(memory):
    """The bridge was on for longer than ends a row, and is said to be on again before anybody counted the trip."""
    memory.on()
    memory.may_drive(S)
    memory.lib.latch_set(memory.latch, OVER)
    memory.on()
    memory.lib.latch_step(memory.latch, 700 * S)
    assert memory.latch.trips == 1
    memory.lib.latch_step(memory.latch, 1300 * S - 1)
    assert memory.latch.trips == 1
    memory.lib.latch_step(memory.latch, 1300 * S)
    assert memory.latch.trips == 0


def test_a_cause_behind_a_watchdog_is_a_trip_of_its_own(memory):
    memory.on()
    memory.reset(watchdog=True)
    assert (memory.latch.cause, memory.latch.trips) == (NONE, 1)
    memory.trip(OVER, 5 * S)
    assert (memory.latch.cause, memory.latch.trips) == (OVER, 2)
    assert memory.clear(5 * S + 1)
    assert not memory.may_drive(7 * S - 1)
    assert memory.may_drive(7 * S)


def test_a_cause_that_is_cleared_before_the_next_step_is_counted_all_the_same(memory):
    memory.lib.latch_set(memory.latch, OVER)
    assert memory.clear(3 * S)
    assert memory.latch.trips == 1
    assert not memory.may_drive(4 * S - 1)
    assert memory.may_drive(4 * S)


def test_a_board_that_never_tripped_is_open_at_once(memory):
    memory.reset(watchdog=False, now=5 * S)
    assert memory.lib.latch_open(memory.latch)


def test_the_wait_of_a_lock_out_by_the_watchdog_begins_with_the_reset(memory):
    memory.kept[0], memory.kept[1] = MARK | 0x1040, ~(MARK | 0x1040) & 0xFFFFFFFF
    memory.reset(watchdog=True)
    assert (memory.latch.cause, memory.latch.locked_out) == (WATCHDOG, True)
    memory.lib.latch_step(memory.latch, 10 * S)
    assert memory.lib.latch_wait_s(memory.latch, 10 * S) == 6
