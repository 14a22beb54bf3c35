"""The current loop around a simulated driver and coil, its reference used as a planner does: a block or two later."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.firmware.core.drive.current_loop import (
    AHEAD,
    EXCESS,
    FAULT,
    HOLDING,
    OFF,
    OPEN,
    OVER,
    OVERLOAD,
    RAMPING,
    REFERENCE,
    SENSE,
    Drive,
    codes,
    configure,
    pulse,
    running,
    sinusoid,
    three_codes,
    two_codes,
)


@settings(max_examples=25)
@given(
    gain=st.floats(0.82, 1.2),
    amplitude=st.floats(0.5, 12.0),
    ahead=st.integers(0, AHEAD),
    level=st.sampled_from([codes, two_codes, sinusoid(1), sinusoid(5), sinusoid(700)]),
)
def test_reaches_the_amplitude_whatever_the_gain(core, gain, amplitude, ahead, level):
    loop, done = configure(core, amplitude, over=15.9, sizes=level not in (codes, two_codes))
    assert done
    drive = Drive(core, loop, gain, level, ahead)
    references = drive.run(2047)
    assert references.max() * gain <= amplitude * 1.21  # No more than the driver's own error.
    references = drive.run(2047)
    assert loop.state == HOLDING
    assert np.abs(references * gain - amplitude).max() <= 2 * SENSE
    assert loop.measured_A == pytest.approx(amplitude, abs=2 * SENSE)
    assert loop.target_A == pytest.approx(amplitude, abs=1e-6)


def test_a_gain_that_jumps_is_followed_by_a_32nd_a_block(core):
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, ahead=0, noise=0.0)
    drive.run(31 * 400)
    drive.gain = 0.95
    drive.run(31 - loop.chips + 31)  # To the end of a block that lay behind the jump as a whole.
    error = []
    for _ in range(4):
        drive.run(31 * 5)
        error.append(1.0 - drive.gain * loop.line[0].scale / 16 * REFERENCE / 10.0)
    ratios = np.array(error[1:]) / error[:-1]
    assert ratios == pytest.approx(0.96875**5, abs=0.03)


def test_nothing_oscillates(core):
    """However far ahead set-points are planned, a jump of the gain is answered without an overshoot."""
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, noise=0.0)
    drive.run(3000)
    drive.gain = 1.15
    references = drive.run(31 * 200)
    assert references.min() >= references[-1] - REFERENCE
    assert (np.diff(references) <= REFERENCE * 1.01).all()
    assert references[-1] == pytest.approx(10.0 / 1.15, abs=0.01)


def test_a_gain_further_off_than_a_quarter_stays_short(core):
    loop, _ = configure(core, 8.0)
    Drive(core, loop, gain=0.6, noise=0.0).run(4000)
    assert loop.reference * REFERENCE == pytest.approx(10.0, abs=REFERENCE)
    assert loop.measured_A == pytest.approx(6.0, abs=0.01)
    assert loop.state == HOLDING


def test_soft_start_takes_1023_chips_in_small_steps(core):
    loop, _ = configure(core, 10.0)
    references = np.array([0.0, *Drive(core, loop).run(1023)])
    assert references[31 * 16] == pytest.approx(10.0 * 16 / 33, rel=0.05)
    assert np.diff(references).max() <= 10.0 / 33 * 1.1
    assert np.diff(references).min() >= -2 * REFERENCE
    assert references[-1] == pytest.approx(10.0, rel=0.01)
    assert loop.state == HOLDING


@pytest.mark.parametrize("count", [2048 + 1537, 2048 - 1537, 0, 4095, 4096, 65535])
def test_over_current_trips_within_one_chip(core, count):
    _, lib = core
    loop, _ = configure(core, 10.0, over=12.0)  # 1536 counts.
    Drive(core, loop).run(1500)
    assert lib.current_sample(loop, True, 2560, 2048 + 1536) == 0
    assert lib.current_sample(loop, True, 2560, count) == OVER
    assert (loop.state, loop.reference) == (FAULT, 0)
    lib.current_stop(loop)
    lib.current_start(loop)
    assert (loop.state, lib.current_set_point(loop, 16384)) == (FAULT, 0)  # And stays off.
    assert lib.current_configure(loop, core[0].addressof(loop, "config"))
    assert loop.state == OFF
    assert lib.current_ready(loop)  # The zero is still known.
    lib.current_start(loop)
    assert loop.state == RAMPING


@pytest.mark.parametrize("set_point", [2560, -2560, 1280, -700])
def test_open_coil_trips_within_one_chip_below_half_of_what_was_asked(core, set_point):
    _, lib = core
    asked = set_point * REFERENCE / SENSE
    assert lib.current_sample(running(core), True, set_point, round(2048 + 0.5 * asked + math.copysign(2, asked))) == 0
    loop = running(core)
    assert lib.current_sample(loop, True, set_point, round(2048 + 0.5 * asked - math.copysign(2, asked))) == OPEN
    assert loop.state == FAULT


def test_a_current_against_the_asked_direction_is_a_fault(core):
    _, lib = core
    assert lib.current_sample(running(core), True, 2560, 2048 - 1280) == OPEN


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("count", "cause"), [(639, OPEN), (640, 0)])
def test_from_the_first_chip_on_a_driver_without_error_is_expected(core, sign, count, cause):
    """Set-points of a drive before may come behind the start: half of what they ask for must be there."""
    _, lib = core
    loop, _ = configure(core, 10.0)
    lib.current_start(loop)
    assert lib.current_sample(loop, True, sign * 2560, 2048 + sign * count) == cause


def test_the_smallest_level_of_either_sign_is_asked_of_its_own_direction(core):
    """What their offsets ask for differs; the level itself, a 16,384th, is two sixteenths of a count."""
    _, lib = core
    loop = running(core, sizes=True)
    for line, shift in zip(loop.line, (-166, -326), strict=True):
        line.shift, line.carry = shift, 0
    assert [lib.current_set_point(loop, level) for level in (1, -1, 0)] == [11, -21, 0]
    for line in loop.line:
        line.scale = 0  # As before the first block has ended: nothing is asked, whatever the offset.
    assert [lib.current_set_point(loop, level) for level in (16384, -16384)] == [0, 0]


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("wanted", "shift", "set_point", "carry", "strayed"),
    [
        (4095 * 16, 0, 4095, 0, False),
        (4095 * 16 + 7, 0, 4095, 7, False),
        (4095 * 16 + 8, 0, 4095, 0, True),
        (70000, 0, 4095, 0, True),
        (70000, 70000 - 320, 20, 0, False),
        (24, 0, 2, -8, False),
        (23, 0, 1, 7, False),
        (7, 0, 0, 7, False),
        (16, 24, 0, -8, False),
        (16, 25, 0, 0, False),
        (16, 200, 0, 0, False),
    ],
)
def test_a_set_point_is_rounded_and_within_what_there_is(core, sign, wanted, shift, set_point, carry, strayed):
    """In sixteenths of a count: what is left is carried to the next one, unless there is no such set-point."""
    _, lib = core
    loop = running(core, sizes=True)
    loop.strayed = False
    for line in loop.line:
        line.scale, line.shift, line.carry = wanted, shift, 0
    assert lib.current_set_point(loop, sign * 16384) == sign * set_point
    assert loop.line[sign < 0].carry == carry
    assert loop.strayed == strayed
    loop.line[sign < 0].carry = 3
    loop.line[sign < 0].scale = wanted - 3
    assert lib.current_set_point(loop, sign * 16384) == sign * set_point
    assert loop.line[sign < 0].carry == carry
    assert loop.line[sign > 0].carry == 0


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("beyond", "set_point"), [(0, 0), (1, -12)])
def test_a_direction_whose_offset_alone_is_more_than_the_level_leaves_it_to_the_other(core, sign, beyond, set_point):
    """By a sixteenth of a count more: the other one, whose offset asks for 200 sixteenths, then takes them off it."""
    _, lib = core
    loop = running(core, sizes=True)
    own, other = loop.line[sign < 0], loop.line[sign > 0]
    own.scale, own.shift, own.carry = 16, 16 + beyond, 0
    other.scale, other.shift, other.carry = 16, -200, 0
    assert lib.current_set_point(loop, sign * 16384) == sign * set_point


def test_a_direction_without_a_chip_in_a_block_forgets_nothing(core):
    _, lib = core
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, noise=0.0)
    drive.run(31 * 100 + 31 - loop.chips)
    before = [(line.count, line.asked, line.came, line.product, line.square) for line in loop.line]
    for _ in range(62 - loop.chips):
        assert lib.current_sample(loop, True, 2560, 2048 + 1280) == 0
    after = [(line.count, line.asked, line.came, line.product, line.square) for line in loop.line]
    assert after[1] == before[1]
    assert after[0] != before[0]


@pytest.mark.parametrize(("amplitude", "least"), [(10.0, 2.5), (0.4, 0.125), (0.47, 0.125), (0.54, 0.135)])
def test_a_chip_that_asks_for_little_cannot_be_open(core, amplitude, least):
    """A quarter of the amplitude, or an eighth of an ampere if that is more."""
    _, lib = core
    loop, _ = configure(core, amplitude)
    Drive(core, loop, noise=0.0).run(1500)
    little = int(least / REFERENCE)
    for set_point in (0, 1, -little, little):
        assert lib.current_sample(loop, True, set_point, 2048) == 0
    assert lib.current_sample(loop, True, little + 1, 2048) == OPEN


def test_a_sinusoids_zeros_are_no_open_coil_but_a_broken_wire_is(core):
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, level=sinusoid(5))
    drive.run(3 * 2047)  # Ends at a zero.
    quiet = 0
    while drive.sample(current=0.0):
        quiet += 1
    assert drive.cause == OPEN
    assert quiet <= 20  # A quarter of the peak comes 16.5 chips behind a zero.


def test_a_coil_that_was_never_there_trips_at_a_quarter_of_the_ramp(core):
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, ahead=0)
    goes_on = [drive.sample(current=0.0) for _ in range(400)]
    first = goes_on.index(False)
    assert 31 * 6 <= first <= 31 * 9 + 1  # The reference may be a quarter above the target.
    assert loop.state == FAULT


def test_zero_open_fraction_switches_the_protection_off(core):
    loop, _ = configure(core, 10.0, open_fraction=0.0)
    drive = Drive(core, loop)
    assert all(drive.sample(current=0.0) for _ in range(2000))
    assert loop.reference <= 10.0 * 1.25 / REFERENCE + 1  # The gain is limited.


@pytest.mark.parametrize("amplitude", [0.002, 0.1])
def test_a_tiny_amplitude_has_no_open_coil(core, amplitude):
    loop, _ = configure(core, amplitude)
    drive = Drive(core, loop, ahead=0)
    assert all(drive.sample(current=0.0) for _ in range(2000))
    assert loop.state == HOLDING


@pytest.mark.parametrize("level", [codes, two_codes, sinusoid(1), sinusoid(5)])
def test_offset_of_the_sense_cancels(core, level):
    """Not only on average: a reference that wandered with a sinusoid would distort it."""
    loop, _ = configure(core, 5.0)
    drive = Drive(core, loop, level=level, offset=0.2)
    drive.run(2500)
    assert np.abs(drive.run(2047) - 5.0).max() < 0.02


def test_a_pulse_has_one_level_and_still_its_gain(core):
    loop, _ = configure(core, 8.0)
    drive = Drive(core, loop, gain=1.1, level=pulse)
    drive.run(2000)
    assert np.abs(drive.run(500) * 1.1 - 8.0).max() < 0.02


def test_current_with_the_bridge_off_is_a_fault(core):
    """In the second chip after a driven one: in the first it may still fall."""
    _, lib = core
    for count, cause in ((4094, OVER), (2048 + 64 + 1, EXCESS), (2048 + 64, 0), (2048 - 64 - 1, EXCESS)):
        loop, _ = configure(core, 10.0)
        assert lib.current_sample(loop, False, 0, 2048) == 0
        assert lib.current_sample(loop, False, 0, count) == cause, count
        loop = running(core)
        lib.current_sample(loop, True, 2560, 2048 + 1280)
        assert lib.current_sample(loop, False, 0, 2048 + 1280) == 0
        assert lib.current_sample(loop, False, 0, count) == cause, count


def test_a_current_that_still_falls_after_a_new_configuration_is_no_fault(core):
    """A parameter stops the drive a few microseconds before the chip is measured."""
    _, lib = core
    loop = running(core)
    assert lib.current_sample(loop, True, 2560, 2048 + 1280) == 0
    assert lib.current_configure(loop, core[0].addressof(loop, "config"))
    assert lib.current_sample(loop, False, 0, 2048 + 1280) == 0
    assert lib.current_sample(loop, False, 0, 2048 + 1280) == EXCESS


@pytest.mark.parametrize("sign", [1, -1])
def test_a_current_far_above_what_was_asked_is_a_fault(core, sign):
    """Beyond 1.375 times what this chip or the one before asked for, and half an ampere."""
    _, lib = core
    limit = int(1.375 * 640) + 64
    for over in (0, 2):
        loop, _ = configure(core, 10.0, over=15.9)
        lib.current_start(loop)
        lib.current_sample(loop, True, sign * 1280, 2048 + sign * 640)
        assert lib.current_sample(loop, True, sign * 100, 2048 + sign * (limit + over)) == (EXCESS if over else 0)
        if not over:
            assert lib.current_sample(loop, True, sign * 100, 2048 + sign * limit) == EXCESS


def test_the_mean_square_is_limited(core):
    """10 A with a limit of 8 A rms: (8/10)^2 = 1 - exp(-t/T); 7.9 A for ever."""
    loop, _ = configure(core, 10.0, rms=8.0, chips=2000.0)
    drive = Drive(core, loop, noise=0.0)
    drive.run(1023)
    loop.guard.heat = 0.0
    chips = 0
    while drive.sample():
        chips += 1
    assert drive.cause == OVERLOAD
    assert chips == pytest.approx(-2000.0 * math.log(1.0 - 0.64), abs=20)
    loop, _ = configure(core, 7.9, rms=8.0, chips=2000.0)
    Drive(core, loop, noise=0.0).run(20_000)


def test_what_is_hot_stays_hot_over_a_new_configuration(core):
    loop, _ = configure(core, 10.0, rms=8.0, chips=2000.0)
    Drive(core, loop, noise=0.0).run(1500)
    heat = loop.guard.heat
    assert heat > 0.0
    assert core[1].current_configure(loop, core[0].addressof(loop, "config"))
    assert loop.guard.heat == heat


@pytest.mark.parametrize("level", [codes, two_codes, three_codes, sinusoid(1), sinusoid(5), pulse])
@pytest.mark.parametrize(
    ("amplitude", "errors"),
    [
        (10.0, {"gain": 1.05, "negative_gain": 1.03}),
        (10.0, {"gain": 0.95, "error_A": 0.1}),
        (10.0, {"dc_A": 0.1}),
        (2.0, {"gain": 0.95, "negative_gain": 0.97, "error_A": -0.02, "dc_A": 0.02}),
        (2.0, {"gain": 0.94, "negative_gain": 0.96, "error_A": 0.05, "dc_A": 0.1}),
        (12.0, {"gain": 1.05, "offset": 0.2}),
    ],
)
def test_amplitude_and_direct_current_are_right_to_a_thousandth(core, amplitude, errors, level):
    """Errors of the driver by direction, offset of the sense, noise of half a count: each waveform."""
    loop, _ = configure(core, amplitude, over=15.9, sizes=level not in (codes, two_codes, pulse))
    drive = Drive(core, loop, level=level, **errors)
    drive.run(6 * 2047)
    if level is pulse:
        currents = [drive.current for _ in range(2047) if drive.sample()]
        assert np.mean(currents) == pytest.approx(amplitude, rel=1e-3)
        return
    slope, intercept = drive.amplitude_and_dc()
    assert slope == pytest.approx(amplitude, rel=1e-3)
    assert abs(intercept) < 1e-3 * amplitude


@pytest.mark.parametrize("dc", [0.1, -0.1])
def test_each_level_is_made_by_the_direction_that_can(core, dc):
    """A direct current of 5 % of the amplitude: smaller levels of its direction ask it of the other one."""
    loop, _ = configure(core, 2.0, sizes=True)
    drive = Drive(core, loop, level=sinusoid(37), dc_A=dc)
    drive.run(6 * 2047)
    errors, crossed = [], 0
    for _ in range(2 * 2047):
        level = drive.level(drive.chip)
        assert drive.sample()
        errors.append(drive.current - 2.0 * level if abs(level) > 1e-4 else 0.0)  # Smaller ones are 0.
        crossed += level * drive.asked < 0.0
        assert level * drive.asked >= 0.0 or abs(level) < 0.052
    assert np.abs(errors).max() < 1.5 * REFERENCE
    assert crossed > 40


@pytest.mark.parametrize("amplitude", [2.0, 10.0])
def test_what_is_asked_for_nothing_tells_nothing_of_the_line(core, amplitude):
    """A driver that adds 0.1 A to whatever it is asked for but to nothing: its line is that of what it is asked."""
    loop, _ = configure(core, amplitude, sizes=True)
    drive = Drive(core, loop, level=sinusoid(37), error_A=0.1)
    drive.run(12 * 2047)
    for line in loop.line:
        assert line.gain == pytest.approx(REFERENCE / SENSE, rel=1e-3)
        assert line.offset == pytest.approx(0.1 / SENSE, abs=0.2)


def test_the_zero_is_the_mean_of_1024_looks(core):
    """A step of 16 counts has come by 1 - 1/e behind as many; whoever waits for it only needs a quarter of them."""
    _, lib = core
    loop, _ = configure(core, 10.0)
    for _ in range(257):
        assert not lib.current_ready(loop)
        lib.current_sample(loop, False, 0, 2048)
    assert lib.current_ready(loop)
    for _ in range(1024):
        lib.current_sample(loop, False, 0, 2048)
    for _ in range(1024):
        lib.current_sample(loop, False, 0, 2064)
    assert loop.zero == pytest.approx(16.0 * (1.0 - math.exp(-1.0)), abs=0.02)


def test_a_small_amplitude_is_finer_than_a_count(core):
    """0.503 A are 128.77 counts of set-point. What is left is the zero of the sense, a mean of 256 looks."""
    loop, _ = configure(core, 0.503)
    drive = Drive(core, loop)
    drive.run(4000)
    slope, intercept = drive.amplitude_and_dc()
    assert slope == pytest.approx(0.503, abs=5e-4)
    assert abs(intercept) < 1e-3


def test_lost_headroom_is_told_and_winds_nothing_up(core):
    """A supply that carries 6 of 10 A for half a second, and then all of it: no current is ever above the target."""
    loop, _ = configure(core, 10.0, open_fraction=0.3)
    drive = Drive(core, loop)
    drive.run(4000)
    assert not loop.headroom_lost
    for _ in range(5000):
        level = drive.level(drive.chip)
        assert drive.sample(math.copysign(6.0, level))
    assert loop.headroom_lost
    for _ in range(100):
        assert drive.sample()
        assert abs(drive.current) < 10.05
    drive.run(31 * 36)
    assert not loop.headroom_lost


def test_a_target_beyond_the_set_points_is_told(core):
    loop, _ = configure(core, 15.9, over=15.95)
    drive = Drive(core, loop, gain=0.95)
    drive.run(4000)
    assert loop.headroom_lost
    assert loop.measured_A == pytest.approx(0.95 * 4095 * REFERENCE, abs=0.02)


@pytest.mark.parametrize("beyond", [26, 27, -26, -27])
def test_a_current_beyond_what_the_line_expects_is_told_as_one_that_is_short(core, beyond):
    """1/64 of 10 A and 6 counts: then the line is wrong, as behind a sum that was lost, and so is what it tells."""
    _, lib = core
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, noise=0.0)
    drive.run(31 * 100)
    assert loop.state == HOLDING
    assert not loop.headroom_lost
    expected = int(2560 * loop.line[0].gain_q / 65536) + loop.line[0].offset_q
    assert lib.current_sample(loop, True, 2560, 2048 + expected + beyond) == 0
    drive.run(31 - loop.chips)
    assert loop.headroom_lost == (abs(beyond) > (expected >> 6) + 6)
    drive.run(31 * 33)
    assert not loop.headroom_lost
