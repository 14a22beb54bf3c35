"""A scenario as ``lockstep.h`` wants it."""

from __future__ import annotations

from typing import Any

from hil_sim.scenario import CONVERTER_COUNTS, Ambient, Circuit, FrontEnd, Scenario

SENSE_V_PER_A = 0.103125
SET_POINT_A_PER_V = 16.0 / 3.3
REFERENCE_V = 3.3
"""Supply that the boards' converters refer to, and the scales of driver and current sense (``pinout.md``)."""

SAME_IN_C = (
    *("source_Ohm", "reference_offset_A", "asymmetry", "dc_error_A", "dead_time_s", "driver_delay_s"),
    *("driver_limit_A", "ambient_degC", "thermal_resistance_K_per_W", "heat_capacity_J_per_K"),
    *("shorted_fraction", "shorted_coupling"),
)
"""Fields that a `Circuit` and ``coil_config_t`` have in common."""


def build(ffi: Any, scenario: Scenario, seed: int) -> tuple[Any, Any]:
    """Return a ``rig_config_t *`` without threads and host, and what must live as long."""
    boards = ffi.new("rig_board_config_t[]", 1 + len(scenario.beacons))
    for board, beacon in zip(boards[1 : len(boards)], scenario.beacons, strict=True):
        board.coils, board.leads = len(beacon.coils), beacon.sync_rank > 0
        for coil in board.coil[0 : board.coils]:
            _fill_coil(coil, beacon.circuit, scenario.sensor.lag_s)
    for number, board in enumerate(boards):
        front_end = scenario.front_end(number)
        if front_end is not None:
            board.senses = True
            _fill_front_end(board.front_end, front_end)
    config = ffi.new("rig_config_t *")
    config.seed, config.beacons, config.sync_master = seed, len(scenario.beacons), scenario.sync_master
    config.can_bits_per_second, config.baud = scenario.links.can_bit_s, scenario.links.serial_baud
    config.boards = boards
    fill_ambient(config.ambient, scenario.ambient, seed, scenario.sensor.lag_s)
    return config, boards


def _fill_coil(coil: Any, circuit: Circuit, lag_s: float) -> None:
    sense = SENSE_V_PER_A * (1.0 + circuit.sense_gain_error)
    coil.inductance_H, coil.resistance_Ohm = circuit.inductance_H, circuit.resistance_Ohm
    coil.supply_V, coil.lag_s = circuit.supply_V, lag_s
    coil.reference_A_per_V = SET_POINT_A_PER_V * (1.0 + circuit.reference_gain_error)
    coil.sense_V_per_A, coil.sense_noise_V = sense, circuit.sense_noise_A * sense
    for key in SAME_IN_C:
        setattr(coil, key, getattr(circuit, key))


def _fill_front_end(front_end: Any, sensor: FrontEnd) -> None:
    front_end.gain, front_end.offset_T = sensor.gain.tolist(), sensor.offset_T.tolist()
    front_end.range_T, front_end.noise_T = sensor.range_T, sensor.noise_T
    front_end.converter_noise_V = sensor.converter_noise_LSB * REFERENCE_V / CONVERTER_COUNTS


def fill_ambient(ambient: Any, source: Ambient, seed: int, lag_s: float) -> None:
    """Fill an ``ambient_t``."""
    ambient.seed, ambient.lag_s = seed, lag_s
    ambient.earth_T = source.earth_T.tolist()
    if source.mains is not None:
        ambient.mains_Hz, ambient.mains_phase_rad = source.mains.frequency_Hz, source.mains.phase_rad
        ambient.mains_T = source.mains.amplitude_T.tolist()
        ambient.harmonics[0 : len(source.mains.harmonics)] = source.mains.harmonics
    ambient.impulse_rate_Hz, ambient.impulse_T = source.impulses.rate_Hz, source.impulses.amplitude_T
    ambient.impulse_decay_s = source.impulses.decay_s
