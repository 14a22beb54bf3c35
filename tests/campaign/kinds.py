"""The kinds of faults: what begins each, and what mends it. A generator of the stage's seed draws where it strikes."""

from __future__ import annotations

import numpy as np

from hil_sim.scenario import Scenario
from tests.campaign.beacon_kinds import BEACONS
from tests.campaign.carried import CARRIED
from tests.campaign.host_kinds import HOST
from tests.campaign.link_kinds import LINKS
from tests.campaign.sensor_kinds import SENSOR, SURROUNDINGS
from tests.campaign.stage import Kind, Stage
from tests.campaign.time_kinds import TIME
from tests.campaign.wire_kinds import GLITCHES, WIRES


def pair(first: Kind, second: Kind) -> Kind:
    """Return the kind by which two things go wrong at once, and are mended at once: when the longer one ends."""

    def begin(stage: Stage) -> None:
        first.begin(stage)
        stage.notes["second"] = {}
        stage.notes, kept = stage.notes["second"], stage.notes
        second.begin(stage)
        stage.notes, stage.notes["first"] = stage.notes, kept

    def end(stage: Stage) -> None:
        kept = stage.notes
        second.end(stage)
        stage.notes = kept["first"]
        first.end(stage)

    def plan(scenario: Scenario, begin_s: float, end_s: float, random: np.random.Generator) -> Scenario:
        for kind in (first, second):
            scenario = scenario if kind.plan is None else kind.plan(scenario, begin_s, end_s, random)
        return scenario

    return Kind(
        "pair",
        f"{first.name} + {second.name}",
        begin,
        end,
        plan if first.plan or second.plan else None,
        serial=first.serial or second.serial,
        lasts_s=max(first.lasts_s, second.lasts_s),
        by_arrival=first.by_arrival or second.by_arrival,
        emulated=first.emulated or second.emulated,
    )


def one(kinds: list[Kind], name: str) -> Kind:
    """Return the kind of this name."""
    return next(kind for kind in kinds if kind.name == name)


PAIRS = [
    pair(one(BEACONS, "one dies"), one(BEACONS, "moved 0.1 m")),
    pair(one(BEACONS, "one dies"), one(TIME, "sensor's sync wire cut")),
    pair(one(BEACONS, "coil_open"), one(SENSOR, "axis gain 1.2")),
    pair(one(BEACONS, "the sync master dies"), one(LINKS, "bit errors 1e-05")),
    pair(one(SURROUNDINGS, "mains 4 uT with harmonics"), one(BEACONS, "moved 1 m")),
    pair(one(TIME, "a beacon's sync wire cut"), one(BEACONS, "one dies")),
    pair(one(GLITCHES, "50 glitches/s of 100 us"), one(BEACONS, "one dies")),
]

NOTHING = Kind("none", "nothing")
KINDS = [NOTHING, *SENSOR, *SURROUNDINGS, *CARRIED, *BEACONS, *TIME, *WIRES, *LINKS, *HOST, *PAIRS]
