"""Kinds of faults of the common time: cut wires, other crystals, and more than one who leads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from goldfield_protocol import encode
from hil_sim.scenario import Clock
from tests.campaign.stage import Kind, Stage
from tests.campaign.wire_kinds import quiet, with_a_deputy


def cut(board: Callable[[Stage], int], name: str) -> Kind:
    """Return the kind by which a board no longer has the sync wire."""

    def begin(stage: Stage) -> None:
        stage.notes["board"] = board(stage)
        stage.rig.fault(stage.notes["board"], "sync_wire_cut")

    def end(stage: Stage) -> None:
        stage.rig.fault(stage.notes["board"], "sync_wire_cut", active=False)

    return Kind("time", name, begin, end)


def comes_back(name: str, ppm: float) -> Kind:
    """Return the kind by which the sensor is reset, and comes back with another crystal."""
    begin = lambda stage: stage.rig.power_cycle_sensor(0.05, Clock(crystal_ppm=ppm))  # noqa: E731
    return Kind("time", name, begin, lambda stage: stage.rig.power_cycle_sensor(0.05, Clock()))


def second_master(name: str, ahead: int) -> Kind:
    """Return the kind by which a stranger on the bus numbers the cycles otherwise, ten times a second."""

    def begin(stage: Stage) -> None:
        def spoil(frames: Any) -> Any:
            signals = {"cycle": int(stage.rig.now_s * 10.0) + ahead, "chips": 1023, "chip_period": 97.75, "rank": 0}
            stage.rig.can_write(*encode("SYNC", signals, node=77, index=0))
            return frames

        stage.link.spoil = spoil

    return Kind("time", name, begin, quiet)


def two_masters() -> Kind:
    """Return the kind by which the sync master and its deputy start at once, the deputy with the rank of a master."""

    def begin(stage: Stage) -> None:
        off_s = float(stage.random.uniform(0.05, 0.15))
        stage.rig.power_cycle(stage.scenario.sync_master, off_s)
        stage.rig.power_cycle(2, off_s, sync_master=1)

    return Kind("time", "two sync masters start at once", begin, plan=with_a_deputy, lasts_s=1.0, by_arrival=True)


def time_of_its_own() -> Kind:
    """Return the kind by which a beacon starts that hears nobody and nobody hears, and leads a time of its own."""

    def begin(stage: Stage) -> None:
        for fault in ("sync_wire_cut", "can_cut"):
            stage.rig.fault(2, fault)
        stage.rig.power_cycle(2, 0.05)

    def end(stage: Stage) -> None:
        for fault in ("sync_wire_cut", "can_cut"):
            stage.rig.fault(2, fault, active=False)
        stage.rig.power_cycle(2, 0.05)

    return Kind("time", "a beacon has a time of its own, unheard", begin, end, with_a_deputy, by_arrival=True)


TIME = [
    cut(lambda stage: 0, "sensor's sync wire cut"),
    cut(lambda stage: stage.follower(), "a beacon's sync wire cut"),
    comes_back("sensor comes back 50 ppm off", 50.0),
    comes_back("sensor comes back 400 ppm off", 400.0),
    Kind("time", "sensor is reset", lambda stage: stage.rig.power_cycle_sensor(0.05), lasts_s=0.1),
    Kind("time", "sensor has no power for 3 s", lambda stage: stage.rig.power_cycle_sensor(3.0)),
    second_master("a stranger numbers the cycles", 500),
    two_masters(),
    time_of_its_own(),
]
