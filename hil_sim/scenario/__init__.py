"""Scenario files: what the rig simulates, in TOML and SI units; ``scenarios/prigge8.toml`` is a commented example."""

from hil_sim.scenario.events import (
    BOARD_FAULTS,
    COIL_FAULTS,
    SENSOR_FAULTS,
    Bring,
    Electrical,
    Move,
    ProcessorSupply,
    SensorFault,
    Strike,
    Supply,
    Surroundings,
)
from hil_sim.scenario.installation import Installation
from hil_sim.scenario.pages import parameter_page
from hil_sim.scenario.parts import (
    CHIP_PERIOD_S,
    CONVERTER_COUNTS,
    Ambient,
    Beacon,
    CanBus,
    Circuit,
    Clock,
    FrontEnd,
    Links,
)
from hil_sim.scenario.reading import SCENARIOS, find, load, load_scenario
from hil_sim.scenario.scenario import Scenario
from hil_sim.scenario.site_file import site_toml, true_site_toml

__all__ = [
    "BOARD_FAULTS",
    "CHIP_PERIOD_S",
    "COIL_FAULTS",
    "CONVERTER_COUNTS",
    "SCENARIOS",
    "SENSOR_FAULTS",
    "Ambient",
    "Beacon",
    "Bring",
    "CanBus",
    "Circuit",
    "Clock",
    "Electrical",
    "FrontEnd",
    "Installation",
    "Links",
    "Move",
    "ProcessorSupply",
    "Scenario",
    "SensorFault",
    "Strike",
    "Supply",
    "Surroundings",
    "find",
    "load",
    "load_scenario",
    "parameter_page",
    "site_toml",
    "true_site_toml",
]
