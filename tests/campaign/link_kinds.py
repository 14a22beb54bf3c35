"""Kinds of faults of the links: what the host gets is spoilt, the bus disturbed or babbled on, or the host asleep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hil_sim.rig import Rig
from hil_sim.world.roaming import Roaming
from tests.campaign import links
from tests.campaign.stage import HIGH_M, LOW_M, RATE_RAD_S, SPEED_M_S, Kind, Stage
from tests.campaign.wire_kinds import quiet


def spoilt(name: str, spoil: Callable[[np.random.Generator], links.Spoil], *, serial: bool) -> Kind:
    """Return the kind by which what the host gets is spoilt."""

    def begin(stage: Stage) -> None:
        stage.link.spoil = spoil(stage.random)

    return Kind("serial" if serial else "CAN", name, begin, quiet, serial=serial)


def flooded(name: str, identifier: int) -> Kind:
    """Return the kind by which a node that babbles asks for the bus all the time."""

    def begin(stage: Stage) -> None:
        def spoil(frames: Any) -> Any:
            for _ in range(100):
                stage.rig.can_write(identifier, bytes(8))
            return [frame for frame in frames if frame.identifier != identifier]

        stage.link.spoil = spoil

    return Kind("CAN", name, begin, quiet, lasts_s=1.0)


def errors(probability: float) -> Kind:
    """Return the kind by which bits on the bus are wrong."""
    begin = lambda stage: stage.rig.can_errors(probability)  # noqa: E731
    return Kind("CAN", f"bit errors {probability:g}", begin, lambda stage: stage.rig.can_errors(0.0))


def again(stage: Stage) -> None:
    """Let the sensor's frames of half a second ago come once more."""
    kept: list[Any] = []
    node = stage.scenario.sensor.node

    def spoil(frames: Any) -> Any:
        kept.append([frame for frame in frames if frame.identifier & 0xFFF == node])
        return [*frames, *(kept.pop(0) if len(kept) > 25 else [])]

    stage.link.spoil = spoil


def twin(stage: Stage) -> None:
    """Let a second sensor have the first one's number: that of a bench of its own, which roams on another path."""
    motion = Roaming(stage.seed + 1000, LOW_M, HIGH_M, SPEED_M_S, RATE_RAD_S)
    second = Rig(replace(stage.scenario, motion=motion, seed=stage.seed + 1000), stage.boards)
    stage.notes["second"] = second
    second.advance(stage.rig.now_s)
    second.can_read()
    node = stage.scenario.sensor.node

    def spoil(frames: Any) -> Any:
        second.advance(max(stage.rig.now_s - second.now_s, 0.0))
        others = [frame for frame in second.can_read() if frame.identifier & 0xFFF == node]
        return sorted([*frames, *others], key=lambda frame: frame.time_s)

    stage.link.spoil = spoil


def twin_gone(stage: Stage) -> None:
    """Take the second sensor away."""
    quiet(stage)
    stage.notes["second"].close()


def paused(stage: Stage) -> None:
    """Let the host sleep as long as the fault lasts: the boards go on, and what the link keeps comes in one piece."""
    stage.rig.advance(stage.kind.lasts_s)


BABBLE_FIRST, BABBLE_LAST = 0x00000000, 0x1FFFFFFF
LINKS = [
    errors(1e-5),
    errors(1e-3),
    flooded("a node babbles with the first right", BABBLE_FIRST),
    flooded("a node babbles with the last right", BABBLE_LAST),
    Kind("CAN", "the sensor's frames come again", again, quiet),
    Kind("CAN", "a second sensor of one number", twin, twin_gone),
    Kind("CAN", "the host sleeps", paused),
    Kind("serial", "the host sleeps", paused, serial=True),
    *(
        spoilt(name, spoil, serial=serial)
        for serial in (False, True)
        for name, spoil in (
            ("a tenth is lost", lambda random: links.thinned(0.1, random)),
            ("half is lost", lambda random: links.thinned(0.5, random)),
            ("nothing comes", lambda random: links.silent),
            ("everything comes twice", lambda random: links.doubled),
        )
    ),
    spoilt("a bit of each hundredth byte flips", lambda random: links.flipped(0.01, random), serial=True),
    spoilt("a bit of each tenth byte flips", lambda random: links.flipped(0.1, random), serial=True),
    spoilt("noise between the frames", lambda random: links.noisy(50, random), serial=True),
]
