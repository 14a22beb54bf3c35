"""The host's site file for a scenario."""

from __future__ import annotations

from typing import Any

import numpy as np

from goldfield.site.drive import Code
from hil_sim.scenario.parts import CHIP_PERIOD_S, Beacon, FrontEnd
from hil_sim.scenario.scenario import Scenario
from hil_sim.world.path import CoilGeometry


def site_toml(scenario: Scenario) -> str:
    """Return the text of the site file with which the host knows the scenario's coils, drives and noise."""
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
    if scenario.half_space is not None:
        point, normal = _toml(scenario.half_space.point), _toml(scenario.half_space.normal)
        lines.append(f"half_space = {{ point = {point}, normal = {normal} }}")
    lines += ["", "[sensor]", f"noise_T = {scenario.sensor.sample_noise_T!r}", *_axes(scenario.sensor)]
    lines += ["", "[survey]", "position_sd_m = 0.0", "axis_sd_rad = 0.0", "current_sd = 0.0"]
    for beacon in scenario.beacons:
        lines += _beacon(beacon, scenario)
    return "\n".join(lines) + "\n"


def axis_deviations(sensor: FrontEnd) -> tuple[float, float]:
    """Return how well gains and directions of the sensor's axes are known: exactly, or as if nobody calibrated them."""
    errors = (sensor.gain_error, sensor.misalignment_rad)
    exact = sensor.calibration == "exact"
    gain, axis = (0.0 if exact else float(np.sqrt((error**2).mean())) for error in errors)
    return gain, axis


def _axes(sensor: FrontEnd) -> list[str]:
    gain, axis = axis_deviations(sensor)
    return [f"gain_sd = {gain!r}", f"axis_sd_rad = {axis!r}"]


def _beacon(beacon: Beacon, scenario: Scenario) -> list[str]:
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
        cosine = _coil(f"{beacon.id}.cos", beacon, beacon.geometry)
        sine = _coil(f"{beacon.id}.sin", beacon, beacon.second_coil)
        return [*cosine, frequency, *sine, frequency, 'wave = "sine"']
    return [*_coil(beacon.id, beacon, beacon.geometry), *drive]


def _frequency(scenario: Scenario, periods: int) -> str:
    return f"frequency_Hz = {periods / (scenario.chips * CHIP_PERIOD_S)!r}"


def _coil(name: str, beacon: Beacon, coil: CoilGeometry) -> list[str]:
    lines = ["", "[[beacon]]", f"id = {_toml(name)}", f"position_m = {_toml(coil.position_m)}"]
    lines += [f"axis = {_toml(coil.axis)}", f"turns = {_toml(coil.turns)}"]
    if coil.points_m is None:
        lines.append(f"radius_m = {_toml(coil.radius_m)}")
    else:
        lines.append(f"points_m = {_toml(coil.points_m)}")
    return [*lines, f"current_A = {_toml(beacon.circuit.current_A)}"]


def _code(code: Code) -> str:
    return f"{{ code = {code.index}, degree = {code.degree}, offset = {code.offset}, hold = {code.hold} }}"


def _toml(value: Any) -> str:
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, np.ndarray):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(float(value))
