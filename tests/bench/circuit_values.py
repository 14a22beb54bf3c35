"""What follows from the values of the reference circuit by arithmetic alone: `computed` lists it."""

from __future__ import annotations

import numpy as np

BOLTZMANN_J_PER_K = 1.380649e-23
LOGIC_V, FULL_SCALE_A, SHUNT_OHM = 3.3, 16.0, 10e-3
SENSE_GAIN = 16.5 / 1.6
BRIDGE_V, BRIDGE_V_PER_V_T, BRIDGE_NOISE_V = 8.0, 3.2e-3 / 1e-4, 3.8e-9
"""Supply of the HMC1001's bridge; its sensitivity, 3.2 mV/V/gauss; its white noise in a root hertz."""
AMPLIFIER_GAIN = 1.0 + 9900.0 / 316.0
FILTER_S = 1.6e3 * 1e-9
BURST, BETWEEN_S = 8, 1.5e-6
"""Conversions of an axis in a chip, and the time between them."""
CONVERTER_STEPS = 4096


def divided(upper: float, lower: float) -> float:
    """Return the part of a voltage that a divider leaves."""
    return lower / (upper + lower)


def thermistor_ohm(celsius: float) -> float:
    """Return the resistance of an NTC of 10 kOhm at 25 C with B = 3950 K."""
    return 10e3 * float(np.exp(3950.0 * (1.0 / (celsius + 273.15) - 1.0 / 298.15)))


def celsius_of(ohm: float) -> float:
    """Return the temperature at which such a thermistor has a resistance."""
    return 1.0 / (1.0 / 298.15 + np.log(ohm / 10e3) / 3950.0) - 273.15


def tesla_per_volt() -> float:
    """Return the field that moves the converter's pin by a volt."""
    return 1.0 / (BRIDGE_V * BRIDGE_V_PER_V_T * AMPLIFIER_GAIN)


def sample_noise_T() -> tuple[float, float]:
    """Return the noise of one conversion and of the mean of a chip's burst, tesla, before the converter's rounding.

    White noise behind a first-order low-pass has the bandwidth 1 / (4 RC), and conversions t apart have the correlation
    exp(-t / RC).
    """
    density_V = np.hypot(np.hypot(BRIDGE_NOISE_V, 3.2e-9), 60e-9 / AMPLIFIER_GAIN) * AMPLIFIER_GAIN
    one_V = density_V / np.sqrt(4.0 * FILTER_S)
    apart = np.abs(np.subtract.outer(np.arange(BURST), np.arange(BURST))) * BETWEEN_S
    burst = np.sqrt(np.exp(-apart / FILTER_S).mean())
    return float(one_V * tesla_per_volt()), float(one_V * burst * tesla_per_volt())


def computed() -> list[tuple[str, str]]:
    """Return what was computed, each as words and value."""
    one_T, burst_T = sample_noise_T()
    step_T = LOGIC_V / CONVERTER_STEPS * tesla_per_volt()
    window_V = LOGIC_V * 2.61 / (20.0 + 2.61)
    return [
        ("current sense", f"{SHUNT_OHM * SENSE_GAIN:.6f} V/A"),
        ("its error by the switches' 1.5 Ohm", f"{100 * (1600 / 1601.5 - 1):.2f} %"),
        ("over-current limit", f"{LOGIC_V * divided(17.4, 1.0) / SHUNT_OHM:.1f} A"),
        ("boost ends before the target by, without what the lead adds", f"{window_V / 2 / 10 / 0.103125:.2f} A"),
        ("full set-point through 10 MOhm behind the DAC's 15 kOhm", f"{FULL_SCALE_A * divided(0.015, 10):.3f} A"),
        ("power of a shunt at 10 A", f"{SHUNT_OHM * 100:.1f} W"),
        ("power of a shunt at 16 A", f"{SHUNT_OHM * 256:.2f} W"),
        ("a conducting IRFP260N at 10 A, at most, at 25 C", f"{40e-3 * 100:.1f} W"),
        ("an upper gate that switches at 450 kHz, at most", f"{234e-9 * 12 * 450e3:.2f} W"),
        ("delay of a dead-time stage: 1 kOhm, 470 pF, half of 5 V", f"{np.log(2) * 470:.0f} ns"),
        ("energy of the coil at 10 A", f"{0.5 * 1.9e-4 * 100 * 1e3:.2f} mJ"),
        ("it lifts C1 by", f"{0.5 * 1.9e-4 * 100 / (470e-6 * 120):.3f} V"),
        ("rise of the current at 120 V", f"{120 / 1.9e2:.3f} A/us"),
        ("rise of the current on the 5 V alone, at most", f"{(5 - 0.86) / 1.9e2:.3f} A/us"),
        ("energy in C1 at 120 V", f"{0.5 * 470e-6 * 120**2:.1f} J"),
        ("set-point for 10 A", f"{LOGIC_V * 10 / FULL_SCALE_A:.4f} V"),
        ("supply that gives 3.3 V at PC0", f"{LOGIC_V / divided(475, 10):.1f} V"),
        ("driver switches off at (R38, R39)", f"{celsius_of(10e3 * 2.0 / 18.2):.1f} C"),
        ("volts of a thermometer at 25 C", f"{LOGIC_V * divided(10e3, thermistor_ohm(25)):.3f} V"),
        ("volts of a thermometer at 80 C", f"{LOGIC_V * divided(10e3, thermistor_ohm(80)):.3f} V"),
        ("volts of a thermometer at 85 C", f"{LOGIC_V * divided(10e3, thermistor_ohm(85)):.3f} V"),
        ("gain of the sensor's amplifier", f"{AMPLIFIER_GAIN:.2f}"),
        ("corner of its low-pass", f"{1e-3 / (2 * np.pi * FILTER_S):.1f} kHz"),
        ("field at the converter's ends", f"{1e6 * 1.65 * tesla_per_volt():.1f} uT"),
        ("noise of one conversion, before rounding", f"{1e9 * one_T:.1f} nT"),
        (f"noise of a burst of {BURST}, before rounding", f"{1e9 * burst_T:.1f} nT"),
        ("a step of the converter", f"{1e9 * step_T:.1f} nT"),
        ("rounding of one conversion, standard deviation", f"{1e9 * step_T / np.sqrt(12):.1f} nT"),
        ("noise of one conversion with its rounding", f"{1e9 * np.hypot(one_T, step_T / np.sqrt(12)):.1f} nT"),
    ]
