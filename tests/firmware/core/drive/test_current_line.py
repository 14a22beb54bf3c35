"""The lines that the current loop fits to what was asked and what came, against least squares in double precision."""

import numpy as np
import pytest

from tests.firmware.core.drive.current_loop import HOLDING, RAMPING, SENSE, configure


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
        for line, rows, begun, sign in zip(loop.line, chips, before, (1, -1), strict=True):
            weight, asked_of, along_of = np.array([*rows, [1 / 16, 0.0, 0.0]]).T
            columns = np.stack([asked_of, np.ones_like(asked_of)][: 1 + sizes], axis=1) * np.sqrt(weight)[:, None]
            fit = np.linalg.lstsq(columns, along_of * np.sqrt(weight), rcond=None)[0]
            gain, offset = fit[0], fit[1] if sizes else 0.0
            assert line.gain == pytest.approx(gain, rel=2e-4)
            assert line.offset == pytest.approx(offset, abs=0.2)
            levels.append((begun * gain + offset) * SENSE)
            kept, part = np.clip(gain, 0.4, 0.5 / 0.75), np.clip(offset, -128.0, 128.0)
            assert line.gain_q / 65536 == pytest.approx(kept, rel=2e-4)
            assert line.offset_q == pytest.approx(part + sign * sense_zero, abs=1.2)
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
