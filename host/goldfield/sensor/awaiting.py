"""A sensor that is not there yet is waited for, where the user wants that."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from goldfield.errors import tell
from goldfield.sensor.dialogue import Unheard

T = TypeVar("T")


def until_heard(start: Callable[[], T], *, awaits: bool) -> T:
    """Start to read a sensor, and start again as long as it is not heard or does not answer.

    Each start waits by itself for as long as a silent sensor is given, so that none follows the other at once.

    Parameters
    ----------
    start : callable
    awaits : bool
        Whether the sensor is waited for, without end; else it is started once.

    Raises
    ------
    SystemFailure, UserError
        Those of ``start``; but for `Unheard`, which is told on stderr once, if the sensor is waited for.
    """
    told: set[str] = set()
    while True:
        try:
            return start()
        except Unheard as error:
            if not awaits:
                raise
            if str(error) not in told:
                told.add(str(error))
                tell(f"{error}; waiting for it")
