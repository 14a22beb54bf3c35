"""The time of any chip on a sensor's own clock, from the headers of its cycles (`EPOCH`): number and middle of each."""

from __future__ import annotations

from goldfield.link.reports import CYCLE_MODULUS, SHORTEST_SILENCE_S, distance
from goldfield_protocol.messages import Message

LARGEST_DEVIATION = 500e-6
"""Relative deviation of the length of a chip beyond which two headers were not of one run of the clock."""


class CycleClock:
    """Tells which cycle low bits mean, and when a chip of it ended; feed it every message of a sensor as it arrives.

    It knows nothing before the first header, nor from a silence, or a break that `lose` is told of, to the next header:
    the low bits of a cycle's number then say nothing.

    Parameters
    ----------
    chips : int
        Chips in a cycle.
    chip_s : float
        Nominal length of a chip; that on the sensor's clock is measured by its headers.

    Attributes
    ----------
    known : bool
        Whether chips can be told their times.
    runs : int
        Counts the stretches without a break: it changes behind a silence, and where the headers do not go on from those
        before.
    """

    def __init__(self, chips: int, chip_s: float) -> None:
        self.known = False
        self.runs = 0
        self._chips = chips
        self._nominal_s = self._chip_s = chip_s
        self._silence_s = max(SHORTEST_SILENCE_S, 8.0 * chips * chip_s)
        self._arrival_s = float("-inf")
        self._cycle = 0
        self._middle_s = 0.0

    def take(self, message: Message, arrival_s: float) -> bool:
        """Take the next message of the sensor; tells whether it is a header.

        Parameters
        ----------
        message : Message
        arrival_s : float
            Time of arrival, on any clock that does not run backwards.
        """
        if arrival_s - self._arrival_s > self._silence_s:
            self.lose()
            self.runs += 1
        self._arrival_s = arrival_s
        if message.name != "EPOCH":
            return False
        cycle, middle_s = int(message.signals["cycle"]), message.signals["time"]
        ahead = distance(cycle, self._cycle)
        measured_s = (middle_s - self._middle_s) / (ahead * self._chips) if ahead > 0 else 0.0
        if abs(measured_s / self._nominal_s - 1.0) <= LARGEST_DEVIATION:
            self._chip_s = measured_s
        elif (cycle, middle_s) != (self._cycle, self._middle_s):  # else it came twice
            self.runs += 1
            self._chip_s = self._nominal_s
        self._cycle, self._middle_s = cycle, middle_s
        self.known = True
        return True

    def lose(self) -> None:
        """Forget what low bits mean, up to the next header."""
        self.known = False

    def cycle(self, low: int, modulus: int) -> int:
        """Return the number of the cycle with these low bits that is nearest to the one after the latest header's."""
        after = self._cycle + 1
        half = modulus // 2
        return (after + (low - after + half) % modulus - half) % CYCLE_MODULUS

    def time_s(self, cycle: int, chip: int) -> float:
        """Return the time at which a chip of a cycle ended; a chip may lie behind the end of the cycle."""
        chips = distance(cycle, self._cycle) * self._chips + chip + 1 - 0.5 * self._chips
        return self._middle_s + chips * self._chip_s
