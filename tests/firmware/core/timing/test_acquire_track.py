"""What acquire.c makes of a record while it tracks: of one that is made here, by the filter that others test."""

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
    EDGE,
    EXTRA,
    HALVES,
    LAG,
    MEASURING,
    NONE,
    ONE,
    RECORDING,
    SWEEP,
    TARGET,
    TRACKING,
    TRANSFORMING,
    amplitudes_of,
    fill,
    load,
    new,
    state,
    used,
)


@pytest.fixture(scope="module")
def core():
    return load()


@pytest.fixture(scope="module")
def family(gold_family):
    return gold_family(10)


FIRST = 50_000


def copy(core, track):
    other = core[0].new("edge_track_t *")
    other[0] = track[0]
    return other


def tracked(
    core,
    family,
    *,
    share=(0.06, 0.06),
    noise=3.0,
    captures=3,
    extra=0,
    time=None,
    seed=5,
    before=FIRST + 100,
    label=900,
    covariance=None,
):
    """A record of a clock in step, with the share of each half; return acquire, and the filter that it had."""
    ffi, lib = core
    acquire, rng = new(core, CODES), np.random.default_rng(seed)
    amplitudes = amplitudes_of(rng, 8)
    lib.edge_track_start(
        ffi.addressof(acquire, "track"),
        ffi.new("edge_fit_t *", [-2000.0, 0.0, 4000.0]),
        TARGET + extra if time is None else time,
    )
    kept = np.frombuffer(ffi.buffer(acquire.track.covariance), dtype=np.float32).reshape(3, 3)
    kept[:] = np.diag([20.0**2, 0.02**2, 200.0**2]) if covariance is None else covariance
    length = CHIPS if captures == 3 else CHIPS // 3
    each = np.where(np.arange(CHIPS) < length // 2, *share)
    fill(core, acquire, family, CODES, amplitudes, each, noise, rng, label)
    if captures < 3:  # The amplitudes are those of the search.
        frame = ffi.new("code_frame_t *", [False, label, 0.0, 1.0])
        lib.code_field_start(ffi.addressof(acquire, "field"), ffi.addressof(acquire, "record"), frame)
        for number, code in enumerate(CODES):
            lib.code_field_subtract(ffi.addressof(acquire, "field"), number, code)
    acquire.tracking, acquire.captures, acquire.extra_ticks = True, captures, extra
    acquire.length, acquire.cut = length, TRACKING if extra == 0 else HALVES
    acquire.first_chip, acquire.first_code_chip, acquire.middle_chip = FIRST, label, before
    acquire.stage, acquire.command, acquire.recorded, acquire.searches = RECORDING, NONE, 1, 1
    acquire.code, acquire.period = 77, CHIP_TICKS * ONE
    acquire.late_ticks = acquire.deviation_ticks = -1.0
    return acquire, copy(core, ffi.addressof(acquire, "track"))


def steps(core, acquire):
    """Let main work until it waits; return in how many turns."""
    for turn in range(1, 20):
        core[1].acquire_step(acquire)
        if acquire.stage == RECORDING:
            return turn
    raise AssertionError("main never ends")


def variance_ahead(core, acquire):
    """Return the variance of the phase a cycle ahead."""
    return core[1].edge_track_variance(core[0].addressof(acquire, "track"), CHIPS)


def followed(core, acquire, track):
    """Take a record's two looks into the filter; return whether they were blind."""
    ffi, lib = core
    half = acquire.length // 2
    looks = ffi.new("edge_look_t[2]")
    for look, (first, end) in zip(looks, ((0, half), (half, acquire.length)), strict=True):
        variance = ffi.new("float *")
        look.share = lib.code_field_step(
            ffi.addressof(acquire, "field"),
            ffi.addressof(acquire, "record"),
            acquire.first_code_chip,
            first,
            end,
            variance,
        )
        look.variance, look.chips = variance[0], (first + end) / 2 - half
    burst = ffi.new("edge_burst_t *", [acquire.cut, CONVERSION, LAG])
    lib.edge_track_move(track, acquire.first_chip + half - acquire.middle_chip)
    lib.edge_track_rise(track, burst, looks)
    blind = lib.edge_track_blind(track, burst, looks)
    lib.edge_track_update(track, burst, looks)
    return blind


@pytest.mark.parametrize(
    ("captures", "extra", "share"),
    [(3, 0, (0.02, 0.03)), (0, EXTRA, (0.17, 0.18)), (1, EXTRA, (0.17, 0.18)), (2, 0, (0.03, 0.02))],
)
def test_a_record_corrects_phase_and_rate(core, family, captures, extra, share):
    """By the filter, over the two halves; then the clock is where it is to be, as far as is known."""
    acquire, track = tracked(core, family, share=share, captures=captures, extra=extra)
    ahead = copy(core, track)
    blind = None
    if captures < 3:
        blind = followed(core, acquire, ahead)
    before = bool(acquire.cut), acquire.length
    turns = steps(core, acquire)
    if captures == 3:
        assert turns == 3  # Four codes a turn.
        acquire.cut, acquire.length, middle = TRACKING, CHIPS, acquire.middle_chip
        acquire.middle_chip = FIRST + 100
        blind = followed(core, acquire, ahead)
        acquire.middle_chip = middle
    else:
        assert turns == 1
    assert not blind
    half = before[1] // 2
    now = min(captures + 1, 3)
    late = 0 if now >= 2 else EXTRA
    assert (acquire.captures, acquire.unseen, acquire.extra_ticks, acquire.silent) == (now, 0, late, False)
    assert (acquire.late_ticks, acquire.deviation_ticks) == (
        ahead.time_ticks,
        pytest.approx(ahead.covariance[0][0] ** 0.5),
    )
    assert acquire.phase_change == TARGET + late - ahead.time_ticks
    assert acquire.rate_change == -ahead.rate
    assert acquire.residual_ticks == int(ahead.time_ticks - TARGET)
    assert (acquire.rate_chip, acquire.middle_chip) == (FIRST + half, FIRST + half)
    assert (acquire.track.time_ticks, acquire.track.rate) == (TARGET + late, 0.0)
    assert acquire.track.rise_ticks == ahead.rise_ticks
    assert acquire.command == CORRECT
    assert variance_ahead(core, acquire) < 84.0**2
    assert acquire.good == (late == 0)
    assert (acquire.length, acquire.cut) == (CHIPS if now == 3 else CHIPS // 3, HALVES if late else TRACKING)


@pytest.mark.parametrize("captures", [0, 3])
def test_four_records_without_a_ramp_start_a_search(core, family, captures):
    """Each puts the edge into the middle of the burst, and the phase is thought to be off by as much."""
    for unseen in range(4):
        extra = EXTRA if captures == 0 or unseen else 0
        acquire, track = tracked(core, family, share=(0.0, 0.0), captures=captures, extra=extra, noise=6.0)
        acquire.unseen = unseen
        ahead = copy(core, track)
        if captures == 0:
            assert followed(core, acquire, ahead)
        steps(core, acquire)
        if captures == 3:
            acquire.length, acquire.cut, acquire.middle_chip = CHIPS, HALVES if extra else TRACKING, FIRST + 100
            assert followed(core, acquire, ahead)
        assert ahead.time_ticks < 0.4 * LAG
        assert (acquire.unseen, acquire.extra_ticks, acquire.good) == (unseen + 1, EXTRA, False)
        assert acquire.track.covariance[0][0] == pytest.approx(ahead.covariance[0][0] + EXTRA**2)
        assert acquire.command == (SWEEP if unseen == 3 else CORRECT)
        assert (acquire.tracking, acquire.searches) == (unseen < 3, 1 + (unseen == 3))


@pytest.mark.parametrize("extra", [0, EXTRA])
def test_the_clock_is_in_step_when_the_phase_is_known_to_half_a_microsecond(core, family, extra):
    """A cycle ahead; and never while the next record is to look for the edge."""

    def taken(deviation):
        known = np.diag([1.0, deviation**2, 1.0])
        share = (0.024, 0.024) if extra == 0 else (0.0, 0.0)
        acquire, _ = tracked(
            core, family, covariance=known, noise=2000.0 if extra == 0 else 3.0, share=share, before=FIRST + 511
        )
        steps(core, acquire)
        assert acquire.extra_ticks == extra
        return acquire.good, variance_ahead(core, acquire) ** 0.5

    if extra:
        assert not taken(1e-4)[0]
        return
    low, high = 1e-3, 1.0
    assert taken(low)[0]
    assert not taken(high)[0]
    for _ in range(20):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if taken(middle)[0] else (low, middle)
    assert taken(low)[1] == pytest.approx(84.0, abs=0.02)
    assert taken(high)[1] == pytest.approx(84.0, abs=0.02)


def test_silent_codes_are_looked_for_and_one_record_is_left_out_when_they_return(core, family):
    """The clock is left alone."""
    acquire, track = tracked(core, family)
    before = copy(core, track)
    record = np.frombuffer(core[0].buffer(core[0].addressof(acquire, "record")), dtype=np.int16)
    shown = record.copy()
    record[:] = np.random.default_rng(6).normal(0.0, 100.0, record.shape)
    assert steps(core, acquire) == 3 + 1 + len(CODES)
    assert (acquire.silent, acquire.command, acquire.tracking, acquire.searches) == (True, AGAIN, True, 1)
    for command in (AGAIN, CORRECT):
        assert state(core, core[0].addressof(acquire, "track")) == state(core, before)
        record[:], acquire.command, acquire.recorded = shown, NONE, 1
        assert steps(core, acquire) == 3
        assert (acquire.silent, acquire.command, acquire.unseen) == (False, command, 0)


def test_a_known_phase_is_tracked_without_a_search(core):
    """Its rate is known to 0.06 ppm."""
    ffi, lib = core
    acquire = new(core)
    lib.acquire_known(acquire, [*range(300, 320)], 20, 777, 40.0)
    assert used(acquire) == [*range(300, 316)]
    assert (acquire.tracking, acquire.searches, acquire.command, acquire.stage) == (True, 0, AGAIN, RECORDING)
    assert (acquire.captures, acquire.middle_chip, acquire.length, acquire.cut) == (3, 777, CHIPS, TRACKING)
    track = ffi.new("edge_track_t *")
    lib.edge_track_known(track, TARGET, 40.0, 0.001)  # That is 0.06 ppm of a chip, to two hundredths.
    assert state(core, ffi.addressof(acquire, "track")) == state(core, track)


@pytest.mark.parametrize("tracking", [False, True])
@pytest.mark.parametrize("captures", [2, 3])
@pytest.mark.parametrize("stage", [RECORDING, TRANSFORMING, AMPLITUDES, EDGE, MEASURING])
def test_codes_are_replaced_while_a_whole_record_fills(core, tracking, captures, stage):
    acquire = new(core, CODES)
    acquire.tracking, acquire.captures, acquire.stage, acquire.command = tracking, captures, stage, NONE
    taken = tracking and captures == 3 and stage == RECORDING
    assert core[1].acquire_replace(acquire, [7, 8], 2) == taken
    assert used(acquire) == ([7, 8] if taken else CODES)
    assert (acquire.searches, acquire.command, acquire.stage) == (1, NONE, stage)


def test_the_first_record_of_a_known_phase_tells_the_rise(core, family):
    """As it would be if the phase were right."""
    lib = core[1]
    acquire, track = tracked(core, family, share=(0.05, 0.05))
    for filter_ in (core[0].addressof(acquire, "track"), track):
        lib.edge_track_known(filter_, TARGET, 40.0, 1e-3)
    steps(core, acquire)
    acquire.middle_chip, middle = FIRST + 100, acquire.middle_chip
    followed(core, acquire, track)
    assert (acquire.track.rise_ticks, middle) == (track.rise_ticks, FIRST + CHIPS // 2)
    height = TARGET - LAG * (1.0 - np.exp(-TARGET / LAG))
    assert track.rise_ticks == pytest.approx(height / 0.05, rel=0.05)


def test_no_ramp_is_no_blindness_where_the_phase_is_known_better(core, family):
    """The burst then lies on the ramp by all that is known, and the record counts."""
    known, counted = np.diag([1.0, 1e-8, 1.0]), 0
    for seed in range(30):
        acquire, track = tracked(core, family, covariance=known, noise=40.0, share=(0.0, 0.0), seed=seed)
        ahead = copy(core, track)
        steps(core, acquire)
        seen, acquire.length, acquire.cut, acquire.middle_chip = acquire.unseen == 0, CHIPS, TRACKING, FIRST + 100
        blind = followed(core, acquire, ahead)
        assert seen == (not blind or ahead.time_ticks > 0.4 * LAG)
        counted += blind and seen
    assert counted > 3
