"""The stages of synchronisation by the field, each by itself against NumPy: record, search, field of the codes."""

from __future__ import annotations

import numpy as np
import pytest

from hil_sim import clib

CHIPS, LENGTH = 1023, 2048
STAGES = ("timing/acquire_record", "timing/code_search", "timing/code_field", "timing/edge_fit", "math/fourier")
HALVES, TRACKING = 4, 7


@pytest.fixture(scope="module")
def core():
    return clib.load("libgf_core.so", tuple(f"core/{stage}.h" for stage in STAGES))


@pytest.fixture(scope="module")
def family(gold_family):
    return gold_family(10)


def bursts():
    """Bursts by chance, and of both rails."""
    rng = np.random.default_rng(1)
    yield from rng.integers(0, 4095, (300, 8, 3), dtype=np.uint16, endpoint=True)
    for ends in ((0, 0, 0), (0, 0, 4095), (0, 4095, 4095), (4095, 4095, 0), (4095, 0, 0), (4095, 4095, 4095)):
        burst = np.repeat(np.array(ends, dtype=np.uint16), (4, 3, 1))
        yield np.ascontiguousarray(np.broadcast_to(burst[:, None], (8, 3)))


@pytest.mark.parametrize("chip", [0, 511, 1022])
def test_a_burst_becomes_its_mean_and_its_step(core, chip):
    """At the scale of eight counts about mid-scale, rounded; no other chip is touched."""
    ffi, lib = core
    record, sample = ffi.new("acquire_record_t *"), ffi.new("int16_t[4]", [0, 0, 0, 777])
    kept = np.frombuffer(ffi.buffer(record), dtype=np.int16).reshape(2, CHIPS, 3)
    kept[:] = 12345
    for burst in bursts():
        counts = burst.astype(float) - 2048.0
        seven = np.round(8.0 * counts[:7].mean(axis=0))
        for cut, field, step in (
            (HALVES, counts.sum(axis=0), 8.0 * (counts[4:].mean(axis=0) - counts[:4].mean(axis=0))),
            (TRACKING, seven, 8.0 * counts[7] - seven),
        ):
            lib.record_burst(record, chip, cut, ffi.from_buffer("uint16_t[8][3]", burst))
            np.testing.assert_array_equal(kept[:, chip], [field, step])
        lib.acquire_sample(ffi.from_buffer("uint16_t[8][3]", burst), sample)
        np.testing.assert_array_equal(list(sample), [*seven, 777])
    assert (np.delete(kept, chip, axis=1) == 12345).all()


def new_record(core, field, step=None):
    """A record of these fields and steps, shape (1023, 3)."""
    ffi, _ = core
    record = ffi.new("acquire_record_t *")
    kept = np.frombuffer(ffi.buffer(record), dtype=np.int16).reshape(2, CHIPS, 3)
    kept[0] = np.round(field)
    kept[1] = 0 if step is None else np.round(step)
    return record, kept.astype(float)


def test_statistics_of_a_record(core):
    ffi, lib = core
    rng = np.random.default_rng(2)
    fields = rng.normal([500.0, -9000.0, 0.0], [1000.0, 30.0, 4.0], (CHIPS, 3))
    record, (field, _) = new_record(core, fields, np.full((CHIPS, 3), 30000.0))
    mean, variance = ffi.new("float[3]"), ffi.new("float[3]", [9.0, 9.0, 9.0])
    lib.record_statistics(record, mean, variance)
    np.testing.assert_allclose(list(mean), field.mean(axis=0), rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(list(variance), field.var(axis=0), rtol=1e-4)


def searched(core, record, chip_length, codes):
    """The metric and the peak that the core finds."""
    ffi, lib = core
    search = ffi.new("code_search_t *")
    ffi.memmove(search, bytes([0x45]) * ffi.sizeof(search[0]), ffi.sizeof(search[0]))
    lib.code_search_start(search, record, chip_length)
    for code in codes:
        lib.code_search_add(search, code)
    return np.array(list(search.metric)), search


def expected_metric(field, axes, chip_length, codes, family):
    """|correlation|^2 of two axes with each code at all phases, without the 32 lowest lines of either sign."""
    signal = np.zeros(LENGTH, dtype=complex)
    places = (np.arange(CHIPS, dtype=np.float32) * np.float32(chip_length)).astype(int)
    two = field[:, axes] - field[:, axes].mean(axis=0)
    signal[places] = two[:, 0] + 1j * two[:, 1]
    spectrum = np.fft.fft(signal)
    spectrum[np.abs(np.fft.fftfreq(LENGTH, 1 / LENGTH)) <= 32] = 0.0
    metric = np.zeros(CHIPS)
    for code in codes:
        chips = family[code][np.arange(LENGTH) % CHIPS]
        metric += np.abs(np.fft.ifft(np.conj(spectrum) * np.fft.fft(chips)))[:CHIPS] ** 2
    return metric


def assert_alike(metric, expected, error=2e-3):
    """Sixteen bits of the spectrum err by less than what one of its lines adds."""
    relative = expected / expected.mean()
    np.testing.assert_allclose(metric / metric.mean(), relative, atol=4e-5 * relative.max() + error)


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("line", [None, 33, 33.5, 400, 1000])
def test_one_line_or_all_of_either_sign_are_kept_to_scale(core, family, axis, sign, line):
    """Real or imaginary parts, positive or negative, are the largest numbers of the spectrum: of a tone, or a pulse."""
    field = np.zeros((CHIPS, 3))
    if line is None:
        field[0, axis] = sign * 8000.0
    else:
        field[:, axis] = sign * 8000.0 * np.cos(2.0 * np.pi * line * np.arange(CHIPS) / LENGTH)
    record, (kept, _) = new_record(core, field)
    axes = [1, 2] if axis == 2 else [0, 2]
    metric, _ = searched(core, record, 1.0, [17])
    assert_alike(metric, expected_metric(kept, axes, 1.0, [17], family), error=0.03)


def coded_field(rng, family, codes, label, amplitudes):
    """Fields of a record that begins at a chip of the codes, with a constant field, mains and noise."""
    shown = np.array([family[code] for code in codes])[:, (label + np.arange(CHIPS)) % CHIPS]
    slow = 300.0 * np.sin(2.0 * np.pi * 8.2 * np.arange(CHIPS) / LENGTH)
    return shown.T @ amplitudes + [2000.0, -3000.0, 100.0] + slow[:, None] + rng.normal(0.0, 20.0, (CHIPS, 3))


@pytest.mark.parametrize(("least", "axes"), [(0, [1, 2]), (1, [0, 2]), (2, [0, 1])])
@pytest.mark.parametrize("chip_length", [1.0, 1.0009, 1.7])
def test_the_search_correlates_the_two_axes_that_vary_most(core, family, least, axes, chip_length):
    rng = np.random.default_rng(3 + least)
    codes, label = [3, 700, 1024], 1000 + least
    for other in axes:  # The other two differ in either order.
        amplitudes = rng.uniform(100.0, 200.0, (3, 3))
        amplitudes[:, least], amplitudes[:, other] = 20.0, 300.0
        record, (field, _) = new_record(core, coded_field(rng, family, codes, label, amplitudes))
        metric, search = searched(core, record, chip_length, codes)
        expected = expected_metric(field, axes, chip_length, codes, family)
        assert_alike(metric, expected)
        if chip_length == 1.0:
            assert metric.argmax() == label
            assert core[1].code_search_peak(search).label in (label - 1, label)


def test_axes_that_vary_alike_and_a_record_of_nothing(core, family):
    """The first of the least is left out; nothing has no peak."""
    one = 100.0 * family[5][:, None]
    for field, axes in ((one * [1, 1, 1], [1, 2]), (one * [2, 1, 1], [0, 2]), (one * [1, 2, 1], [1, 2])):
        record, (kept, _) = new_record(core, field * [1, -1, 1])
        metric, _ = searched(core, record, 1.0, [5])
        expected = expected_metric(kept, axes, 1.0, [5], family)
        assert_alike(metric, expected)
    record, _ = new_record(core, np.zeros((CHIPS, 3)))
    unbalanced = int(np.flatnonzero(np.abs(family.sum(axis=1)) > 1)[0])
    metric, search = searched(core, record, 1.0, [unbalanced])
    assert not metric.any()
    peak = core[1].code_search_peak(search)
    assert (peak.label, peak.crossing, peak.height) == (0, 0.5, 0.0)


def test_the_peak_is_the_largest_pair_of_neighbours(core):
    """The pair goes round the cycle; the edge divides it as the roots of what stands out."""
    ffi, lib = core
    rng = np.random.default_rng(6)
    for label in [0, 1, 511, 1021, 1022]:
        for pair in ((40.0, 40.0), (90.0, 9.0), (9.0, 90.0), (60.0, 0.1), (0.1, 60.0)):
            metric = rng.uniform(0.5, 1.5, CHIPS)
            metric[[label, (label + 1) % CHIPS]] = pair
            metric[label - 1] = metric[(label + 2) % CHIPS] = 0.0
            search = ffi.new("code_search_t *", {"metric": metric.tolist()})
            peak = lib.code_search_peak(search)
            assert peak.label == label
            assert peak.height == pytest.approx(sum(pair) / 2.0 / metric.mean(), rel=1e-4)
            first, second = np.sqrt(np.maximum(np.array(pair) - metric.mean(), 0.0))
            assert peak.crossing == pytest.approx(first / (first + second), abs=1e-5)
    even = lib.code_search_peak(ffi.new("code_search_t *", {"metric": CHIPS * [2.0]}))
    assert (even.label, even.crossing, even.height) == (0, 0.5, pytest.approx(1.0, rel=1e-4))


def new_frame(core, sliding, label, crossing=0.0, chip_length=1.0):
    return core[0].new("code_frame_t *", [sliding, label, crossing, chip_length])


def located(frame):
    """Labels before the edge and phases of a sliding frame's samples."""
    time = np.arange(CHIPS) * float(frame.chip_length) - float(frame.crossing) + 0.5
    whole = np.floor(time)
    return (frame.label + whole.astype(int)) % CHIPS, time - whole - 0.5


FRAMES = [(5, 0.3, 1.0 + 3.0 / CHIPS), (1022, 0.9, 1.0 - 2.9 / CHIPS), (0, 0.999, 1.0), (700, 0.0, 1.0 + 1.13 / CHIPS)]


@pytest.mark.parametrize("values", FRAMES)
def test_a_sample_of_a_sliding_frame_is_located(core, values):
    ffi, lib = core
    frame = new_frame(core, True, *values)
    labels, phases = located(frame)
    phase = ffi.new("float *")
    for chip in range(CHIPS):
        label = lib.code_frame_label(frame, chip, phase)
        if abs(abs(phases[chip]) - 0.5) > 1e-3:  # There rounding decides.
            assert (label, phase[0]) == (labels[chip], pytest.approx(phases[chip], abs=2e-4))


def field_after(core, record, frame, codes, passes=1):
    ffi, lib = core
    field = ffi.new("code_field_t *")
    ffi.memmove(field, bytes([0x45]) * ffi.sizeof(field[0]), ffi.sizeof(field[0]))
    lib.code_field_start(field, record, frame)
    for _ in range(passes):
        for number, code in enumerate(codes):
            lib.code_field_subtract(field, number, code)
    return field


def array_of(core, values, width=3):
    return np.frombuffer(core[0].buffer(values), dtype=np.float32).reshape(-1, width).astype(float)


@pytest.mark.parametrize("frame_values", [None, *FRAMES])
def test_codes_are_taken_off_one_after_the_other(core, family, frame_values):
    rng = np.random.default_rng(7)
    codes = [3, 700, 1024]
    fields = rng.normal([1000.0, -4000.0, 30.0], 300.0, (CHIPS, 3))
    record, (kept, _) = new_record(core, fields)
    frame = new_frame(core, False, 1000) if frame_values is None else new_frame(core, True, *frame_values)
    if frame_values is None:
        labels, settled = (1000 + np.arange(CHIPS)) % CHIPS, np.ones(CHIPS, dtype=bool)
    else:
        before, phase = located(frame)
        labels, settled = (before + (phase > 0.0)) % CHIPS, np.abs(phase) > 0.25
    residual, amplitude, expected = kept - kept.mean(axis=0), np.zeros((3, 3)), np.zeros((CHIPS, 3))
    for _ in range(2):
        for number, code in enumerate(codes):
            chips = family[code].astype(float)
            share = chips[labels[settled]] @ residual[settled] / max(settled.sum(), 1)  # None may be settled.
            amplitude[number] += share
            residual -= chips[labels][:, None] * share
            expected += chips[:, None] * share
    field = field_after(core, record, frame, codes, passes=2)
    assert field.variance == pytest.approx(kept.var(axis=0).sum(), rel=1e-4)
    np.testing.assert_allclose(array_of(core, field.amplitude)[:3], amplitude, atol=5e-4)
    np.testing.assert_allclose(array_of(core, field.expected), expected, atol=2e-4)
    clear = np.ones(CHIPS, bool) if frame_values is None else np.abs(np.abs(phase) - 0.25) > 1e-3
    clear &= True if frame_values is None else np.abs(np.abs(phase) - 0.5) > 1e-3
    np.testing.assert_allclose(array_of(core, field.residual)[clear], residual[clear], atol=2e-3)
    assert not array_of(core, field.amplitude)[3:].any()


@pytest.mark.parametrize(("share", "present"), [(0.999, False), (1.001, True)])
@pytest.mark.parametrize("codes", [1, 3])
def test_codes_are_there_if_they_have_six_times_their_share_of_noise(core, codes, share, present):
    """Noise of a variance of v gives each code a power of v / 1023; what lies behind the list does not count."""
    field = core[0].new("code_field_t *", {"variance": 50.0})
    power = share * 6.0 * 50.0 / CHIPS * codes
    part = np.sqrt(power / (3 * codes))
    for number in range(16):
        for axis in range(3):
            field.amplitude[number][axis] = part * (-1) ** axis if number < codes else 1e6
    assert core[1].code_field_present(field, codes) == present


@pytest.mark.parametrize("values", FRAMES)
def test_the_profile_gathers_changes_by_phase(core, family, values):
    """Bins are left aside in which rounding decides where a sample comes."""
    rng = np.random.default_rng(8)
    record, (kept, steps) = new_record(core, rng.normal(0.0, 300.0, (CHIPS, 3)), rng.normal(0.0, 100.0, (CHIPS, 3)))
    frame = new_frame(core, True, *values)
    field = field_after(core, record, frame, [3, 700])
    expected = array_of(core, field.expected)
    found = core[1].code_field_profile(field, record, frame)
    labels, phases = located(frame)
    change, done = expected[(labels + 1) % CHIPS] - expected[labels], kept - expected[labels]
    level, step, unsure = np.zeros((3, 32, 4)), np.zeros((3, 32, 4)), np.zeros((3, 32), dtype=bool)
    for chip in range(CHIPS):
        sweep, place = chip * 3 // CHIPS, (phases[chip] + 0.5) * 32.0
        if abs(place - round(place)) < 6e-3:
            unsure[sweep, [round(place) % 32, round(place) - 1]] = True
        bins = [(step, steps[chip], change[chip])]
        if chip > 0 and phases[chip] > phases[chip - 1]:
            bins.append((level, done[chip] - done[chip - 1], change[chip] - change[chip - 1]))
        for into, seen, by in bins:
            weight = by @ by
            into[sweep, int(place)] += [seen @ by, weight, weight * phases[chip], weight * chip]
    assert unsure.sum() < (60 if values[2] != 1.0 else 1)
    for name, bins in (("level", level), ("step", step)):
        told = array_of(core, getattr(found, name), 4).reshape(3, 32, 4)
        size = np.abs(bins).max(axis=(0, 1)) + 1e-9
        np.testing.assert_allclose((told / size)[~unsure], (bins / size)[~unsure], atol=1e-4)


@pytest.mark.parametrize("size", [300.0, 1.0])
@pytest.mark.parametrize(("label", "first", "end"), [(0, 0, 31), (1010, 7, 38), (5, 0, 1023), (1022, 1020, 1023)])
def test_the_step_of_some_chips_is_a_share_of_the_change(core, family, label, first, end, size):
    rng = np.random.default_rng(9)
    record, (_, steps) = new_record(core, rng.normal(0.0, size, (CHIPS, 3)), rng.normal(0.0, size, (CHIPS, 3)))
    field = field_after(core, record, new_frame(core, False, label), [3, 700])
    expected = array_of(core, field.expected)
    chips = (label + np.arange(first, end)) % CHIPS
    change, seen = expected[(chips + 1) % CHIPS] - expected[chips], steps[first:end]
    share = (change * seen).sum() / (change**2).sum()
    variance = core[0].new("float *")
    told = core[1].code_field_step(field, record, label, first, end, variance)
    assert told == pytest.approx(share, rel=1e-3, abs=1e-6)
    left = ((seen - share * change) ** 2).sum() / seen.size / (change**2).sum()
    assert variance[0] == pytest.approx(left, rel=1e-3)
