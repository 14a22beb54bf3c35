"""The boards' parameter pages for a scenario: what ``make flash`` would write into each board's flash memory."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from goldfield_protocol.parameters import PARAMETERS, Value, build_page
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from hil_sim.scenario.parts import DEGREE, Beacon, FrontEnd
from hil_sim.scenario.scenario import Scenario
from hil_sim.scenario.site_file import axis_deviations

SYNC_SOURCES = {"wire": 0, "can": 2, "automatic": 3}
"""The boards' parameter for each way of a scenario to have the time."""
STRONGEST = 16
"""How many codes the sensor of a scenario chooses whose beacons share codes, or are more than a list holds."""


def parameter_page(scenario: Scenario, board: int) -> bytes:
    """Build the parameter page of a board.

    Parameters
    ----------
    scenario : Scenario
    board : int
        0 is the sensor, i is the i-th beacon.

    Raises
    ------
    goldfield_protocol.parameters.ParameterError
        If a value does not fit the boards' parameters.
    """
    if board == 0:
        own = _sensor(scenario)
    else:
        beacon = scenario.beacons[board - 1]
        own = _beacon(beacon, scenario.slots)
        if beacon.sensor is not None:
            own = {**own, **_front_end(beacon.sensor), **_code_list(scenario)}
        if scenario.sync != "wire":
            own = {**own, "sync_source": SYNC_SOURCES[scenario.sync]}
    links = scenario.links
    rates = {
        "degree": (scenario.degree, DEGREE),
        "can_rate": (CAN_RATES.index(links.can_bit_s), 0),
        "serial_rate": (SERIAL_RATES.index(links.serial_baud), 0),
    }
    return build_page({**own, **{name: value for name, (value, default) in rates.items() if value != default}})


def _sensor(scenario: Scenario) -> Mapping[str, Value]:
    sensor, half, errors = scenario.sensor, scenario.half_space, scenario.installation
    gain_sd, axis_sd = axis_deviations(scenario)
    surroundings: dict[str, Value] = {
        "pose": 1,
        "noise": sensor.sample_noise_T,
        "half_space": [0.0] * 6 if half is None else [*half.point.tolist(), *half.normal.tolist()],
        "beacons": [value for beacon in scenario.beacons for value in _beacon_row(beacon)],
        "survey": [errors.position_sd_m, errors.axis_sd_rad, errors.current_sd] * len(scenario.beacons),
        "gain_sd": gain_sd,
        "axis_sd": axis_sd,
    }
    return {
        **(surroundings if sensor.pose else {}),
        "node": sensor.node,
        "stream": sensor.stream,
        "sync_source": 1 if scenario.sync != "automatic" and not sensor.sync_wire else SYNC_SOURCES[scenario.sync],
        **_code_list(scenario),
        **_front_end(sensor),
    }


def _code_list(scenario: Scenario) -> dict[str, Value]:
    codes = [beacon.code for beacon in scenario.beacons if beacon.code is not None]
    if scenario.shared_codes or len(codes) > PARAMETERS["code_list"].count:
        return {"code_count": 0, "code_list": [], "strongest": STRONGEST}
    return {"code_count": len(codes), "code_list": codes}


def _front_end(front_end: FrontEnd) -> dict[str, Value]:
    zero, matrix = front_end.correction()
    return {
        "zero_x": float(zero[0]),
        "zero_y": float(zero[1]),
        "zero_z": float(zero[2]),
        "calibration": [float(value) for value in matrix.ravel()],
    }


def _beacon_row(beacon: Beacon) -> tuple[float, ...]:
    """Position, axis, moment and radius as the sensor's parameters have them; a wire becomes the circle of its area."""
    coil = beacon.geometry
    if coil.points_m is None:
        assert coil.radius_m is not None
        area, centre = math.pi * coil.radius_m**2, coil.position_m
    else:
        ends = np.roll(coil.points_m, -1, axis=0)
        area = float(np.linalg.norm(0.5 * np.cross(coil.points_m, ends).sum(axis=0)))
        lengths = np.linalg.norm(ends - coil.points_m, axis=1)
        centre = np.average(0.5 * (coil.points_m + ends), axis=0, weights=lengths)
    moment = coil.turns * area * beacon.circuit.current_A
    return (*map(float, centre), *map(float, coil.axis), moment, math.sqrt(area / math.pi))


def _beacon(beacon: Beacon, slots: int) -> Mapping[str, Value]:
    waveform: dict[str, Value] = {}
    if beacon.slot is not None:
        waveform = {"waveform": 1, "slots": slots, "slot": beacon.slot}
    elif beacon.periods is not None:
        waveform = {"waveform": 2, "periods": beacon.periods}
    elif beacon.rotating_periods is not None:
        waveform = {"waveform": 3, "periods": beacon.rotating_periods}
    elif beacon.codes:
        rows = [value for code in beacon.codes for value in (code.degree, code.index, code.offset, code.hold)]
        waveform = {"waveform": 4, "codes": rows}
    if beacon.code is not None:
        waveform["code"] = beacon.code
    return waveform | {
        "node": beacon.node,
        "amplitude": beacon.circuit.current_A,
        "sync_master": beacon.sync_rank,
    }
