"""How exact a beacon's current is: a host board on the simulator's coil, for each waveform and error of the driver.

The current is that of the plant itself at the moment at which the board measures it, just before each chip ends, over
ten cycles after three seconds. Amplitude and direct current are slope and intercept of the line through the waveform's
level and that current by least squares; a pulse has one level, and no direct current.

    python -m tests.bench.drive_figures            the table
    python -m tests.bench.drive_figures --hours 10  do beacons trip that have nothing? so many hours of them together,
                                                    a fifth for each way to tell them apart (--told-apart codes: one)
"""

from __future__ import annotations

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield_protocol import FrameDecoder, decode
from hil_sim.clib import load
from hil_sim.rig import Rig
from hil_sim.scenario import load as load_scenario
from tests.command import real_number
from tests.firmware.host_rig import (
    BEACON,
    CHIPS,
    PIN_COIL_TEMPERATURE,
    PIN_CURRENT,
    PIN_ENABLE,
    PIN_SUPPLY,
    PIN_SYNC_OUT,
    PINS_BRIDGE,
    SECOND,
    Board,
    chip_seconds,
    gold_chips,
)

FFI, PLANT = load("build/libgf_rig.so", ["world/coil.h"])
SETTLED_S, MEASURED_CYCLES = 3, 10
CIRCUIT = {
    "inductance_H": 1.9e-4,
    "resistance_Ohm": 0.15,
    "supply_V": 120.0,
    "reference_A_per_V": 16.0 / 3.3,
    "sense_V_per_A": 0.103125,
    "sense_noise_V": 0.005 * 0.103125,
    "source_Ohm": 0.5,
    "dead_time_s": 5e-7,
}
TURN = 2.0 * np.pi * np.arange(CHIPS) / CHIPS
SUPERPOSED = [(10, 700, 0, 1), (10, 7, 0, 1), (10, 2, 0, 1)]
Levels = NDArray[np.float64]
WAVEFORMS: dict[str, tuple[dict[str, Any], tuple[Levels, ...]]] = {
    "one code": ({"code": 2}, (gold_chips(2).astype(float),)),
    "pulse, 1 of 9": (
        {"waveform": 1, "slots": 9, "slot": 4},
        (np.array([float(t // (CHIPS // 9) == 4) for t in range(CHIPS)]),),
    ),
    "square, 7 periods": ({"waveform": 2, "periods": 7}, (np.sign(np.cos(7 * TURN)),)),
    "rotating, 37": ({"waveform": 3, "periods": 37}, (np.cos(37 * TURN), np.sin(37 * TURN))),
    "three codes": (
        {"waveform": 4, "codes": [n for code in SUPERPOSED for n in code]},
        (np.mean([gold_chips(code[1]) for code in SUPERPOSED], axis=0),),
    ),
}
DRIVERS: dict[str, dict[str, float]] = {
    "exact driver, 20 degC": {},
    "gain +5 %, coil 0 degC": {"gain": 1.05, "ambient_degC": 0.0},
    "gain -5 %, coil 60 degC": {"gain": 0.95, "ambient_degC": 60.0},
    "gain -5 %, 60 degC, supply -20 %": {"gain": 0.95, "ambient_degC": 60.0, "sag": 0.8},
    "directions 2 % apart, DC 0.1 A": {"asymmetry": 0.01, "dc_error_A": 0.1},
    "all of these, offset 0.05 A": {
        **{"gain": 0.95, "ambient_degC": 60.0, "sag": 0.8},
        **{"asymmetry": 0.01, "dc_error_A": 0.1, "reference_offset_A": 0.05},
    },
}


class CoilBoard(Board):
    """A beacon's host board on its coils; keeps the true current at each look at it."""

    def __init__(self, parameters: dict[str, Any], driver: dict[str, float]) -> None:
        config: dict[str, float] = {**CIRCUIT, "ambient_degC": 20.0, **driver}
        self.sag_V = config.pop("sag", 1.0) * config["supply_V"]
        config["reference_A_per_V"] *= config.pop("gain", 1.0)
        self.coils = [FFI.new("coil_t *") for _ in PIN_CURRENT]
        for coil in self.coils:
            PLANT.coil_init(coil, FFI.new("coil_config_t *", config))
        self.seen: tuple[list[tuple[int, float]], list[tuple[int, float]]] = ([], [])
        inputs = {
            PIN_SUPPLY: self._supply,
            **{pin: partial(self._sense, channel) for channel, pin in enumerate(PIN_CURRENT)},
            **{pin: partial(self._temperature, channel) for channel, pin in enumerate(PIN_COIL_TEMPERATURE)},
        }
        super().__init__(BEACON, {"node": 1, "sync_master": 1, **parameters}, volts=inputs)

    def _pin_out(self, context: Any, pin: int, level: bool, time: int) -> None:
        super()._pin_out(context, pin, level, time)
        for coil, bridge in zip(self.coils, PINS_BRIDGE, strict=True):
            if pin in bridge:
                PLANT.coil_input(coil, 1 + bridge.index(pin), level, time)
            elif pin == PIN_ENABLE:
                PLANT.coil_enable(coil, level, time)

    def _analog_out(self, context: Any, channel: int, volts: float, time: int) -> None:
        super()._analog_out(context, channel, volts, time)
        PLANT.coil_reference(self.coils[channel - 1], volts, time)

    def _sense(self, channel: int, time: int) -> float:
        coil = self.coils[channel]
        self.seen[channel].append((time, PLANT.coil_current(coil, time)))
        return float(PLANT.coil_sense(coil, channel, time))

    def _supply(self, time: int) -> float:
        return float(PLANT.coil_bus(self.coils[0], time)) * 3.3 / 160.0

    def _temperature(self, channel: int, time: int) -> float:
        return float(PLANT.thermistor_volts(PLANT.coil_temperature(self.coils[channel], time)))

    def sag(self, time: int) -> None:
        """The supply falls to its share."""
        for coil in self.coils:
            PLANT.coil_supply(coil, self.sag_V, time)


def errors(waveform: str, driver: str, amplitude_A: float) -> tuple[float, float]:
    """Return the worst error of the amplitude over the channels, and the worst direct current, of the amplitude."""
    parameters, levels = WAVEFORMS[waveform]
    board = CoilBoard({"amplitude": amplitude_A, **parameters}, DRIVERS[driver])
    board.run(SECOND)
    board.sag(SECOND)
    board.run(SETTLED_S * SECOND + (MEASURED_CYCLES + 2) * SECOND // 10)
    first = next(edge for edge in board.edges(PIN_SYNC_OUT) if edge > SETTLED_S * SECOND)
    assert board.level[PIN_ENABLE], f"{waveform}, {driver}: the drive is off"
    worst_amplitude = worst_direct = 0.0
    for seen, level in zip(board.seen, levels, strict=False):
        places = [((time - first) * 1e-12 / chip_seconds(0), current) for time, current in seen]
        chips = [(int(place // 1.0), current) for place, current in places if place % 1.0 > 0.5]
        inside = [(chip % CHIPS, current) for chip, current in chips if 0 <= chip < MEASURED_CYCLES * CHIPS]
        asked, current = level[[chip for chip, _ in inside]], np.array([current for _, current in inside])
        driven = asked != 0.0
        if np.all(asked[driven] == 1.0):
            slope, direct = float(np.mean(current[driven])), 0.0
        else:
            slope, direct = (float(value) for value in np.polyfit(asked[driven], current[driven], 1))
        worst_amplitude = max(worst_amplitude, abs(slope / amplitude_A - 1.0))
        worst_direct = max(worst_direct, abs(direct / amplitude_A))
    board.close()
    return worst_amplitude, worst_direct


def table(amplitude_A: float) -> None:
    """Print the errors of each waveform with each driver."""
    print(f"{amplitude_A:g} A: error of the amplitude / direct current, % of the amplitude")
    print(f"{'':36s}" + "".join(f"{name:>19s}" for name in WAVEFORMS))
    for driver in DRIVERS:
        cells = [errors(waveform, driver, amplitude_A) for waveform in WAVEFORMS]
        print(f"{driver:36s}" + "".join(f"{100 * a:10.3f} / {100 * d:5.3f} " for a, d in cells))


SCENARIO = """
name = "{number} beacons"
seed = 10
{slots}
[ambient]
earth_T = [2e-5, 0.0, -4.5e-5]
[sensor]
node = 100
pose = 0
range_T = 2e-4
[motion]
kind = "still"
position_m = [0.5, 0.6, 0.4]
rotation_vector_rad = [0.1, -0.2, 0.3]
"""
OF_A_BEACON = """
[[beacon]]
id = "b{place}"
node = {node}
{told_apart}
position_m = [{place}.0, 0.0, 0.0]
sync_master = {master}
turns = 19
radius_m = 0.149
axis = [0.0, 0.0, 1.0]
current_A = 10.0
inductance_H = 1.9e-4
resistance_Ohm = 0.15
supply_V = 120.0
source_Ohm = 0.5
reference_gain_error = {gain:.4f}
asymmetry = {asymmetry:.4f}
dc_error_A = {dc:.4f}
dead_time_s = 5e-7
ambient_degC = 40.0
thermal_resistance_K_per_W = 2.0
heat_capacity_J_per_K = 50.0
"""
BEACONS = 8
TOLD_APART = {
    "codes": lambda place: f"code = {place}",
    "superposed": lambda place: f"codes = [{', '.join(f'{{ code = {3 * place + i} }}' for i in range(3))}]",
    "slots": lambda place: f"slot = {place}",
    "periods": lambda place: f"periods = {7 + 4 * place}",
    "rotation": lambda place: f"rotating_periods = {11 + 6 * place}\nsecond_axis = [1.0, 0.0, 0.0]",
}
"""What each beacon of a scenario drives, by its place."""


def scenario_text(told_apart: str, random: np.random.Generator) -> str:
    """Return a scenario of beacons whose drivers have errors at random."""
    text = SCENARIO.format(number=BEACONS, slots="slots = 9" if told_apart == "slots" else "")
    for place in range(BEACONS):
        text += OF_A_BEACON.format(
            place=place,
            node=place + 1,
            told_apart=TOLD_APART[told_apart](place),
            master=str(place == 0).lower(),
            gain=random.uniform(-0.05, 0.05),
            asymmetry=random.uniform(-0.01, 0.01),
            dc=random.uniform(-0.1, 0.1),
        )
    return text


def endurance(told_apart: str, hours: float) -> None:
    """Run beacons so long together, each supply moved by up to 20 % each ten seconds, and tell whether one went off."""
    random = np.random.default_rng([10, list(TOLD_APART).index(told_apart)])
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "beacons.toml"
        path.write_text(scenario_text(told_apart, random), encoding="utf-8")
        scenario = load_scenario(path)
    boards = range(1, BEACONS + 1)
    began, causes, lost, on, steps = time.process_time(), set(), 0, 0, round(hours * 360 / BEACONS)
    with Rig(scenario, "host", seed=10, threads=1) as rig:
        decoders = {board: FrameDecoder() for board in boards}
        rig.watch_pins()
        for step in range(steps):
            rig.advance(10.0)
            rig.serial_read(0)
            rig.can_read()
            for board in boards:
                rig.set_supply_V(board, 120.0 * float(random.uniform(0.8, 1.2)))
                changes = rig.pin_changes(board)
                on += int(np.count_nonzero((changes["pin"] == PIN_ENABLE) & changes["level"]))
                frames = [decode(f.identifier, f.data) for f in decoders[board].feed(rig.serial_read(board))]
                health = [m.signals for m in frames if m is not None and m.name == "DRIVE_HEALTH"]
                causes |= {int(signals["cause"]) for signals in health}
                lost += sum(int(signals["headroom_lost"]) for signals in health)
            if step % 9 == 8 or step + 1 == steps:
                print(
                    f"{told_apart}: {(step + 1) / 360 * BEACONS:.2f} hours of boards, {BEACONS} at a time, switched"
                    f" on {on} times, causes {sorted(causes)}, headroom lost in {lost} reports,"
                    f" {time.process_time() - began:.0f} s of processor",
                    flush=True,
                )


def main() -> None:
    """Print what is asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--hours", type=real_number(0.001), help="run beacons so long together, and tell whether one trips"
    )
    parser.add_argument("--told-apart", choices=TOLD_APART, help="run only these, for a fifth of the hours")
    arguments = parser.parse_args()
    if arguments.hours is not None:
        for told_apart in [arguments.told_apart] if arguments.told_apart else TOLD_APART:
            endurance(told_apart, arguments.hours / len(TOLD_APART))
        return
    for amplitude_A in (10.0, 2.0):
        table(amplitude_A)


if __name__ == "__main__":
    main()
