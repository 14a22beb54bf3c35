"""What acquire.c decides, call by call: the list, the clock, the record and the search."""

from __future__ import annotations

import numpy as np
import pytest

from tests.firmware.core.timing.acquire_parts import (
    AGAIN,
    AMPLITUDES,
    CHIP_TICKS,
    CHIPS,
    CODES,
    CONVERSION,
    CORRECT,
    DETUNE,
    EDGE,
    EXTRA,
    FIRST_HOLD,
    HALVES,
    JUMP,
    MEASURING,
    NONE,
    ONE,
    RECORDING,
    SWEEP,
    TARGET,
    TRACKING,
    TRANSFORMING,
    amplitudes_of,
    board,
    fill,
    load,
    new,
    searched,
    state,
    used,
)
from tests.firmware.core.timing.test_acquire import BLOCK_S, start


@pytest.fixture(scope="module")
def core():
    return load()


@pytest.fixture(scope="module")
def family(gold_family):
    return gold_family(10)


def test_a_start_forgets_everything_but_the_boards_times(core):
    acquire, size = new(core), core[0].sizeof("acquire_config_t")
    assert state(core, acquire)[:size] == state(core, board(core))
    assert not any(state(core, acquire)[size:])


def test_the_last_conversion_lies_on_the_foot_of_the_ramp(core):
    """When own chips begin so late, the last conversion of each is the target behind the beacons' next edge."""
    late = core[1].acquire_late_ticks(board(core))
    assert late + FIRST_HOLD + 7 * CONVERSION == CHIP_TICKS + TARGET


# ---- The list ----


def test_a_new_list_begins_a_search_and_the_same_changes_nothing(core):
    lib, acquire = core[1], new(core)
    lib.acquire_codes(acquire, [], 0)
    assert (acquire.searches, acquire.command, acquire.code_count) == (1, SWEEP, 0)
    lib.acquire_codes(acquire, [], 0)
    assert acquire.searches == 1
    for searches, codes in enumerate(([5, 6, 7], [5, 6], [5, 8], [8, 5], [5, 6, 7]), 2):
        for _ in range(2):
            acquire.stage, acquire.command, acquire.list_first = AMPLITUDES, NONE, 0
            before = acquire.searches
            lib.acquire_codes(acquire, codes, len(codes))
            again = acquire.searches > before
            assert (acquire.stage, acquire.command) == ((RECORDING, SWEEP) if again else (AMPLITUDES, NONE))
        assert acquire.searches == searches
        assert used(acquire) == codes
        assert (acquire.tracking, acquire.length, acquire.cut) == (False, CHIPS, HALVES)


def test_codes_that_do_not_exist_and_those_beyond_64_are_left_out(core):
    acquire = new(core, [1025, 1024, 0, 65535, *range(100, 161), 7, 8, 9])
    assert list(acquire.list[0 : acquire.list_count]) == [1024, 0, *range(100, 161), 7]
    assert used(acquire) == [1024, 0, *range(100, 114)]
    core[1].acquire_codes(acquire, list(range(63)), 63)
    assert acquire.list_count == 63


@pytest.mark.parametrize("count", [1, 15, 16, 17, 40])
def test_sixteen_codes_are_used_at_a_time(core, count):
    """A search without a peak goes on with the next, round and round."""
    codes = list(range(200, 200 + count))
    acquire, first = new(core, codes), 0
    for searches in range(2, 6):
        searched(core, acquire, 5, 9.9)
        core[1].acquire_step(acquire)
        first = (first + min(count, 16)) % count
        assert acquire.list_first == first
        assert used(acquire) == [codes[(first + i) % count] for i in range(min(count, 16))]
        assert (acquire.searches, acquire.command, acquire.tracking) == (searches, SWEEP, False)
    core[1].acquire_codes(acquire, [3, 4], 2)
    assert (acquire.list_first, used(acquire)) == (0, [3, 4])


def test_a_search_for_nothing_goes_on(core):
    acquire = new(core, [])
    for searches in (2, 3):
        searched(core, acquire, 5, 9.9)
        core[1].acquire_step(acquire)
        assert (acquire.list_first, acquire.code_count, acquire.searches) == (0, 0, searches)


# ---- The clock ----


def new_clock(core):
    ffi, lib = core
    clock = ffi.new("chip_clock_t *")
    assert lib.chip_clock_init(clock, ffi.new("chip_clock_config_t *", [CHIPS, CHIP_TICKS, 16000, 16900, True]))
    lib.chip_clock_forget(clock, ffi.addressof(lib, "chip_clock_field"))
    for _ in range(100):
        lib.chip_clock_plan(clock)
    lib.chip_clock_jump(clock, 7 * ONE, CHIP_TICKS * ONE)
    for _ in range(100):
        lib.chip_clock_plan(clock)
    clock.locked = True
    return clock


@pytest.mark.parametrize("command", [NONE, SWEEP, JUMP, CORRECT, AGAIN])
def test_a_command_is_carried_out_once(core, command):
    """As the clock itself does it; a record then waits for its chips."""
    lib = core[1]
    acquire, clock, same = new(core, CODES), new_clock(core), new_clock(core)
    acquire.command, acquire.recorded, acquire.count, clock.detune_ticks = command, 1, 55, 7
    acquire.edge_position, acquire.edge_period = 12345 * ONE, (CHIP_TICKS + 1) * ONE
    acquire.phase_change, acquire.rate_change, acquire.rate_chip = 50.0, -0.125, clock.chip - 150
    acquire.residual_ticks, acquire.good = -33, True
    before = state(core, acquire)
    lib.acquire_plan(acquire, clock)
    same.detune_ticks = {NONE: 7, SWEEP: DETUNE}.get(command, 0)
    if command == SWEEP:
        same.locked = False
    elif command == JUMP:
        lib.chip_clock_jump(same, 12345 * ONE, (CHIP_TICKS + 1) * ONE)
    elif command == CORRECT:
        lib.chip_clock_correct(same, int(31.25 * ONE), -ONE // 8, -33, True)  # The rate has run for 150 chips.
    assert state(core, clock) == state(core, same)
    if command == NONE:
        assert state(core, acquire) == before
    else:
        assert (acquire.command, acquire.filling, acquire.recorded, acquire.count) == (NONE, True, 0, 0)
        assert acquire.period == clock.period
    if command in (SWEEP, AGAIN):
        assert acquire.from_chip == clock.chip + 2
    lib.acquire_plan(acquire, clock)
    assert state(core, clock) == state(core, same)


@pytest.mark.parametrize("away", [-6000, -4221, -4219, -500, -1, 0, 1, 500, 4779, 4781, 8000])
def test_a_record_begins_when_the_clock_has_slewed(core, away):
    """Two chips of reserve, since the clocks' rates differ."""
    lib, acquire, clock = core[1], new(core, CODES), new_clock(core)
    acquire.command = AGAIN
    clock.target = (clock.target + away * ONE) % 2**64
    lib.acquire_plan(acquire, clock)
    first, planned = clock.chip, 0
    while abs((clock.target - clock.position * ONE) / ONE) > 0.5:
        lib.chip_clock_plan(clock)
        planned += 1
    assert 1 <= acquire.from_chip - (first + planned) <= 2


def feed(core, acquire, chip, burst=None, place=None):
    ffi, lib = core
    planned = ffi.new("chip_clock_chip_t *", [9, chip % CHIPS, CHIP_TICKS, chip * 16000 % 2**32])
    burst = np.full((8, 3), 2048, dtype=np.uint16) if burst is None else burst
    lib.acquire_feed(acquire, chip % 2**32, planned, ffi.from_buffer("uint16_t[8][3]", burst))


@pytest.mark.parametrize("first", [1000, 2**32 - 300])
@pytest.mark.parametrize("cut", [HALVES, TRACKING])
def test_a_record_is_so_many_chips_from_the_first_allowed_on(core, first, cut):
    ffi, lib = core
    acquire, rng = new(core, CODES), np.random.default_rng(1)
    acquire.from_chip, acquire.filling, acquire.length, acquire.cut = first, True, 341, cut
    bursts = rng.integers(0, 4095, (341, 8, 3), dtype=np.uint16, endpoint=True)
    for chip in (first - 2, first - 1):
        feed(core, acquire, chip)
        assert acquire.count == 0
    for i, burst in enumerate(bursts):
        assert (acquire.recorded, acquire.filling) == (0, True)
        feed(core, acquire, first + i, burst)
        assert acquire.count == i + 1
    assert (acquire.recorded, acquire.filling, acquire.first_chip) == (1, False, first)
    assert (acquire.first_position, acquire.first_code_chip) == (first * 16000 % 2**32, first % CHIPS)
    expected = ffi.new("acquire_record_t *")
    for i, burst in enumerate(bursts):
        lib.record_burst(expected, i, cut, ffi.from_buffer("uint16_t[8][3]", burst))
    assert state(core, ffi.addressof(acquire, "record")) == state(core, expected)
    feed(core, acquire, first + 341)
    assert acquire.count == 341


def test_a_gap_begins_the_record_anew(core):
    acquire = new(core, CODES)
    acquire.from_chip, acquire.filling, acquire.length = 50, True, CHIPS
    for chip, count in ((60, 1), (61, 2), (63, 1), (64, 2), (64, 1), (70, 1), (71, 2)):
        feed(core, acquire, chip)
        assert acquire.count == count
    assert (acquire.first_chip, acquire.first_code_chip, acquire.first_position) == (70, 70, 70 * 16000)


# ---- The search ----


def test_each_code_is_correlated_with_the_record_that_slid(core, family):
    ffi, lib = core
    acquire, rng = new(core, CODES[:3]), np.random.default_rng(2)
    kept = np.frombuffer(ffi.buffer(acquire.record.field), dtype=np.int16).reshape(CHIPS, 3)
    kept[:] = rng.normal(0.0, 1000.0, (CHIPS, 3))
    search = ffi.new("code_search_t *")
    for tracking, chip_length in ((False, 1.0 + DETUNE / CHIP_TICKS), (True, 1.0)):
        acquire.tracking, acquire.code, acquire.stage = tracking, 55, RECORDING
        acquire.captures, acquire.command, acquire.recorded = 3, NONE, 1
        if tracking:  # A record of a clock that is in step is searched when the codes are silent.
            acquire.code_count = 0
            lib.acquire_step(acquire)
            assert acquire.stage == MEASURING
            lib.acquire_step(acquire)
            assert acquire.silent
            acquire.code_count = 3
        else:
            lib.acquire_step(acquire)
        assert (acquire.stage, acquire.code) == (TRANSFORMING, 0)
        lib.code_search_start(search, ffi.addressof(acquire, "record"), chip_length)
        for code in CODES[:3]:
            lib.acquire_step(acquire)
            lib.code_search_add(search, code)
            assert list(acquire.search.metric) == list(search.metric)
        assert acquire.stage == TRANSFORMING
        lib.acquire_step(acquire)
        assert acquire.stage != TRANSFORMING


@pytest.mark.parametrize("pending", [(SWEEP, 1), (NONE, 0), (NONE, 1)])
def test_main_waits_for_the_record_and_for_its_command(core, pending):
    acquire = new(core, CODES)
    acquire.command, acquire.recorded = pending
    core[1].acquire_step(acquire)
    assert acquire.stage == (TRANSFORMING if pending == (NONE, 1) else RECORDING)


@pytest.mark.parametrize("height", [9.9, 10.1])
def test_a_peak_of_ten_times_the_mean_is_one(core, height):
    acquire = new(core, CODES)
    searched(core, acquire, 700, height)
    setattr(acquire, "pass", 7)
    core[1].acquire_step(acquire)
    assert acquire.peak == pytest.approx(height, rel=1e-4)
    if height < 10.0:
        assert (acquire.stage, acquire.command, acquire.searches) == (RECORDING, SWEEP, 2)
    else:
        frame = acquire.frame
        assert (acquire.stage, acquire.code, getattr(acquire, "pass"), acquire.searches) == (AMPLITUDES, 0, 0, 1)
        assert (frame.sliding, frame.label, frame.crossing) == (True, 700, 0.5)


@pytest.mark.parametrize("height", [9.9, 10.1])
@pytest.mark.parametrize("first", [0, 1, 500, 1022])
@pytest.mark.parametrize("away", [-2, -1, 0, 1, 2, 500])
def test_codes_that_come_back_elsewhere_are_searched(core, height, first, away):
    """At the own phase, to a chip, the clock is left alone: the edge lies between the peak's label and the next."""
    acquire = new(core, CODES)
    acquire.tracking, acquire.captures, acquire.first_code_chip = True, 3, first
    searched(core, acquire, (first + away) % CHIPS, height)
    core[1].acquire_step(acquire)
    elsewhere = height > 10.0 and away not in (-1, 0)
    assert (acquire.command, acquire.stage) == (SWEEP if elsewhere else AGAIN, RECORDING)
    assert (acquire.searches, acquire.tracking) == (1 + elsewhere, not elsewhere)


@pytest.mark.parametrize("count", [1, 4, 5, 8])
def test_a_search_estimates_four_codes_a_turn_and_all_of_them_twice(core, family, count):
    ffi, lib = core
    acquire, rng = new(core, CODES[:count]), np.random.default_rng(3)
    fill(core, acquire, family, CODES[:count], amplitudes_of(rng, count), 0.3, 5.0, rng)
    searched(core, acquire, 700, 20.0)
    lib.acquire_step(acquire)
    field = ffi.new("code_field_t *")
    lib.code_field_start(field, ffi.addressof(acquire, "record"), ffi.addressof(acquire, "frame"))
    for _ in range(2):
        for first in range(0, count, 4):
            assert acquire.stage == AMPLITUDES
            lib.acquire_step(acquire)
            for number in range(first, min(first + 4, count)):
                lib.code_field_subtract(field, number, CODES[number])
            names = ("amplitude", "expected", "residual")
            assert [state(core, getattr(acquire.field, n)) for n in names] == [
                state(core, getattr(field, n)) for n in names
            ]
    assert (acquire.stage, acquire.code) == (EDGE, 0)


def test_a_search_without_an_edge_begins_anew(core, family):
    acquire, rng = new(core, CODES), np.random.default_rng(4)
    fill(core, acquire, family, CODES, 0.0 * amplitudes_of(rng, 8), 0.0, 300.0, rng)
    searched(core, acquire, 700, 20.0)
    for _ in range(6):
        core[1].acquire_step(acquire)
    assert (acquire.stage, acquire.command, acquire.searches, acquire.tracking) == (RECORDING, SWEEP, 2, False)


@pytest.mark.parametrize("seed", range(4))
def test_a_search_ends_with_a_jump_to_the_edge(core, gold_family, seed):
    """To a fifth of a microsecond with little noise; the first captures look for it in the middle of the burst."""
    sensor = start(core, gold_family(10), seed, noise_T=0.0, conversion_noise_T=3e-8)
    acquire, lib = sensor.acquire, core[1]
    sensor.signal.field_T *= 10.0
    acquire.unseen, acquire.captures = 3, 3
    while acquire.stage != EDGE:
        sensor.run((sensor.block + 0.5) * BLOCK_S)
    lib.acquire_step(acquire)
    chip = sensor.signal.chip_s / sensor.tick_s
    begin = sensor.signal.start_s / sensor.tick_s + lib.acquire_late_ticks(board(core)) + EXTRA
    position = (acquire.edge_position + 2**63) % 2**64 - 2**63
    away = (position / ONE - begin + 1000.0) % (CHIPS * chip) - 1000.0
    assert abs(away) < 30.0
    assert acquire.edge_period / ONE == pytest.approx(chip, abs=0.05)
    assert (acquire.track.time_ticks, acquire.track.rate) == (TARGET + EXTRA, 0.0)
    assert (acquire.middle_chip, acquire.extra_ticks) == (acquire.first_chip + CHIPS // 2, EXTRA)
    assert (acquire.captures, acquire.unseen, acquire.tracking, acquire.frame.sliding) == (0, 0, True, False)
    assert (acquire.command, acquire.stage, acquire.length, acquire.cut) == (JUMP, RECORDING, CHIPS // 3, HALVES)
    assert acquire.searches == 1
