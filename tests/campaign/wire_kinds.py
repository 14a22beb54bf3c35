"""Kinds of faults on the sync wire and of the bus's plugs, by other masters, and of oscillators."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hil_sim.scenario import Clock, Scenario
from tests.campaign.links import sound
from tests.campaign.stage import CYCLE_S, Kind, Stage

LOOK_S = 0.02
"""The host looks at the bus so often, and each time the wire is struck for the next span of this length."""
PULSE_S = 1e-4
"""About the width of a master's own pulse: a chip."""


def quiet(stage: Stage) -> None:
    """Let the link be sound again."""
    stage.link.spoil = sound


# ---- What is on the sync wire and is no edge of the master ----


def struck(name: str, width_s: float, moments: Callable[[Stage], Callable[[float, float], list[float]]]) -> Kind:
    """Return the kind by which pulses come on the sync wire; ``moments`` tells those between two virtual times."""

    def begin(stage: Stage) -> None:
        between = moments(stage)

        def strike(data: Any) -> Any:
            now_s = stage.rig.now_s
            for time_s in between(now_s, now_s + LOOK_S):
                stage.rig.glitch(width_s, max(time_s - now_s, 0.0))
            return data

        stage.link.spoil = strike

    return Kind("sync wire", name, begin, quiet)


def at_random(rate_Hz: float) -> Callable[[Stage], Callable[[float, float], list[float]]]:
    """Return moments that come so often, each independent of the others."""

    def moments(stage: Stage) -> Callable[[float, float], list[float]]:
        def between(begin_s: float, end_s: float) -> list[float]:
            count = stage.random.poisson(rate_Hz * (end_s - begin_s))
            return sorted(float(one) for one in stage.random.uniform(begin_s, end_s, count))

        return between

    return moments


def regular(period_s: float) -> Callable[[Stage], Callable[[float, float], list[float]]]:
    """Return the moments of another master: one a period, from a moment that is drawn on."""

    def moments(stage: Stage) -> Callable[[float, float], list[float]]:
        first_s = stage.rig.now_s + float(stage.random.uniform(0.0, period_s))

        def between(begin_s: float, end_s: float) -> list[float]:
            first, last = (int(np.ceil((time_s - first_s) / period_s)) for time_s in (begin_s, end_s))
            return [first_s + number * period_s for number in range(max(first, 0), last)]

        return between

    return moments


GLITCHES = [
    struck("50 glitches/s of 1 us", 1e-6, at_random(50.0)),
    struck("50 glitches/s of 100 us", PULSE_S, at_random(50.0)),
    struck("3 glitches/s of 100 us", PULSE_S, at_random(3.0)),
    struck("a foreign sync of the same period", PULSE_S, regular(CYCLE_S)),
    struck("a sync slides by 1 ms a cycle", PULSE_S, regular(1.01 * CYCLE_S)),
    struck("a sync slides by 10 us a cycle", PULSE_S, regular(1.0001 * CYCLE_S)),
    struck("a sync of 7.3 a cycle", PULSE_S, regular(CYCLE_S / 7.3)),
]

# ---- Plugs of the bus, and two masters on the wire ----


def off_the_bus(name: str, board: Callable[[Stage], int], plan: Any = None) -> Kind:
    """Return the kind by which a board's plug of the bus is pulled."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = board(stage)
        stage.rig.fault(stage.notes["board"], "can_cut")

    def end(stage: Stage) -> None:
        stage.rig.fault(stage.notes["board"], "can_cut", active=False)

    return Kind("CAN", name, begin, end, plan)


def with_a_deputy(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
    """Return the bench whose second beacon leads where it hears no master."""
    first, second, *others = scenario.beacons
    return replace(scenario, beacons=(first, replace(second, sync_rank=2), *others))


def master(stage: Stage) -> int:
    """Return the board that leads."""
    return stage.scenario.sync_master


def dead_master() -> Kind:
    """Return the kind by which the master dies, a deputy leads, and the master comes back."""

    def end(stage: Stage) -> None:
        stage.rig.power_cycle(master(stage), float(stage.random.uniform(0.0, 0.02)))

    return Kind(
        "sync wire",
        "the master dies and a deputy leads",
        lambda stage: stage.rig.power_cycle(master(stage), 1000.0),
        end,
        with_a_deputy,
    )


PLUGS = [
    off_the_bus("a beacon loses the bus", lambda stage: stage.follower()),
    off_the_bus("the sync master loses the bus", master),
    off_the_bus("the sync master loses the bus, and a deputy leads", master, with_a_deputy),
    off_the_bus("the sensor loses the bus", lambda stage: 0),
    dead_master(),
]

# ---- Oscillators ----


def restarts(name: str, board: Callable[[Stage], int], ppm: float) -> Kind:
    """Return the kind by which a beacon is reset and comes back with another crystal, until it is reset again."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = number = board(stage)
        clock = stage.scenario.beacons[number - 1].clock
        stage.rig.power_cycle(number, 0.05, replace(clock, crystal_ppm=clock.crystal_ppm + ppm))

    def end(stage: Stage) -> None:
        number = stage.notes["board"]
        stage.rig.power_cycle(number, 0.05, stage.scenario.beacons[number - 1].clock)

    return Kind("time", name, begin, end)


def drifts(ppm_per_s: float) -> Kind:
    """Return the kind by which the sensor's crystal drifts all the time, and faster than any by warmth."""

    def plan(scenario: Scenario, at_s: float, until_s: float, random: np.random.Generator) -> Scenario:
        clock: Clock = replace(scenario.sensor.clock, crystal_ppm_per_s=ppm_per_s)
        return replace(scenario, sensor=replace(scenario.sensor, clock=clock))

    return Kind("time", f"sensor's crystal drifts {ppm_per_s:g} ppm/s", plan=plan, emulated=True)


def crystal_stops(name: str, board: Callable[[Stage], int]) -> Kind:
    """Return the kind by which a board's crystal stops: the watchdogs start it anew on its internal oscillator."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = board(stage)
        stage.rig.crystal(stage.notes["board"], False)

    def end(stage: Stage) -> None:
        stage.rig.crystal(stage.notes["board"], True)
        stage.rig.power_cycle(stage.notes["board"], 0.05)

    return Kind("time", name, begin, end, emulated=True)


def sags(volts: float) -> Kind:
    """Return the kind by which the supply of a beacon's processor falls."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = stage.follower()
        stage.rig.supply(stage.notes["board"], volts)

    return Kind(
        "beacon",
        f"processor's supply at {volts:g} V",
        begin,
        lambda stage: stage.rig.supply(stage.notes["board"], 3.3),
        emulated=True,
    )


OSCILLATORS = [
    restarts("a beacon comes back 50 ppm off", lambda stage: stage.follower(), 50.0),
    restarts("the sync master comes back 50 ppm off", master, 50.0),
    drifts(1.0),
    crystal_stops("sensor's crystal stops", lambda stage: 0),
    crystal_stops("a beacon's crystal stops", lambda stage: stage.follower()),
    sags(2.6),
    sags(1.9),
]


def corrupted(frames: int) -> Kind:
    """Return the kind by which each look destroys so many frames in a row: senders go bus-off."""

    def begin(stage: Stage) -> None:
        def spoil(data: Any) -> Any:
            stage.rig.can_corrupt(frames)
            return data

        stage.link.spoil = spoil

    return Kind("CAN", f"{frames} frames in a row destroyed, bus-off", begin, quiet, lasts_s=1.0)


WIRES: list[Kind] = [*GLITCHES, *PLUGS, *OSCILLATORS, corrupted(40)]
