"""What goes wrong in the course of a day, when, and which counters of the boards that explains."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, fields

import numpy as np

from goldfield_protocol import decode
from goldfield_protocol.messages import TYPE_SHIFT, database
from goldfield_protocol.table import counter_name
from hil_sim.rig import Frame
from hil_sim.scenario import Scenario
from hil_sim.world.metal import Body
from tests.campaign.carried import Carried
from tests.campaign.kinds import KINDS
from tests.campaign.stage import Kind

GAP_S = (100.0, 300.0)
"""Least and longest time from the mending of a fault to the next one."""
AFTER_S = 30.0
"""What happens so soon behind the mending is the fault's: a history of ten seconds forgets in three times that."""
CALM_S = 3 * 3600.0
"""In each second spell of this length no board loses its power, so that times of 32 bits wrap on all of them."""
UNMENDED = ("moved", "sheet of", "two sync masters", "a second sensor", "the host is killed")
"""Beginnings of kinds that leave something behind, or take a bench or a host of their own."""
ALL_ANEW = ("all die", "all are reset")
"""Kinds behind which cycles are numbered from 0 again."""
UNCOVERED = ("axes rotated", "two axes swapped", "impulses", "mains 4 uT", "iron ball of 0.24 m is carried past")
"""Kinds against which no protection level holds (tests/campaign/README.md): their poses are told, not counted."""
POWER = ("die", "dead", "is reset", "comes back", "has no power", "a time of its own", "half the amplitude")
"""Parts of the names of kinds that take the power of boards."""


def is_of(kind: Kind, words: tuple[str, ...]) -> bool:
    """Return whether a kind's name, or that of one of a pair, begins with one of these."""
    return any(part.startswith(word) for part in kind.name.split(" + ") for word in words)


def takes_power(kind: Kind) -> bool:
    """Return whether a kind takes the power of a board."""
    return any(word in kind.name for word in POWER)


def possible() -> list[Kind]:
    """Return the kinds that host boards can have, that a host on CAN meets, and that are mended again."""
    return [
        kind for kind in KINDS if not (kind.serial or kind.emulated or kind.group == "none" or is_of(kind, UNMENDED))
    ]


@dataclass(frozen=True)
class Struck:
    """A fault of the day: a kind, and from when to when it lasts, s."""

    kind: Kind
    begin_s: float
    until_s: float

    def explains(self, from_s: float, to_s: float) -> bool:
        """Return whether what happened between two times may be due to it."""
        return from_s <= self.until_s + AFTER_S and to_s >= self.begin_s


def plan(
    begin_s: float, seconds: float, wrapped_s: float, random: np.random.Generator, gap_s: tuple[float, float] = GAP_S
) -> list[Struck]:
    """Return the faults of a day, one behind the other: every kind comes before any comes again.

    Cycles are numbered from 0 again only behind ``wrapped_s``.
    """
    struck: list[Struck] = []
    deck: list[Kind] = []
    now_s = begin_s + float(random.uniform(*gap_s))
    while True:
        calm = now_s % (2 * CALM_S) >= CALM_S
        anew = () if now_s > wrapped_s else ALL_ANEW
        fitting = [kind for kind in deck if not (is_of(kind, anew) or (calm and takes_power(kind)))]
        if not fitting:
            kinds = possible()
            deck += [kinds[number] for number in random.permutation(len(kinds))]
            continue
        kind = fitting[0]
        deck.remove(kind)
        if now_s + kind.lasts_s + AFTER_S > begin_s + seconds:
            return struck
        struck.append(Struck(kind, now_s, now_s + kind.lasts_s))
        now_s += kind.lasts_s + float(random.uniform(*gap_s))


def with_what_comes(scenario: Scenario, struck: list[Struck], random: np.random.Generator) -> Scenario:
    """Return the scenario in which what passes by itself does so."""
    magnets, events = list(scenario.magnets), list(scenario.events)
    carried: list[tuple[float, Body | None]] = []
    for one in struck:
        if one.kind.plan is not None:
            planned = one.kind.plan(scenario, one.begin_s, one.until_s, random)
            magnets += planned.magnets
            events += planned.events
            carried += planned.carried if isinstance(planned, Carried) else []
    ours = {field.name: getattr(scenario, field.name) for field in fields(Scenario)}
    return Carried(**{**ours, "magnets": tuple(magnets), "events": tuple(events), "carried": tuple(carried)})


# ---- Counters ----


COUNTER_TYPE, RESET_TYPE, HEALTH_TYPE = (
    database().get_message_by_name(name).frame_id >> TYPE_SHIFT for name in ("COUNTER", "RESET_REPORT", "DRIVE_HEALTH")
)
POWER_ON = 0
"""The cause of a start, of RESET_REPORT, that a power cycle makes."""
NO_BUS = (
    "bit errors",
    "40 frames in a row",
    "a node babbles",
    "a beacon loses",
    "the sync master loses",
    "the sensor loses",
)
"""Kinds by which boards cannot send what they have to."""
TWO_TIMES = ("the sync master", "the master dies", "all die", "all are reset", "a beacon has a time of its own")
"""Kinds behind which two may lead for a moment, or who leads has a time that the others do not have yet."""
EXPLAINED: dict[str, tuple[str, ...]] = {
    "CAN errors": ("bit errors", "40 frames in a row"),
    "CAN receive overruns": ("a node babbles",),
    "epochs dropped": NO_BUS,
    "foreign frames": ("a node babbles",),
    "messages lost in a full queue": NO_BUS,
    "open coil": (
        *("coil_open", "coil_shorted", "bridge_swapped", "comes back with its bridge", "driver", "sense_held"),
        *("sense_shorted", "supply falls"),
    ),
    "over-current": ("coil_shorted", "driver_runaway", "driver_stuck", "sense_held", "sense_shorted"),
    "SYNC of another master": ("a stranger numbers", *TWO_TIMES),
    "sync edges rejected": (
        *("50 glitches", "3 glitches", "a foreign sync", "a sync slides", "a sync of 7.3", "sensor comes back 400 ppm"),
        *TWO_TIMES,
    ),
}
"""Beginnings of the kinds that make a counter of the boards count. What is not here must stay 0."""


@dataclass
class Ledger:
    """What the boards counted, and behind which fault.

    Attributes
    ----------
    counts : dict of (int, str) to Counter
        By node and counter, how often behind a fault of which name; "" is none.
    starts : dict of int to Counter
        By node, how often it started for which cause of RESET_REPORT.
    """

    counts: dict[tuple[int, str], Counter[str]] = field(default_factory=dict)
    starts: dict[int, Counter[int]] = field(default_factory=dict)
    _latest: dict[tuple[int, str], int] = field(default_factory=dict)

    def take(self, frames: list[Frame], kind: Kind | None) -> None:
        """Take what came on the bus, which a fault of this kind may explain."""
        for frame in frames:
            if frame.identifier >> TYPE_SHIFT not in (COUNTER_TYPE, RESET_TYPE):
                continue
            message = decode(frame.identifier, frame.data)
            if message is not None and message.name == "COUNTER":
                self._count(message.node, counter_name(message.index), int(message.signals["value"]), kind)
            elif message is not None and message.index == 0:
                self.starts.setdefault(message.node, Counter())[int(message.signals["cause"])] += 1
                self._latest = {key: value for key, value in self._latest.items() if key[0] != message.node}

    def _count(self, node: int, name: str, value: int, kind: Kind | None) -> None:
        before = self._latest.get((node, name), 0)
        self._latest[node, name] = value
        more = value - before if value >= before else value
        if more:
            self.counts.setdefault((node, name), Counter())["" if kind is None else kind.name] += more

    def unexplained(self) -> list[str]:
        """Return what no fault explains: counts of a kind that does not make them, and starts without a power cycle."""
        found = [
            f"node {node} counts {number} {name} behind {kind or 'no fault'}"
            for (node, name), kinds in sorted(self.counts.items())
            for kind, number in kinds.items()
            if not any(part.startswith(EXPLAINED.get(name, ())) for part in kind.split(" + "))
        ]
        return found + [
            f"node {node} started {number} times for the cause {cause}"
            for node, causes in sorted(self.starts.items())
            for cause, number in causes.items()
            if cause != POWER_ON
        ]
