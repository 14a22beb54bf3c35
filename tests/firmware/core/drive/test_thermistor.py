"""The thermistor's table against its law."""

import numpy as np
import pytest


def count_of(degC):
    """B 3950, 10 kOhm at 25 degC to ground, 10 kOhm above."""
    ohms = 10e3 * np.exp(3950.0 * (1.0 / (degC + 273.15) - 1.0 / 298.15))
    return 4096.0 * ohms / (ohms + 10e3)


def test_temperature_of_each_count(core):
    _, lib = core
    for degC in np.arange(-39.0, 149.0, 0.7):
        count = round(count_of(degC))
        step = abs(count_of(degC + 0.5) - count_of(degC - 0.5))
        assert lib.thermistor_degC(count) == pytest.approx(degC, abs=0.7 + 0.5 / step)


def test_count_of_each_temperature_and_back(core):
    _, lib = core
    for degC in np.arange(-40.0, 150.1, 5.0):
        count = lib.thermistor_count(degC)
        step = abs(count_of(degC + 0.5) - count_of(degC - 0.5))
        assert lib.thermistor_degC(count) == pytest.approx(degC, abs=0.51 / step)


def test_open_short_and_nonsense(core):
    _, lib = core
    assert lib.thermistor_degC(4095) == -40.0
    assert lib.thermistor_degC(0) == 150.0
    assert lib.thermistor_count(float("nan")) == lib.thermistor_count(-300.0) == lib.thermistor_count(-40.0)
    assert lib.thermistor_count(1e9) == lib.thermistor_count(150.0)


def test_between_and_beyond_multiples_of_ten_degrees(core):
    """Every count, and temperatures by quarters of a degree: lines between the rounded counts of the law."""
    _, lib = core
    degrees = np.arange(-40.0, 151.0, 10.0)
    counts = np.round(count_of(degrees))
    for count in range(4097):
        expected = np.interp(count, counts[::-1], degrees[::-1])
        assert lib.thermistor_degC(count) == pytest.approx(expected, abs=1e-4), count
    for degC in np.arange(-60.0, 180.0, 0.25):
        assert lib.thermistor_count(degC) == pytest.approx(np.interp(degC, degrees, counts), abs=0.501), degC
