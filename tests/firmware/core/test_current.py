"""The current loop around a simulated driver and coil."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

SENSE, REFERENCE = 0.0078125, 0.00390625
OFF, RAMPING, HOLDING, FAULT = range(4)
KEEP, SET_REFERENCE, DRIVE_OFF = range(3)


def configure(core, amplitude, over=12.0, open_fraction=0.5, sense=SENSE, reference=REFERENCE):
    ffi, lib = core
    loop = ffi.new("current_t *")
    done = lib.current_configure(
        loop, ffi.new("current_config_t *", [sense, reference, amplitude, over, open_fraction])
    )
    return loop, done


def run(core, loop, chips, gain=1.0, seed=1, noise=0.5, start=0, offset=0.0):
    """Drive alternating signs through a driver of this gain; returns the reference after each chip, A."""
    _, lib = core
    rng = np.random.default_rng(seed)
    references = []
    for chip in range(start, start + chips):
        sign = 1 if chip * 7919 % 13 < 6 else -1
        current = sign * loop.reference * REFERENCE * gain + offset
        count = int(np.clip(round(2048 + current / SENSE + rng.normal(0, noise)), 0, 4095))
        before = loop.reference
        action = lib.current_sample(loop, count)
        assert action != DRIVE_OFF, (chip, count, loop.fault)
        assert (action == SET_REFERENCE) == (loop.reference != before)
        references.append(loop.reference * REFERENCE)
    return references


@settings(max_examples=25, deadline=None)
@given(gain=st.floats(0.82, 1.2), amplitude=st.floats(0.5, 12.0))
def test_reaches_the_amplitude_whatever_the_gain(core, gain, amplitude):
    _, lib = core
    loop, done = configure(core, amplitude, over=15.9)
    assert done
    lib.current_start(loop)
    references = run(core, loop, 1023, gain)
    assert loop.state == HOLDING
    assert max(references) * gain <= amplitude * 1.25  # No overshoot worth the name.
    run(core, loop, 1023, gain, start=1023)
    mean = lib.current_amperes(loop, loop.mean)
    assert mean == pytest.approx(amplitude, abs=2 * SENSE)
    assert lib.current_amperes(loop, loop.target) == pytest.approx(amplitude, abs=1e-4)


def test_soft_start_takes_1023_chips_in_small_steps(core):
    _, lib = core
    loop, _ = configure(core, 10.0)
    lib.current_start(loop)
    references = np.array([0.0, *run(core, loop, 1023)])
    assert references[31 * 16] == pytest.approx(10.0 * 16 / 33, rel=0.05)
    assert np.diff(references).max() <= 10.0 / 33 * 1.1
    assert np.diff(references).min() >= -2 * REFERENCE
    assert references[-1] == pytest.approx(10.0, rel=0.01)
    assert loop.state == HOLDING


@pytest.mark.parametrize("count", [2048 + 1537, 2048 - 1537, 0, 4095, 4096, 65535])
def test_over_current_trips_within_one_chip(core, count):
    _, lib = core
    loop, _ = configure(core, 10.0, over=12.0)  # 1536 counts.
    lib.current_start(loop)
    run(core, loop, 1500)
    assert lib.current_sample(loop, 2048 + 1536) != DRIVE_OFF
    assert lib.current_sample(loop, count) == DRIVE_OFF
    assert (loop.state, loop.fault, loop.reference) == (FAULT, 1, 0)
    assert lib.current_sample(loop, 2048) == DRIVE_OFF  # And stays off.
    lib.current_stop(loop)
    lib.current_start(loop)
    assert lib.current_sample(loop, 2048) == DRIVE_OFF
    lib.current_clear(loop)
    assert lib.current_sample(loop, 2048) == KEEP
    lib.current_start(loop)
    assert loop.state == RAMPING


def test_a_limit_beyond_the_converter_trips_at_its_rails(core):
    _, lib = core
    for count, action in ((1, DRIVE_OFF), (2, KEEP), (4094, KEEP), (4095, DRIVE_OFF)):
        loop, _ = configure(core, 1.0, over=100.0)
        lib.current_start(loop)
        assert lib.current_sample(loop, count) == action, count


def test_open_coil_trips_within_one_chip(core):
    _, lib = core
    loop, _ = configure(core, 10.0)
    lib.current_start(loop)
    run(core, loop, 1500)
    assert lib.current_sample(loop, 2048 + 641) != DRIVE_OFF  # Half of 1280 counts.
    assert lib.current_sample(loop, 2048 - 639) == DRIVE_OFF
    assert (loop.state, loop.fault) == (FAULT, 2)


def test_a_coil_that_was_never_there_trips_at_a_quarter_of_the_ramp(core):
    _, lib = core
    loop, _ = configure(core, 10.0)
    lib.current_start(loop)
    actions = [lib.current_sample(loop, 2048) for _ in range(400)]
    first = actions.index(DRIVE_OFF)
    assert 31 * 8 <= first <= 31 * 9 + 1
    assert loop.fault == 2


def test_zero_open_fraction_switches_the_protection_off(core):
    _, lib = core
    loop, _ = configure(core, 10.0, open_fraction=0.0)
    lib.current_start(loop)
    assert DRIVE_OFF not in [lib.current_sample(loop, 2048) for _ in range(2000)]
    assert loop.reference <= 10.0 * 1.25 / REFERENCE + 1  # The trim is limited.


def test_a_tiny_amplitude_has_no_open_coil(core):
    _, lib = core
    loop, _ = configure(core, 0.1)
    lib.current_start(loop)
    assert DRIVE_OFF not in [lib.current_sample(loop, 2048) for _ in range(2000)]


def test_offset_of_the_sense_cancels(core):
    _, lib = core
    loop, _ = configure(core, 5.0)
    lib.current_start(loop)
    run(core, loop, 3000, offset=0.2)
    assert loop.reference * REFERENCE == pytest.approx(5.0, abs=0.1)


def test_off_and_stop(core):
    _, lib = core
    loop, _ = configure(core, 10.0)
    assert lib.current_sample(loop, 4095) == KEEP
    lib.current_start(loop)
    run(core, loop, 500)
    lib.current_stop(loop)
    assert (loop.state, lib.current_sample(loop, 2048)) == (OFF, KEEP)
    lib.current_start(loop)
    assert (loop.state, loop.reference, loop.target) == (RAMPING, 0, 0)


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
    ],
)
def test_impossible_configurations_are_refused(core, values):
    assert not configure(core, **values)[1]
