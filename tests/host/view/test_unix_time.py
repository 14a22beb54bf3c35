"""The time of a measurement by the wall clock, where messages take longer or shorter and clocks drift or are set."""

import math

import numpy as np
import pytest

from goldfield.view.unix_time import BACK_S, DRIFT, LONGEST_DELAY_S, UnixTime

BEGIN_S = 1_700_000_000.0


@pytest.fixture
def clock():
    return UnixTime(cycle_s=0.1)


def test_nothing_is_known_before_anything_arrived(clock):
    assert math.isnan(clock.at(1.0))
    clock.note(math.nan, BEGIN_S)
    clock.note(1.0, math.nan)
    assert math.isnan(clock.at(1.0))


def test_times_do_not_jitter_with_the_messages(clock):
    delays = 0.002 + np.random.default_rng(3).exponential(0.01, 500)
    for number, delay in enumerate(delays):
        clock.note(0.1 * number, BEGIN_S + 0.1 * number + delay)
    late = clock.at(50.0) - (BEGIN_S + 50.0)
    assert delays.min() - 1e-6 <= late < delays.min() + 50.0 * DRIFT


@pytest.mark.parametrize("rate", [1.0 + 90e-6, 1.0 - 90e-6])
def test_a_clock_that_drifts_is_followed(clock, rate):
    for number in range(36_000):
        clock.note(0.1 * number * rate, BEGIN_S + 0.1 * number)
    assert clock.at(3599.9 * rate) == pytest.approx(BEGIN_S + 3599.9, abs=1e-4)


@pytest.mark.parametrize("ended_s", [0.5, 10.0 - BACK_S - 0.1, 500.0])
def test_a_sensor_that_restarts_has_its_clock_anew(clock, ended_s):
    clock.note(10.0, BEGIN_S)
    clock.note(ended_s, BEGIN_S + 0.5)
    assert clock.at(ended_s) == BEGIN_S + 0.5


def test_a_message_that_was_held_up_moves_nothing(clock):
    clock.note(1.0, BEGIN_S)
    clock.note(2.0, BEGIN_S + 1.0 + LONGEST_DELAY_S - 0.01)
    assert clock.at(2.0) == pytest.approx(BEGIN_S + 1.0, abs=2 * DRIFT)
    clock.note(3.0, BEGIN_S + 2.0 + LONGEST_DELAY_S + 0.01)
    assert clock.at(3.0) == pytest.approx(BEGIN_S + 2.0 + LONGEST_DELAY_S + 0.01)
