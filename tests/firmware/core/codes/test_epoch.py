"""Cycle assembly: bursts, the collector, scaling to tesla and to message integers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

N = 1023


@given(st.lists(st.lists(st.integers(0, 4095), min_size=3, max_size=3), min_size=8, max_size=8))
def test_burst(core, burst):
    ffi, lib = core
    sample = ffi.new("int16_t[3]")
    saturated = lib.epoch_sample(ffi.new("uint16_t[8][3]", burst), sample)
    counts = np.array(burst)
    assert list(sample) == (counts.sum(axis=0) - 8 * 2048).tolist()
    assert saturated == bool(((counts == 0) | (counts == 4095)).any())


@pytest.mark.parametrize("others", [1, 2048, 4094])
def test_one_saturated_conversion_of_a_burst_is_seen(core, others):
    """At either rail, and not next to it, whatever the conversions beside it."""
    ffi, lib = core
    sample = ffi.new("int16_t[3]")
    for place in np.ndindex(8, 3):
        for count, saturated in ((0, True), (1, False), (4094, False), (4095, True)):
            burst = np.full((8, 3), others)
            burst[place] = count
            assert lib.epoch_sample(ffi.new("uint16_t[8][3]", burst.tolist()), sample) == saturated, (place, count)
            assert list(sample) == (burst.sum(axis=0) - 8 * 2048).tolist()


@pytest.fixture
def collector(core):
    ffi, lib = core
    state = ffi.new("epoch_collector_t *")
    lib.epoch_init(state, lib.gold_family(10))
    return state


def feed(core, state, chips, value=1, **flags):
    """Feed absolute chips (cycle and code chip follow from a clock that began at 0); the values returned."""
    ffi, lib = core
    arguments = {"saturated": False, "locked": True, **flags}
    sample = ffi.new("int16_t[3]", [value, 2 * value, -value])
    return [lib.epoch_feed(state, t, t // N, t % N, sample, *arguments.values()) for t in chips]


def test_a_whole_cycle_is_handed_over(core, collector):
    ffi, lib = core
    assert lib.epoch_ready(collector) == ffi.NULL
    returned = feed(core, collector, range(500, 2 * N))
    assert returned.index(True) == 2 * N - 501  # Chips 500..1022 belong to a cycle whose beginning was not seen.
    epoch = lib.epoch_ready(collector)
    assert (epoch.cycle, epoch.first_chip, epoch.saturated, epoch.locked) == (1, N, 0, True)
    assert list(epoch.despread.sum) == [N, 2 * N, -N]
    assert (epoch.despread.chip, epoch.despread.missing, collector.dropped) == (N, 0, 0)
    lib.epoch_release(collector)
    assert lib.epoch_ready(collector) == ffi.NULL


def test_a_gap_is_counted_as_missing(core, collector):
    _, lib = core
    feed(core, collector, [*range(100), *range(162, N)])
    epoch = lib.epoch_ready(collector)
    assert (epoch.despread.missing, epoch.despread.sum[0]) == (62, N - 62)


def test_missing_last_chips(core, collector):
    _, lib = core
    returned = feed(core, collector, [*range(1000), N])
    assert returned[-1]
    epoch = lib.epoch_ready(collector)
    lib.despread_transform(despread_of(core, epoch))
    assert (epoch.cycle, epoch.despread.missing) == (0, 23)
    feed(core, collector, range(N + 1, 2 * N))
    lib.epoch_release(collector)
    assert collector.dropped == 1  # Main held cycle 0 until cycle 1 was over.


def despread_of(core, epoch):
    ffi, _ = core
    return ffi.addressof(epoch, "despread")


def test_of_a_cycle_is_read_what_was_fed(core, gold_family, collector):
    """And nothing is written behind the codes of the selection."""
    ffi, lib = core
    codes = [7, 1000]
    selection, sums = ffi.new("epoch_selection_t *"), ffi.new("epoch_sums_t *")
    lib.epoch_select(selection, lib.gold_family(10), codes, len(codes))
    feed(core, collector, range(100))
    feed(core, collector, range(110, 115), saturated=True)
    feed(core, collector, range(115, N))
    epoch = lib.epoch_ready(collector)
    lib.despread_transform(despread_of(core, epoch))
    ffi.buffer(sums)[:] = b"\xa5" * ffi.sizeof("epoch_sums_t")
    lib.epoch_read(epoch, selection, sums)
    assert (sums.cycle, sums.chips, sums.missing, sums.saturated, sums.locked) == (0, N, 10, 5, True)
    heard = gold_family(10)[codes].sum(axis=1) - gold_family(10)[codes, 100:110].sum(axis=1)
    assert [list(sums.correlation[i]) for i in range(2)] == [[h, 2 * h, -h] for h in heard.tolist()]
    assert list(sums.sum) == [N - 10, 2 * (N - 10), 10 - N]
    assert set(bytes(ffi.buffer(sums.correlation))[2 * 12 :]) == {0xA5}
    lib.epoch_release(collector)
    feed(core, collector, range(N, 2 * N), locked=False)
    epoch = lib.epoch_ready(collector)
    lib.despread_transform(despread_of(core, epoch))
    lib.epoch_read(epoch, selection, sums)
    assert (sums.cycle, sums.missing, sums.saturated, sums.locked) == (1, 0, 0, False)
    lib.epoch_release(collector)
    feed(core, collector, range(2 * N, 3 * N))
    lib.epoch_read(lib.epoch_ready(collector), selection, sums)
    assert (sums.cycle, sums.missing, sums.saturated, sums.locked) == (2, 0, 0, True)  # In the place of the first one.


def test_a_gap_across_the_end_drops_the_cycle(core, collector):
    ffi, lib = core
    feed(core, collector, [*range(1000), *range(N + 5, 2 * N)])
    assert lib.epoch_ready(collector) == ffi.NULL
    assert collector.dropped == 1
    feed(core, collector, range(2 * N, 3 * N))
    assert lib.epoch_ready(collector).cycle == 2


@pytest.mark.parametrize("lost_at", [None, 0, 1, 350, 399])
def test_a_jump_of_the_chip_clock_drops_the_cycle(core, collector, lost_at):
    """It is a loss only if the clock was locked when the cycle began: at the start it has yet to find its master."""
    ffi, lib = core
    sample = ffi.new("int16_t[3]")
    labels = [*range(400), *range(700, N), *range(N)]
    for absolute, label in enumerate(labels):
        lib.epoch_feed(collector, absolute, 0, label, sample, False, lost_at is None or absolute < lost_at)
        if absolute < 400:
            lib.epoch_release(collector)
        elif absolute == 400 + N - 700:
            assert collector.dropped == (0 if lost_at == 0 else 1)
            assert lib.epoch_ready(collector) == ffi.NULL
    assert lib.epoch_ready(collector).first_chip == len(labels) - N


@pytest.mark.parametrize(
    ("fed", "absolute", "label"), [(400, 400, 0), (1000, N, 5), (1000, N, N - 1), (1000, N - 1, 0)]
)
def test_a_jump_to_the_end_of_a_cycle_or_at_it_drops_it(core, collector, fed, absolute, label):
    """The cycle is over when its chips are, and the code says so too."""
    ffi, lib = core
    feed(core, collector, range(fed))
    assert not lib.epoch_feed(collector, absolute, 0, label, ffi.new("int16_t[3]"), False, True)
    assert lib.epoch_ready(collector) == ffi.NULL
    assert collector.dropped == 1


def test_a_clock_that_finds_its_master_amid_a_cycle_leaves_that_cycle_out(core, collector):
    """However often it jumps back: as many chips as a cycle has, of several ones, are none."""
    ffi, lib = core
    for absolute, label in enumerate([*range(400), *range(100, N)]):
        assert not lib.epoch_feed(collector, absolute, 0, label, ffi.new("int16_t[3]"), False, False)
    assert lib.epoch_ready(collector) == ffi.NULL
    assert collector.dropped == 0


@pytest.mark.parametrize("chips", [range(N, 2 * N), [*range(N, 2 * N - 5), 2 * N]])
@pytest.mark.parametrize(("before", "after"), [(0, 1), (2**32 - 2, 2**32 - 1), (2**32 - 1, 2**32 - 1)])
def test_nobody_is_told_of_a_cycle_that_was_dropped(core, collector, chips, before, after):
    """It is counted, to the end of 32 bits."""
    feed(core, collector, range(N))
    collector.dropped = before
    assert not any(feed(core, collector, chips))
    assert collector.dropped == after


def test_while_main_holds_a_cycle_later_ones_are_dropped_never_mixed(core, collector):
    _, lib = core
    feed(core, collector, range(N), value=1)
    held = lib.epoch_ready(collector)
    feed(core, collector, range(N, 3 * N), value=2)
    assert (held.cycle, held.despread.sum[0], collector.dropped) == (0, N, 2)
    lib.epoch_release(collector)
    feed(core, collector, range(3 * N, 4 * N), value=3)
    now = lib.epoch_ready(collector)
    assert (now.cycle, now.despread.sum[0]) == (3, 3 * N)


def test_saturation_and_lock_are_of_the_whole_cycle(core, collector):
    _, lib = core
    feed(core, collector, range(500))
    feed(core, collector, range(500, 510), saturated=True)
    feed(core, collector, [510], locked=False)
    feed(core, collector, range(511, N))
    epoch = lib.epoch_ready(collector)
    assert (epoch.saturated, epoch.locked) == (10, False)


@pytest.mark.parametrize("degree", [5, 6, 7, 9, 10, 11])
def test_fields_and_offset_in_tesla(core, gold_family, degree):
    """Random samples through a misaligned sensor: the float result against the product in double precision."""
    ffi, lib = core
    rng, length = np.random.default_rng(3), 2**degree - 1
    matrix = np.diag([1e-7, 0.9e-7, 1.1e-7]) + rng.normal(0, 2e-9, (3, 3))
    zero = np.array([2075.25, 2020.5, 2048.0])
    conversions = rng.integers(1, 4095, (length, 8, 3))
    epoch, sums = ffi.new("epoch_t *"), ffi.new("epoch_sums_t *")
    state = ffi.addressof(epoch, "despread")
    lib.despread_start(state, lib.gold_family(degree))
    sample = ffi.new("int16_t[3]")
    for burst in conversions.tolist():
        assert not lib.epoch_sample(ffi.new("uint16_t[8][3]", burst), sample)
        lib.despread_store(state, sample)
    calibration = ffi.new("epoch_calibration_t *", [zero.tolist(), matrix.tolist()])
    codes = [0, 2, length // 2, length, length + 1, 4000, 17]
    selection = ffi.new("epoch_selection_t *")
    assert lib.epoch_select(selection, lib.gold_family(degree), codes, len(codes)) == 6
    lib.despread_transform(state)
    lib.epoch_read(epoch, selection, sums)
    field = ffi.new("float[3]")
    truth = (conversions.mean(axis=1) - zero) @ matrix.T
    for index, code in enumerate(code for code in codes if code != 4000):
        assert selection.codes[index].code == code
        lib.epoch_field(sums, calibration, selection, index, field)
        assert list(field) == pytest.approx((gold_family(degree)[code] @ truth / length).tolist(), abs=2e-11)
    lib.epoch_offset(sums, calibration, field)
    assert list(field) == pytest.approx(truth.mean(axis=0).tolist(), abs=2e-10)


def test_at_most_64_codes(core):
    ffi, lib = core
    selection = ffi.new("epoch_selection_t *")
    assert lib.epoch_select(selection, lib.gold_family(10), list(range(70)), 70) == 64
    assert lib.epoch_select(selection, lib.gold_family(10), [], 0) == 0


@pytest.mark.parametrize("degree", [5, 6, 11])
def test_cycles_of_other_lengths(core, gold_family, degree):
    """Whole cycles follow each other, whatever the length; main is back before the next one ends."""
    ffi, lib = core
    length = 2**degree - 1
    state, selection = ffi.new("epoch_collector_t *"), ffi.new("epoch_selection_t *")
    lib.epoch_init(state, lib.gold_family(degree))
    lib.epoch_select(selection, lib.gold_family(degree), [3], 1)
    stream = np.random.default_rng(degree).integers(-32768, 32768, (3 * length, 3))
    got, sums = [], ffi.new("epoch_sums_t *")
    for t, sample in enumerate(stream.tolist()):
        if lib.epoch_feed(state, t, t // length, t % length, sample, False, True):
            ready = lib.epoch_ready(state)
            lib.despread_transform(despread_of(core, ready))
            lib.epoch_read(ready, selection, sums)
            got.append((sums.cycle, sums.chips, sums.missing, list(sums.correlation[0])))
            lib.epoch_release(state)
    cycles = stream.reshape(3, length, 3)
    expected = [gold_family(degree)[3] @ cycle for cycle in cycles]
    assert got == [(i, length, 0, row.tolist()) for i, row in enumerate(expected)]


@given(st.floats(-6e-5, 6e-5))
def test_message_integers(core, value):
    _, lib = core
    result = lib.epoch_integer(value, 1e-10)
    scaled = np.float32(value) / np.float32(1e-10)
    if abs(scaled) > 524287:
        assert result == -524288
    else:
        assert abs(result - float(scaled)) <= 0.5 + 1e-6


def test_message_integers_at_the_ends(core):
    _, lib = core
    assert lib.epoch_integer(524287.0, 1.0) == 524287
    assert lib.epoch_integer(-524287.0, 1.0) == -524287
    for value in (524288.0, -524288.0, math.inf, -math.inf, math.nan, 1e30):
        assert lib.epoch_integer(value, 1.0) == -524288


def test_a_repeated_chip_drops_the_cycle(core, collector):
    ffi, lib = core
    feed(core, collector, [*range(100), 99, *range(100, N)])
    assert collector.dropped == 1
    assert lib.epoch_ready(collector) == ffi.NULL
