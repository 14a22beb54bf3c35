"""How a board has the time, as its message `CLOCK` tells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from goldfield_protocol.messages import Message

SOURCES = {1: "wire", 2: "can", 3: "field", 4: "own"}
NOT_KNOWN_NS = 65535.0
LONGEST_AGE_S = 25.5
HELD_S = 0.5
"""A board that took no edge for so long holds over: two are missing with the longest codes."""


@dataclass(frozen=True)
class ClockQuality:
    """A `CLOCK`.

    Attributes
    ----------
    source : str or None
        What the board's clock follows, ``wire``, ``can`` or ``field``; ``own`` if it leads; None: nothing.
    locked : bool
        Whether it is in step.
    rank : int
        Its rank among those that may lead: 1 the master, 2 to 15 a deputy, 0: it never leads.
    leader : int or None
        The node that it follows, or itself.
    age_s : float
        Time since the latest edge of that source; 25.5 or more.
    rate_ppm : float
        Rate of its oscillator minus the leader's.
    error_s : float or None
        Estimated error of its edges; None: not known, or beyond 65 us.
    """

    source: str | None
    locked: bool
    rank: int
    leader: int | None
    age_s: float
    rate_ppm: float
    error_s: float | None

    @property
    def words(self) -> Iterator[str]:
        """What is worth saying of it beside that a clock is locked or not."""
        if self.rank > 0:
            place = "the sync master" if self.rank == 1 else f"deputy of rank {self.rank}"
            if self.source == "own" and self.rank > 1:
                yield f"leads the time as {place}"
            elif self.source != "own":
                yield place if self.leader is None else f"{place}, follows node {self.leader}"
        error = "not known" if self.error_s is None else f"{1e6 * self.error_s:.2f} us"
        if self.source == "field" and self.age_s < HELD_S:
            yield f"takes the time from the beacons' field: estimated error {error}"
        if self.source not in (None, "own") and self.age_s >= HELD_S:
            beyond = " or more" if self.age_s >= LONGEST_AGE_S else ""
            yield f"holds over without sync for {self.age_s:.1f} s{beyond}: estimated error {error}"


def quality_of(message: Message) -> ClockQuality:
    """Return what a `CLOCK` tells."""
    signals = message.signals
    return ClockQuality(
        source=SOURCES.get(int(signals["source"])),
        locked=bool(signals["locked"]),
        rank=int(signals["rank"]),
        leader=int(signals["leader"]) or None,
        age_s=float(signals["age"]),
        rate_ppm=signals["rate"] * 1e-3,
        error_s=None if signals["error"] >= NOT_KNOWN_NS else signals["error"] * 1e-9,
    )
