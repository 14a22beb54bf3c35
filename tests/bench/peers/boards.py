"""How fast rigs of host boards are, the firmware compiled for this machine, in virtual seconds a second."""

from __future__ import annotations

from tests.bench.peers.bench import Bench
from tests.bench.peers.rig import row_of
from tests.bench.peers.row import Goal, Row

SUBJECT = "boards"
BEACONS = ((8, 0.4, None), (99, 0.2, None), (999, 0.04, Goal("ours", at_least=1.0)))
"""Beacons beside the sensor, virtual seconds that are measured, and the goal."""


def rows(_: Bench) -> list[Row]:
    """Return the rows of the subject."""
    return [row_of(SUBJECT, "host", *one) for one in BEACONS]
