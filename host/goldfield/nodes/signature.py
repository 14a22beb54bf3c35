"""The signature of a beacon, every other cycle at half its current, as sensors see it in their ``FIELD`` messages."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from goldfield_protocol.messages import Message

LEAST_CYCLES = 6
"""Cycles of a code that are needed, of both kinds together."""
LEAST_SURE = 5.0
"""The difference of odd and even cycles must be so many times its standard error."""
LEAST_AHEAD = 3.0
"""And so many times that of any other code: others take at most 65 of 1023 parts of a beacon's field for their own."""


@dataclass(frozen=True)
class Seen:
    """A code whose field comes and goes.

    Attributes
    ----------
    sensor, code : int
        Node of the sensor, and the code.
    change_T : float
        By how much its field differs from cycle to cycle, T: half the field of the beacon.
    """

    sensor: int
    code: int
    change_T: float


class Watch:
    """Takes all messages of a link while a beacon shows its signature, and tells which code does."""

    def __init__(self) -> None:
        self._fields: dict[tuple[int, int], list[tuple[int, tuple[float, float, float]]]] = defaultdict(list)

    def take(self, message: Message) -> None:
        """Take the next message."""
        if message.name == "FIELD":
            field = (message.signals["x"], message.signals["y"], message.signals["z"])
            self._fields[message.node, message.index].append((int(message.signals["cycle_low"]), field))

    @property
    def sensors(self) -> list[int]:
        """Sensors that reported fields."""
        return sorted({sensor for sensor, _ in self._fields})

    def seen(self) -> list[Seen]:
        """Return for each sensor the code that comes and goes, if one does.

        Correlations hold a little of every other beacon, so that what changes is looked at, and not its share.
        """
        changes: dict[int, list[tuple[float, float, int]]] = defaultdict(list)
        for (sensor, code), cycles in self._fields.items():
            odd = np.array([low % 2 for low, _ in cycles], dtype=bool)
            field = np.array([value for _, value in cycles])
            if len(field) < LEAST_CYCLES or odd.all() or not odd.any():
                continue
            means = field[~odd].mean(axis=0), field[odd].mean(axis=0)
            rest = field - np.where(odd[:, None], means[1], means[0])
            error = 2.0 * float(np.sqrt((rest**2).sum() / (len(field) - 2) / len(field)))
            changes[sensor].append((float(np.linalg.norm(means[0] - means[1])), error, code))
        found = []
        for sensor, of_codes in sorted(changes.items()):
            (change, error, code), *others = sorted(of_codes, reverse=True)
            if change > LEAST_SURE * error and all(change > LEAST_AHEAD * other for other, _, _ in others):
                found.append(Seen(sensor, code, change))
        return found
