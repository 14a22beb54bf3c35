"""What is known of a beacon, in one word, by which pictures colour it."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

STRENGTH_OFF = 0.05
"""A beacon's field may differ so much from the expected one before it is called off; the live page has the same."""


class BeaconState(StrEnum):
    """What is known of a beacon; the words are those of the live page."""

    UNKNOWN = "no word yet"
    USED = "used"
    STRENGTH_OFF = "strength off"
    LEFT_OUT = "left out"
    NOT_HEARD = "not heard"


def beacon_state(health: Mapping[str, Any] | None) -> BeaconState:
    """Return the state of a beacon.

    Parameters
    ----------
    health : mapping or None
        Its part of the record of a `goldfield.view.monitor.Monitor`; None before there is one.

    Examples
    --------
    >>> beacon_state({"measured_T": 1e-6, "ratio": 0.9, "used": True}).value
    'strength off'
    """
    if health is None:
        return BeaconState.UNKNOWN
    if health["measured_T"] is None:
        return BeaconState.NOT_HEARD
    if not health["used"]:
        return BeaconState.LEFT_OUT
    ratio = health["ratio"]
    return BeaconState.STRENGTH_OFF if ratio is not None and abs(ratio - 1.0) > STRENGTH_OFF else BeaconState.USED
