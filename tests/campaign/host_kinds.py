"""Kinds of faults of the host itself: it is killed and started again, or nobody takes its poses in time."""

from __future__ import annotations

from tests.campaign.stage import Killed, Kind, Stage

TAKES_S = 0.25
"""A slow consumer takes so long for each pose, two and a half cycles."""


def killed(stage: Stage) -> None:
    """End the host as a signal does: nothing of it is left, and a new one starts when the fault is mended."""
    stage.rig.advance(stage.kind.lasts_s)
    raise Killed


def slow(stage: Stage) -> None:
    """Let whoever takes the poses be slower than they come."""
    stage.takes_s = TAKES_S


def fast(stage: Stage) -> None:
    """Let them be taken as they come."""
    stage.takes_s = 0.0


HOST = [
    kind
    for serial in (False, True)
    for kind in (
        Kind("serial" if serial else "CAN", "the host is killed and started again", killed, serial=serial, lasts_s=1.0),
        Kind("serial" if serial else "CAN", "who takes the poses is slow", slow, fast, serial=serial),
    )
]
