"""Scenario files: what the rig simulates, in TOML and SI units; ``scenarios/prigge8.toml`` is a commented example."""

from hil_sim.scenario.parts import CONVERTER_COUNTS, Ambient, Beacon, Circuit, Clock, FrontEnd
from hil_sim.scenario.reading import SCENARIOS, find, load, load_scenario
from hil_sim.scenario.scenario import Scenario

__all__ = [
    "CONVERTER_COUNTS",
    "SCENARIOS",
    "Ambient",
    "Beacon",
    "Circuit",
    "Clock",
    "FrontEnd",
    "Scenario",
    "find",
    "load",
    "load_scenario",
]
