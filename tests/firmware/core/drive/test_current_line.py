"""The lines that the current loop fits to what was asked and what came, against least squares in double precision."""

import numpy as np
import pytest

from tests.firmware.core.drive.current_loop import HOLDING, OFF, OPEN, RAMPING, SENSE, configure


@pytest.mark.parametrize(
    ("sizes", "gains", "offsets"),
    [
        (True, (0.52, 0.49), (4.0, -6.0)),
        (True, (0.68, 0.39), (-135.0, 135.0)),
        (False, (0.52, 0.49), (0.0, 0.0)),
        (False, (0.68, 0.39), (0.0, 0.0)),
    ],
)
def test_lines_are_those_of_least_squares(core, sizes, gains, offsets):
    """Block after block, with old ones forgotten; what comes of a line keeps to its limits, with 5 counts of zero.

    Lines 2 and 4 are beyond them: gains of 0.5 / 1.25 and 0.5 / 0.75, offsets of a tenth of 1280 counts.
    """
    _, lib = core
    rng, sense_zero = np.random.default_rng(1), 5
    loop, _ = configure(core, 10.0, over=15.9, sizes=sizes)
    for _ in range(300):
        lib.current_sample(loop, False, 0, 2048 + sense_zero)
    lib.current_start(loop)
    chips: tuple[list[list[float]], list[list[float]]] = ([], [])
    for block in range(37):
        assert loop.state == (RAMPING if block < 33 else HOLDING)
        before = [(line.scale - line.shift) / 16 for line in loop.line]
        for row in (*chips[0], *chips[1]):
            row[0] *= 0.875 if block < 33 else 0.96875
        for _ in range(31):
            negative, asked = int(rng.integers(0, 2)), int(rng.integers(1600, 2560))
            along = round(gains[negative] * asked + offsets[negative] + rng.normal(0, 2.0))
            chips[negative].append([1.0, asked, along])
            sign = -1 if negative else 1
            assert lib.current_sample(loop, True, sign * asked, 2048 + sense_zero + sign * along) == 0
        target = 10.0 * min((block + 1) / 33, 1.0)
        levels, counts = [], []
        for line, rows, begun in zip(loop.line, chips, before, strict=True):
            weight, asked_of, along_of = np.array([*rows, [1 / 16, 0.0, 0.0]]).T
            columns = np.stack([asked_of, np.ones_like(asked_of)][: 1 + sizes], axis=1) * np.sqrt(weight)[:, None]
            fit = np.linalg.lstsq(columns, along_of * np.sqrt(weight), rcond=None)[0]
            gain, offset = fit[0], fit[1] if sizes else 0.0
            assert line.gain == pytest.approx(gain, rel=2e-4)
            assert line.offset == pytest.approx(offset, abs=0.2)
            levels.append((begun * gain + offset) * SENSE)
            kept, part = np.clip(gain, 0.4, 0.5 / 0.75), np.clip(offset, -128.0, 128.0)
            assert line.gain_q / 65536 == pytest.approx(kept, rel=2e-4)
            assert line.offset_q == pytest.approx(part, abs=1.2)
            assert line.shift == pytest.approx(16 * part / kept, abs=8.0)
            assert line.scale == pytest.approx(min(16 * target / (kept * SENSE), 65520.0), rel=3e-4, abs=1.0)
            counts.append(min((line.scale - line.shift + 8) // 16, 4095))
        assert loop.target_A == pytest.approx(target, rel=1e-5)
        assert loop.measured_A == pytest.approx(np.mean(levels), abs=0.005)
        assert loop.dc_A == pytest.approx((levels[0] - levels[1]) / 2, abs=0.005)
        assert loop.reference == max(counts)


@pytest.mark.parametrize("sizes", [False, True])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_direction_that_was_never_asked_has_the_line_of_a_driver_without_error(core, sizes, sign):
    """What is told of the current is that of the other direction alone, and there is no direct current."""
    _, lib = core
    loop, _ = configure(core, 10.0, sizes=sizes)
    lib.current_start(loop)
    for chip in range(62):
        asked = 1600 + 10 * chip
        assert lib.current_sample(loop, True, sign * asked, 2048 + sign * round(0.52 * asked)) == 0
    asked_of, never = loop.line[sign < 0], loop.line[sign > 0]
    assert (never.gain, never.offset, never.gain_q, never.offset_q, never.shift) == (0.5, 0.0, 32768, 0, 0)
    assert never.scale == pytest.approx(16 * 10.0 * 2 / 33 / 0.5 / SENSE, abs=1.0)
    assert asked_of.gain == pytest.approx(0.52, rel=1e-3)
    assert asked_of.scale == pytest.approx(never.scale * 0.5 / 0.52, rel=2e-3)
    assert loop.measured_A == pytest.approx(10.0 / 33, abs=0.005)  # What the first block planned.
    assert loop.dc_A == 0.0
    assert loop.reference == (asked_of.scale - asked_of.shift + 8) // 16


def test_no_more_is_planned_than_the_largest_set_point(core):
    """15.9 A would take 4285 counts."""
    _, lib = core
    loop, _ = configure(core, 15.9, over=15.95)
    lib.current_start(loop)
    for chip in range(34 * 31):
        sign, asked = 1 - 2 * (chip % 2), 2000 + chip
        assert lib.current_sample(loop, True, sign * asked, 2048 + sign * round(0.475 * asked)) == 0
    assert [line.scale for line in loop.line] == [16 * 4095] * 2
    assert loop.reference == 4095


@pytest.mark.parametrize("sizes", [False, True])
def test_an_amplitude_of_0_asks_for_nothing(core, sizes):
    """Not even for what rounding would carry on to a count."""
    _, lib = core
    loop, _ = configure(core, 0.0, sizes=sizes)
    lib.current_start(loop)
    for chip in range(40 * 31):
        sign = 1 - 2 * (chip % 2)
        assert lib.current_set_point(loop, sign * 16384) == 0
        assert lib.current_sample(loop, True, 0, 2048) == 0
    assert [line.scale for line in loop.line] == [0, 0]
    assert (loop.state, loop.reference, loop.measured_A) == (HOLDING, 0, 0.0)


def test_the_reference_that_is_told_is_a_set_point(core):
    """Where the offset asks for more than there is, and in the ramp where it is more than the target by itself."""
    _, lib = core

    def reference(amplitude, gain, offset, blocks):
        loop, _ = configure(core, amplitude, over=15.95, sizes=True)
        lib.current_start(loop)
        for chip in range(31 * blocks):
            sign, asked = 1 - 2 * (chip % 2), 800 + 55 * (chip % 31)
            assert lib.current_sample(loop, True, sign * asked, 2048 + sign * round(gain * asked + offset)) == 0
        wanted = [(line.scale - line.shift) / 16 for line in loop.line]
        return loop.reference, max(wanted)

    told, wanted = reference(15.9, 0.475, -100, 34)
    assert (told, wanted > 4200) == (4095, True)
    below = []
    for offset in range(30, 90):
        told, wanted = reference(10.0, 0.5, offset, 1)
        assert told == pytest.approx(max(wanted, 0.0), abs=0.6), offset
        below.append(wanted)
    assert any(-2.4 < wanted < -1.6 for wanted in below)
    assert max(below) > 1.0


def block(lib, loop, gain, stray=0):
    """One block of set-points of both signs, a chip of which brings so many counts less; returns headroom_lost."""
    for chip in range(31):
        sign, asked = 1 - 2 * (chip % 2), 2000 + 60 * chip
        missing = stray if chip == 17 else 0
        assert lib.current_sample(loop, True, sign * asked, 2048 + sign * (round(gain * asked) - missing)) == 0
    return loop.headroom_lost


def test_one_chip_that_is_short_is_told_for_as_many_blocks_as_a_cycle_has(core):
    """33 of them. In the ramp, in which the current is short of the next target anyway, nothing is told."""
    _, lib = core
    loop, _ = configure(core, 10.0, over=15.95)
    lib.current_start(loop)
    for count in range(40):
        assert not block(lib, loop, 0.5, stray=200 if count < 33 else 0)
    told = [block(lib, loop, 0.5, stray=60 if count == 0 else 0) for count in range(40)]
    assert told == [True] * 33 + [False] * 7


@pytest.mark.parametrize(("share", "lost"), [(0.9965, False), (0.9935, True)])
def test_an_amplitude_that_is_half_a_percent_short_is_told(core, share, lost):
    """A driver that makes 85 % of what is asked, whose largest set-point brings so much of the amplitude."""
    _, lib = core
    loop, _ = configure(core, 4095 * 0.85 * 0.5 * SENSE / share, over=15.95)
    lib.current_start(loop)
    for _ in range(33 + 40):
        block(lib, loop, 0.85 * 0.5)
    assert loop.measured_A / loop.target_A == pytest.approx(share, abs=5e-4)
    assert loop.headroom_lost == lost


def test_the_zero_is_the_mean_of_what_is_told_without_current_and_of_no_more_than_it_remembers(core):
    """1024 chips; each after the first of those that are not driven, which may still see the current fall."""
    _, lib = core
    for before, memory in ((0, 1), (1, 2), (255, 256), (1022, 1023), (1023, 1024), (1024, 1024), (3000, 1024)):
        loop, _ = configure(core, 10.0)
        for count in range(before + 1):
            assert lib.current_sample(loop, False, 0, 2048 + (100 if count == 0 else 0)) == 0
        assert (loop.zero, loop.zeros) == (0.0, min(before, 1024))
        assert lib.current_sample(loop, False, 0, 2048 - 32) == 0
        assert loop.zero == pytest.approx(-32.0 / memory, rel=1e-6)
        zero = loop.zero
        lib.current_start(loop)
        assert lib.current_sample(loop, True, 1000, 2048 + 500) == 0
        assert lib.current_sample(loop, False, 0, 2048 + 300) == 0
        assert loop.zero == zero


def holding(core, zero=0, **options):
    """A loop that holds what an exact driver makes, seen by a sense with a zero of its own."""
    _, lib = core
    loop, done = configure(core, **options)
    assert done
    for _ in range(300):
        lib.current_sample(loop, False, 0, 2048 + zero)
    lib.current_start(loop)
    largest = 2 * round(options["amplitude"] / SENSE)
    for chip in range(31 * 80):
        sign, asked = 1 - 2 * (chip % 2), largest * (4 + chip % 5) // 8
        assert lib.current_sample(loop, True, sign * asked, 2048 + zero + sign * round(asked / 2)) == 0
    assert loop.state == HOLDING
    return loop


@pytest.mark.parametrize("zero", [-50, 50])
@pytest.mark.parametrize("sign", [1, -1])
def test_a_zero_of_the_sense_that_is_larger_than_the_current_does_not_open_the_coil(core, zero, sign):
    """0.4 A of zero beside 0.25 A of 0.6: half of what is asked, from its own zero, is what there must be."""
    _, lib = core
    for came, cause in ((32, 0), (16, 0), (15, OPEN), (0, OPEN), (-32, OPEN)):
        count = 2048 + zero + sign * came
        loop = holding(core, zero, amplitude=0.6, sizes=True)
        assert lib.current_middle(loop, sign * 64, 2048 + zero + sign * 32, count) == cause
        loop = holding(core, zero, amplitude=0.6, sizes=True)
        assert lib.current_sample(loop, True, sign * 64, count) == cause


def test_where_no_current_is_expected_none_is_missed(core):
    """A driver whose offset is as large as what is asked brings nothing, which is all of it."""
    _, lib = core
    loop = holding(core, amplitude=0.6, sizes=True, open_fraction=1.0)
    asked, line = 64, loop.line[0]
    for expected, least in ((1, 1), (0, 0), (-20, 0)):
        line.offset_q = expected - (asked * line.gain_q >> 16)
        assert lib.current_middle(loop, asked, 2048 + 32, 2048 + least) == 0
        assert lib.current_sample(loop, True, asked, 2048 + least) == 0
    for expected, least in ((1, 1), (-20, 0)):
        loop = holding(core, amplitude=0.6, sizes=True, open_fraction=1.0)
        loop.line[0].offset_q = expected - (asked * loop.line[0].gain_q >> 16)
        assert lib.current_sample(loop, True, asked, 2048 + least - 1) == OPEN


def test_a_chip_counts_for_its_line_unless_it_asks_for_nothing_or_is_far_too_short(core):
    """1/64 and 6 counts and 1/8 are let pass: 186 of 1280. In the ramp all count."""
    _, lib = core
    loop = holding(core, amplitude=10.0)
    for asked, missing, counts in ((2560, 186, 1), (2560, 187, 0), (1, 0, 1), (0, 0, 0)):
        before = loop.line[0].block_count
        expected = (asked * loop.line[0].gain_q >> 16) + loop.line[0].offset_q
        assert lib.current_sample(loop, True, asked, 2048 + expected - missing) == 0
        assert loop.line[0].block_count - before == counts, (asked, missing)
    loop, _ = configure(core, 10.0)
    lib.current_start(loop)
    assert lib.current_sample(loop, True, 0, 2048) == 0
    assert loop.line[0].block_count == 1


def test_a_set_point_of_one_count_has_the_direction_of_its_sign(core):
    """A reference is so coarse that one count is more than a coil may be open with."""
    _, lib = core
    for sign in (1, -1):
        for look in (
            lambda loop, asked, count: lib.current_middle(loop, asked, 2048, count),
            lambda loop, asked, count: lib.current_sample(loop, True, asked, count),
        ):
            for came, cause in ((2, 0), (-2, OPEN)):
                loop, done = configure(core, 0.5, over=100.0, sense=0.125, reference=0.25)
                assert done
                lib.current_start(loop)
                assert look(loop, sign, 2048 + sign * came) == cause


def test_a_loop_that_is_off_learns_nothing_and_misses_no_current(core):
    _, lib = core
    loop = holding(core, amplitude=10.0)
    lib.current_stop(loop)
    assert lib.current_middle(loop, 2560, 2048, 2048) == 0
    for _ in range(40):
        assert lib.current_sample(loop, True, 2560, 2048) == 0
    assert (loop.state, loop.chips, loop.line[0].block_count) == (OFF, holding(core, amplitude=10.0).chips, 0)
