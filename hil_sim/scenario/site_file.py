"""The host's site file for a scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from goldfield.site.drive import Code
from goldfield.site.reading import SURVEY_LIMITS
from hil_sim.scenario.installation import sensor_errors
from hil_sim.scenario.parts import CHIP_PERIOD_S, Beacon
from hil_sim.scenario.scenario import Scenario
from hil_sim.world.path import CoilGeometry

AUDIBLE_HUM = 0.1
"""Least hum over the noise of a sample that is told: one below adds less than 1 % to what cycles leave unexplained."""

EXACT_MATRIX = 1e-12
"""Largest element by which a matrix may differ from the identity and is still not written."""


def site_toml(scenario: Scenario) -> str:
    """Return the text of the site file with which the host knows the scenario's coils, drives and noise.

    It says of the coils what the scenario says, and how far they may be from that: the errors of installation.
    """
    gain, axis = axis_deviations(scenario)
    sensor = [f"gain_sd = {gain!r}", f"axis_sd_rad = {axis!r}"]
    errors = scenario.installation
    deviations = (errors.position_sd_m, errors.axis_sd_rad, errors.current_sd)
    return _text(scenario, sensor, deviations, [beacon.circuit.current_A for beacon in scenario.beacons])


def true_site_toml(scenario: Scenario) -> str:
    """Return the text of the site file of the bench that is there: exact, with the sensor's true axes."""
    true = scenario.installed
    matrix, offset_T = sensor_errors(scenario.sensor, true.sensor)
    sensor = ["gain_sd = 0.0", "axis_sd_rad = 0.0"]
    if not np.allclose(matrix, np.eye(3), rtol=0.0, atol=EXACT_MATRIX):
        sensor += [f"axes = [{', '.join(_toml(row) for row in matrix)}]"]
    sensor += [f"# The sensor reads {_toml(offset_T)} T where there is no field."]
    currents = [beacon.circuit.current_A / (1.0 + beacon.circuit.sense_gain_error) for beacon in true.beacons]
    return _text(true, sensor, (0.0, 0.0, 0.0), currents)


def _text(
    scenario: Scenario, sensor: list[str], deviations: tuple[float, float, float], currents_A: Sequence[float]
) -> str:
    lines = [
        "[site]",
        f"name = {_toml(scenario.name)}",
        f"chip_period_s = {CHIP_PERIOD_S!r}",
        f"degree = {scenario.degree}",
    ]
    lines += {
        "cdma": [],
        "tdma": ['access = "tdma"', f"slots = {scenario.slots}"],
        "fdma, square": ['access = "fdma"', 'tone = "square"'],
        "fdma, sine": ['access = "fdma"', 'tone = "sine"'],
    }[scenario.beacons[0].access]
    lines += ["shared_codes = true"] if scenario.shared_codes else []
    if scenario.half_space is not None:
        point, normal = _toml(scenario.half_space.point), _toml(scenario.half_space.normal)
        lines.append(f"half_space = {{ point = {point}, normal = {normal} }}")
    lines += ["", "[sensor]", f"noise_T = {scenario.sensor.sample_noise_T!r}", *_hum(scenario), *sensor, "", "[survey]"]
    lines += [f"{key} = {value!r}" for key, value in zip(SURVEY_LIMITS, deviations, strict=True)]
    for beacon, current_A in zip(scenario.beacons, currents_A, strict=True):
        lines += _beacon(beacon, current_A, scenario)
    return "\n".join(lines) + "\n"


def _hum(scenario: Scenario) -> list[str]:
    """Return what the site says of the mains; nothing of a hum that the noise hides."""
    mains = scenario.ambient.mains
    if mains is None or mains.hum_T < AUDIBLE_HUM * scenario.sensor.sample_noise_T:
        return []
    return [f"hum_T = {float(f'{mains.hum_T:.3g}')!r}", f"hum_Hz = {mains.frequency_Hz!r}"]


def axis_deviations(scenario: Scenario) -> tuple[float, float]:
    """Return how well gains and directions of the sensor's axes are known.

    They are off by the errors of installation, and if nobody calibrated them also by what a calibration takes out.
    Three axes lean by angles that are drawn, where a site file's deviation is that of six: its square is a half.
    """
    sensor, errors = scenario.sensor, scenario.installation
    exact = sensor.calibration == "exact"
    lean_rad = errors.sensor_axis_sd_rad / math.sqrt(2.0)
    pairs = ((sensor.gain_error, errors.sensor_gain_sd), (sensor.misalignment_rad, lean_rad))
    gain, axis = (math.hypot(0.0 if exact else float(np.sqrt((left**2).mean())), drawn) for left, drawn in pairs)
    return gain, axis


def _beacon(beacon: Beacon, current_A: float, scenario: Scenario) -> list[str]:
    """Return the tables of a beacon: one, or one for each of its two coils."""
    drive = [f"code = {beacon.code}"]
    if beacon.codes:
        drive = [f"codes = [{', '.join(map(_code, beacon.codes))}]"]
    elif beacon.slot is not None:
        drive = [f"slot = {beacon.slot}"]
    elif beacon.periods is not None:
        drive = [_frequency(scenario, beacon.periods)]
    elif beacon.rotating_periods is not None and beacon.second_coil is not None:
        frequency = _frequency(scenario, beacon.rotating_periods)
        cosine = _coil(f"{beacon.id}.cos", current_A, beacon.geometry)
        sine = _coil(f"{beacon.id}.sin", current_A, beacon.second_coil)
        return [*cosine, frequency, *sine, frequency, 'wave = "sine"']
    return [*_coil(beacon.id, current_A, beacon.geometry), *drive]


def _frequency(scenario: Scenario, periods: int) -> str:
    return f"frequency_Hz = {periods / (scenario.chips * CHIP_PERIOD_S)!r}"


def _coil(name: str, current_A: float, coil: CoilGeometry) -> list[str]:
    lines = ["", "[[beacon]]", f"id = {_toml(name)}", f"position_m = {_toml(coil.position_m)}"]
    lines += [f"axis = {_toml(coil.axis)}", f"turns = {_toml(coil.turns)}"]
    if coil.points_m is None:
        lines.append(f"radius_m = {_toml(coil.radius_m)}")
    else:
        lines.append(f"points_m = {_toml(coil.points_m)}")
    return [*lines, f"current_A = {_toml(current_A)}"]


def _code(code: Code) -> str:
    return f"{{ code = {code.index}, degree = {code.degree}, offset = {code.offset}, hold = {code.hold} }}"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, np.ndarray):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(float(value))
