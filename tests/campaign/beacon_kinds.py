"""Kinds of faults of beacons: their coils, drivers and boards."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from goldfield_protocol import encode
from goldfield_protocol.parameters import PARAMETERS
from hil_sim.scenario import Move, Scenario
from tests.campaign.sensor_kinds import direction
from tests.campaign.stage import FAULT_S, Kind, Stage

AWAY_S = 1000.0
"""A board that is to stay dead gets its power back so much later, or when somebody gives it."""


def struck(fault: str) -> Kind:
    """Return the kind by which something of one beacon breaks."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = stage.follower()
        stage.rig.fault(stage.notes["board"], fault)

    def end(stage: Stage) -> None:
        stage.rig.fault(stage.notes["board"], fault, active=False)
        stage.clear(stage.notes["board"])

    return Kind("beacon", fault, begin, end)


def moved(*steps_m: float) -> Kind:
    """Return the kind by which beacons are moved, each by so much, and stay so."""

    def plan(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
        which = random.choice(len(scenario.beacons), len(steps_m), replace=False)
        moves = [
            Move(at_s, scenario.beacons[number].id, step * direction(random))
            for number, step in zip(which, steps_m, strict=True)
        ]
        return replace(scenario, events=tuple(moves))

    return Kind("beacon", "moved " + " and ".join(f"{step:g} m" for step in steps_m), plan=plan)


def supply(share: float) -> Kind:
    """Return the kind by which the supply of a coil falls to a share."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = board = stage.follower()
        stage.notes["supply_V"] = stage.scenario.beacons[board - 1].circuit.supply_V
        stage.rig.set_supply_V(board, share * stage.notes["supply_V"])

    def end(stage: Stage) -> None:
        stage.rig.set_supply_V(stage.notes["board"], stage.notes["supply_V"])
        stage.clear(stage.notes["board"])

    return Kind("beacon", f"supply falls to {100 * share:g} %", begin, end)


def dead(name: str, boards: Callable[[Stage], list[int]], lasts_s: float = FAULT_S) -> Kind:
    """Return the kind by which boards lose their power, and get it back."""

    def begin(stage: Stage) -> None:
        stage.notes["boards"] = boards(stage)
        for board in stage.notes["boards"]:
            stage.rig.power_cycle(board, AWAY_S)

    def end(stage: Stage) -> None:
        for board in stage.notes["boards"]:
            stage.rig.power_cycle(board, float(stage.random.uniform(0.0, 0.02)))

    return Kind("beacon", name, begin, end, lasts_s=lasts_s)


def reset(name: str, boards: Callable[[Stage], list[int]], off_s: float = 0.05) -> Kind:
    """Return the kind by which boards lose their power for a moment."""

    def begin(stage: Stage) -> None:
        for board in boards(stage):
            stage.rig.power_cycle(board, off_s)

    return Kind("beacon", name, begin, lasts_s=off_s + 0.05)


def turned(fault: str, name: str) -> Kind:
    """Return the kind by which a beacon is reset while its wires are exchanged, and again to mend them."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = stage.follower()
        stage.rig.fault(stage.notes["board"], fault)
        stage.rig.power_cycle(stage.notes["board"], 0.05)

    def end(stage: Stage) -> None:
        stage.rig.fault(stage.notes["board"], fault, active=False)
        stage.rig.power_cycle(stage.notes["board"], 0.05)

    return Kind("beacon", name, begin, end)


def some(count: int) -> Callable[[Stage], list[int]]:
    """Return what draws so many beacons that do not lead."""
    return lambda stage: [int(board) for board in 2 + stage.random.choice(stage.beacons - 1, count, replace=False)]


def told(name: str, parameter: str, value: Callable[[Stage, int], float]) -> Kind:
    """Return the kind by which a stranger sets a parameter of a beacon, which is reset later."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = board = stage.follower()
        described = PARAMETERS[parameter]
        signals = {"kind": int(described.kind), f"value_{described.kind.name.lower()}": value(stage, board)}
        node = stage.scenario.beacons[board - 1].node
        stage.rig.can_write(*encode("PARAM_SET", signals, node=node, index=described.first))

    return Kind("beacon", name, begin, lambda stage: stage.rig.power_cycle(stage.notes["board"], 0.01))


BEACONS = [
    *(
        struck(fault)
        for fault in (
            *("coil_open", "coil_shorted", "coil_hot", "driver_runaway", "driver_stuck", "sense_shorted"),
            *("sense_held", "driver", "driver_hot", "pull_downs_lost", "bridge_swapped"),
        )
    ),
    moved(0.02),
    moved(0.1),
    moved(1.0),
    moved(0.1, 0.1),
    moved(0.1, 0.1, 0.1),
    supply(0.6),
    supply(0.0),
    dead("one dies", some(1)),
    dead("two die", some(2)),
    dead("four die", some(4)),
    dead("the sync master dies", lambda stage: [stage.scenario.sync_master]),
    dead("the sync master is dead for 30 s", lambda stage: [stage.scenario.sync_master], 30.0),
    dead("all die", lambda stage: list(range(1, 1 + stage.beacons))),
    reset("one is reset", some(1)),
    reset("the sync master is reset", lambda stage: [stage.scenario.sync_master]),
    reset("all are reset", lambda stage: list(range(1, 1 + stage.beacons))),
    turned("bridge_swapped", "comes back with its bridge swapped"),
    turned("coil_reversed", "comes back with its coil reversed"),
    told("a stranger sets half the amplitude", "amplitude", lambda stage, board: 5.0),
]
