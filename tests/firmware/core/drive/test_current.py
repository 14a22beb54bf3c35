"""The current loop around a simulated driver and coil, its reference used as a planner does: a block or two later."""

import math
from collections import deque

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

SENSE, REFERENCE = 0.0078125, 0.00390625
OFF, RAMPING, HOLDING, FAULT = range(4)
AHEAD = 62  # Chips between the planning of a set-point and its measurement, at most.


def codes(chip):
    """Level of a chip: either sign, at random."""
    return 1.0 if chip * 7919 % 13 < 6 else -1.0


def sinusoid(periods):
    return lambda chip: math.sin(2.0 * math.pi * periods * chip / 2047)


def two_codes(chip):
    return 0.5 * (codes(chip) + (1.0 if chip * 104729 % 17 < 8 else -1.0))


def configure(core, amplitude, over=12.0, open_fraction=0.5, sense=SENSE, reference=REFERENCE):
    ffi, lib = core
    loop = ffi.new("current_t *")
    done = lib.current_configure(
        loop, ffi.new("current_config_t *", [sense, reference, amplitude, over, open_fraction])
    )
    return loop, done


class Drive:
    """A driver and its coil, set-points planned some chips ahead."""

    def __init__(self, core, loop, gain=1.0, level=codes, ahead=AHEAD, offset=0.0, noise=0.5, seed=1):
        self.lib, self.loop = core[1], loop
        self.gain, self.level, self.offset, self.noise = gain, level, offset, noise
        self.rng = np.random.default_rng(seed)
        self.planned = deque([0] * ahead)
        self.chip = 0
        self.lib.current_start(loop)

    def sample(self, current=None):
        """One chip, with the current that the coil makes or another one; returns whether the drive goes on."""
        self.planned.append(self.loop.reference)
        level = self.level(self.chip)
        self.chip += 1
        set_point = round(self.planned.popleft() * level)
        if level == 0.0:
            return True
        if current is None:
            current = set_point * REFERENCE * self.gain
        count = int(np.clip(round(2048 + (current + self.offset) / SENSE + self.rng.normal(0, self.noise)), 0, 4095))
        return self.lib.current_sample(self.loop, set_point, count)

    def run(self, chips):
        """Reference after each chip, A; the drive must go on."""
        references = []
        for _ in range(chips):
            assert self.sample(), (self.chip, self.loop.fault)
            references.append(self.loop.reference * REFERENCE)
        return np.array(references)


@settings(max_examples=25)
@given(
    gain=st.floats(0.82, 1.2),
    amplitude=st.floats(0.5, 12.0),
    ahead=st.integers(0, AHEAD),
    level=st.sampled_from([codes, two_codes, sinusoid(1), sinusoid(5), sinusoid(700)]),
)
def test_reaches_the_amplitude_whatever_the_gain(core, gain, amplitude, ahead, level):
    loop, done = configure(core, amplitude, over=15.9)
    assert done
    drive = Drive(core, loop, gain, level, ahead)
    references = drive.run(2047)
    assert references.max() * gain <= amplitude * 1.21  # No more than the driver's own error.
    references = drive.run(2047)
    assert loop.state == HOLDING
    assert np.abs(references * gain - amplitude).max() <= 2 * SENSE
    assert loop.measured_A == pytest.approx(amplitude, abs=2 * SENSE)
    assert loop.target_A == pytest.approx(amplitude, abs=1e-6)


def test_a_gain_that_jumps_is_followed_by_an_eighth_a_block(core):
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, ahead=0, noise=0.0)
    drive.run(3000)
    drive.gain = 0.9
    drive.run(31 - loop.chips + 31)  # To the end of a block that lay behind the jump as a whole.
    error = [1.0 - drive.gain * loop.reference * REFERENCE / 10.0]
    for _ in range(6):
        drive.run(31)
        error.append(1.0 - drive.gain * loop.reference * REFERENCE / 10.0)
    ratios = np.array(error[1:]) / error[:-1]
    assert ratios == pytest.approx(0.875, abs=0.02)


def test_nothing_oscillates(core):
    """However far ahead set-points are planned, a jump of the gain is answered without an overshoot."""
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, noise=0.0)
    drive.run(3000)
    drive.gain = 1.15
    references = drive.run(3000)
    assert references.min() >= references[-1] - REFERENCE
    assert (np.diff(references) <= REFERENCE * 1.01).all()


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
    assert lib.current_sample(loop, 2560, 2048 + 1536)
    assert not lib.current_sample(loop, 2560, count)
    assert (loop.state, loop.fault, loop.reference) == (FAULT, 1, 0)
    assert not lib.current_sample(loop, 0, 2048)  # And stays off.
    lib.current_stop(loop)
    lib.current_start(loop)
    assert not lib.current_sample(loop, 0, 2048)
    lib.current_clear(loop)
    assert lib.current_sample(loop, 0, 2048)
    lib.current_start(loop)
    assert loop.state == RAMPING


def test_a_limit_beyond_the_converter_trips_at_its_rails(core):
    _, lib = core
    for count, goes_on in ((1, False), (2, True), (4094, True), (4095, False)):
        loop, _ = configure(core, 1.0, over=100.0)
        lib.current_start(loop)
        assert lib.current_sample(loop, 0, count) == goes_on, count


def running(core, **options):
    loop, _ = configure(core, 10.0, **options)
    Drive(core, loop, noise=0.0).run(1500)
    return loop


@pytest.mark.parametrize("set_point", [2560, -2560, 1280, -700])
def test_open_coil_trips_within_one_chip_below_half_of_what_was_asked(core, set_point):
    _, lib = core
    asked = set_point * REFERENCE / SENSE
    assert lib.current_sample(running(core), set_point, round(2048 + 0.5 * asked + math.copysign(2, asked)))
    loop = running(core)
    assert not lib.current_sample(loop, set_point, round(2048 + 0.5 * asked - math.copysign(2, asked)))
    assert (loop.state, loop.fault) == (FAULT, 2)


def test_a_current_against_the_asked_direction_is_a_fault(core):
    _, lib = core
    assert not lib.current_sample(running(core), 2560, 2048 - 1280)


@pytest.mark.parametrize(("amplitude", "least"), [(10.0, 2.5), (0.4, 0.125)])
def test_a_chip_that_asks_for_little_cannot_be_open(core, amplitude, least):
    """A quarter of the amplitude, or an eighth of an ampere if that is more."""
    _, lib = core
    loop, _ = configure(core, amplitude)
    Drive(core, loop, noise=0.0).run(1500)
    little = int(least / REFERENCE)
    for set_point in (0, 1, -little, little):
        assert lib.current_sample(loop, set_point, 2048)
    assert not lib.current_sample(loop, little + 1, 2048)


def test_a_sinusoids_zeros_are_no_open_coil_but_a_broken_wire_is(core):
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, level=sinusoid(5))
    drive.run(3 * 2047)  # Ends at a zero.
    quiet = 0
    while drive.sample(current=0.0):
        quiet += 1
    assert loop.fault == 2
    assert quiet <= 20  # A quarter of the peak comes 16.5 chips behind a zero.


def test_a_coil_that_was_never_there_trips_at_a_quarter_of_the_ramp(core):
    loop, _ = configure(core, 10.0)
    drive = Drive(core, loop, ahead=0)
    goes_on = [drive.sample(current=0.0) for _ in range(400)]
    first = goes_on.index(False)
    assert 31 * 6 <= first <= 31 * 9 + 1  # The reference may be a quarter above the target.
    assert loop.fault == 2


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
    drive = Drive(core, loop, gain=1.1, level=lambda chip: 1.0)
    drive.run(2000)
    assert np.abs(drive.run(500) * 1.1 - 8.0).max() < 0.02


def test_off_and_stop(core):
    _, lib = core
    loop, _ = configure(core, 10.0)
    assert lib.current_sample(loop, 2560, 4095)
    Drive(core, loop).run(500)
    lib.current_stop(loop)
    assert (loop.state, loop.reference, lib.current_sample(loop, 2560, 2048)) == (OFF, 0, True)
    lib.current_start(loop)
    assert (loop.state, loop.reference, loop.target_A) == (RAMPING, 0, 0.0)


@pytest.mark.parametrize(
    "values",
    [
        {"amplitude": -1.0},
        {"amplitude": 16.0},
        {"amplitude": math.nan},
        {"amplitude": math.inf},
        {"amplitude": 1.0, "over": math.nan},
        {"amplitude": 1.0, "over": -1.0},
        {"amplitude": 1.0, "open_fraction": 1.1},
        {"amplitude": 1.0, "open_fraction": math.nan},
        {"amplitude": 1.0, "sense": 0.0},
        {"amplitude": 1.0, "reference": 0.0},
        {"amplitude": 1.0, "reference": 1e-9},
        {"amplitude": 1.0, "reference": 0.1},
    ],
)
def test_impossible_configurations_are_refused(core, values):
    assert not configure(core, **values)[1]
