"""Kinds of faults of the sensor's front end and converters, and of the fields that surround it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hil_sim.scenario import Ambient, Bring, Scenario
from hil_sim.scenario.parts import Impulses, Mains
from hil_sim.world.magnet import Magnet
from hil_sim.world.sheet import Sheet
from tests.campaign.stage import LOW_M, Kind, Stage


def direction(random: np.random.Generator) -> Any:
    """Draw a direction, shape (3,)."""
    drawn = random.normal(size=3)
    return drawn / np.linalg.norm(drawn)


# ---- Front end and converters ----


def axis(fault: str, value: float = 0.0) -> Kind:
    """Return the kind by which one axis fails."""

    def begin(stage: Stage) -> None:
        stage.notes["axis"] = int(stage.random.integers(3))
        stage.rig.sensor_fault(stage.notes["axis"], fault, value)

    name = f"axis {fault}" + (f" {value:g}" if fault in ("gain", "bit_high", "bit_low") else "")
    return Kind("sensor", name, begin, lambda stage: stage.rig.sensor_fault(stage.notes["axis"], "sound"))


def all_axes(name: str, *faults: tuple[str, float]) -> Kind:
    """Return the kind by which all axes fail, each in its way."""

    def begin(stage: Stage) -> None:
        for number, (fault, value) in enumerate(faults):
            stage.rig.sensor_fault(number, fault, value)

    def end(stage: Stage) -> None:
        for number in range(3):
            stage.rig.sensor_fault(number, "sound")

    return Kind("sensor", name, begin, end)


SENSOR = [
    *(axis(fault) for fault in ("held", "low", "high")),
    *(axis("gain", value) for value in (-1.0, 0.5, 0.8, 0.95, 1.2, 2.0)),
    *(axis("bit_high", bit) for bit in (11.0, 8.0, 4.0)),
    *(axis("bit_low", bit) for bit in (10.0, 6.0)),
    all_axes("all axes low", *[("low", 0.0)] * 3),
    all_axes("all axes reversed", *[("gain", -1.0)] * 3),
    all_axes("all gains 1.2", *[("gain", 1.2)] * 3),
    all_axes("two axes swapped", ("other_axis", 1.0), ("other_axis", 0.0), ("sound", 0.0)),
    all_axes("axes rotated", ("other_axis", 1.0), ("other_axis", 2.0), ("other_axis", 0.0)),
    all_axes("two axes held", ("held", 0.0), ("held", 0.0), ("sound", 0.0)),
]

# ---- Surroundings ----


def surroundings(name: str, **changes: Any) -> Kind:
    """Return the kind by which the ambient fields become others."""

    def begin(stage: Stage) -> None:
        stage.rig.surround(replace(stage.scenario.ambient, **changes))

    return Kind("surroundings", name, begin, lambda stage: stage.rig.surround(stage.scenario.ambient))


def earth(step_T: float) -> Kind:
    """Return the kind by which the constant field jumps."""

    def begin(stage: Stage) -> None:
        ambient: Ambient = stage.scenario.ambient
        stage.rig.surround(replace(ambient, earth_T=ambient.earth_T + step_T * direction(stage.random)))

    def end(stage: Stage) -> None:
        stage.rig.surround(stage.scenario.ambient)

    return Kind("surroundings", f"constant field jumps {step_T * 1e6:g} uT", begin, end)


def passing(name: str, moment_A_m2: float, nearest_m: float, speed_m_per_s: float) -> Kind:
    """Return the kind by which a magnet passes where the sensor is in the middle of the fault."""

    def plan(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
        middle_s = 0.5 * (at_s + until_s)
        place = scenario.motion.poses(np.array([middle_s]))[0][0]
        along, beside = direction(random), direction(random)
        beside -= along * (along @ beside)
        beside /= np.linalg.norm(beside)
        start = place + nearest_m * beside - speed_m_per_s * (middle_s - at_s) * along
        magnet = Magnet(moment_A_m2 * direction(random), start, speed_m_per_s * along, at_s, until_s)
        return replace(scenario, magnets=(magnet,))

    return Kind("surroundings", name, plan=plan)


def sheet(name: str, side_m: float, distance_m: float) -> Kind:
    """Return the kind by which a sheet of metal stands beside the walked room, and stays."""

    def plan(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
        centre = np.array([LOW_M[0] - distance_m, float(random.uniform(0.7, 1.4)), float(random.uniform(0.6, 1.2))])
        return replace(scenario, events=(Bring(at_s, Sheet(centre, np.array([1.0, 0.0, 0.0]), side_m)),))

    return Kind("surroundings", name, plan=plan)


NOISY_MAINS = Mains(50.0, np.array([3e-6, 2e-6, 1e-6]), (1.0, 0.0, 0.3, 0.0, 0.2), 0.0)
SURROUNDINGS = [
    surroundings("mains 4 uT with harmonics", mains=NOISY_MAINS),
    surroundings("traction current 16.7 Hz 20 uT", mains=Mains(50.0 / 3.0, np.array([2e-5, 0.0, 0.0]), (1.0,), 0.0)),
    surroundings("impulses 30/s of 20 uT", impulses=Impulses(30.0, 2e-5)),
    surroundings("impulses 1/s of 1 mT", impulses=Impulses(1.0, 1e-3)),
    *(earth(step) for step in (5e-6, 5e-5)),
    passing("loudspeaker passes at 0.3 m", 10.0, 0.3, 1.0),
    passing("car passes at 2 m", 300.0, 2.0, 3.0),
    passing("magnet passes at 0.1 m", 3.0, 0.1, 0.5),
    sheet("sheet of 0.5 m comes", 0.5, 0.15),
    sheet("sheet of 1.5 m comes", 1.5, 0.3),
]
