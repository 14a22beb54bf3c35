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
