"""A day of a bench of host boards, with drift, faults and motion: no leak, no wrong pose, every counter explained.

    make day-run                                            24 h of virtual time
    make day-run DAY="--hours 0.5 --seed 3"                 half an hour
    make day-run DAY="--hours 1 --seed 2 --gap 31 33"       every kind of fault once in an hour

Five beacons of ``prigge8``, of which the first is the sync master and the second its deputy, and a sensor that roams.
Their crystals differ, and drift with a temperature that goes up and down over the day and within hours; the constant
field drifts. Every few minutes a fault of the campaign's kinds strikes and is mended (``day_faults.py``). The host, as
``goldfield run`` has it, reads the sensor on CAN from the first minute to the last; each pose is held to the truth.

A line an hour is printed, and all of the table written, to ``build/day``. The end is 1 if anything is wrong: a pose
that is off by more than it promises, a cycle that is lost, a counter or a start that no fault explains, memory that
grows, a number that should have wrapped and has not.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TextIO
from unittest.mock import patch

import numpy as np

from goldfield import site as sites
from goldfield.errors import SystemFailure, UserError
from goldfield.sensor import dialogue, session
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pipeline import Sensor
from goldfield_protocol import decode, encode
from goldfield_protocol.messages import TYPE_SHIFT
from hil_sim.rig import Frame
from hil_sim.scenario import Scenario, load_scenario, site_toml
from hil_sim.world.roaming import Roaming
from tests.bench.day_faults import GAP_S, HEALTH_TYPE, Ledger, Struck, plan, with_what_comes
from tests.bench.day_judge import CYCLES, Judge, Seen
from tests.bench.day_memory import holdings, objects, resident_bytes, slope
from tests.campaign.links import CanLink
from tests.campaign.stage import CYCLE_S, HIGH_M, LOW_M, RATE_RAD_S, SPEED_M_S, Stage
from tests.command import ended, must_be_a_file, real_number, whole_number
from tests.hil.rig_link import RigLink

BEACONS = (0, 3, 5, 6, 7)
"""Those of ``prigge8`` that there are: no four of them lie in a plane, so that one may be gone."""
RANKS = (1, 2, 0, 0, 0)
"""Their ranks: a master, its deputy, and those that never lead."""
STRANGER = 77
"""Node of the master that was there before, from which the boards take the number of the cycle."""
LEAD_S, PULSE_S = 3.0, 1e-4
"""How long it leads, and the width of its pulses on the sync wire."""
SETTLE_S = 6.0
"""Time in which the master takes over, and what the boards told of the stranger is over."""
LEAD_BEGIN_S, GLITCH_S = 0.1, 4e-5
"""When its first cycle begins, and how long before a pulse the rig must be asked for it."""
WRAP_S = 1800.0
"""The number of the cycle wraps then, or after a quarter of a shorter run."""
WEATHER_S = 10.0
"""Crystals and the constant field go on in steps of this time."""
WARMTH = ((86400.0, 8.0), (5400.0, 2.0))
"""Periods (s) and amplitudes (K) of the boards' temperatures."""
PPM_PER_K = 1.0
"""Largest size of what a crystal's error grows by with temperature."""
EARTH = ((86400.0, 2e-7), (6100.0, 3e-7), (420.0, 1e-7))
"""Periods (s) and amplitudes (T) of the constant field's drift."""
OPERATOR_S, OFF_S = 2.0, 0.5
"""How long behind a fault a board is powered off that five trips in a row have locked out, and for how long."""
DRAIN_S = 1.0
"""Serial lines to which nobody listens are emptied so often."""
BATCH = 64
"""So many poses are held to the truth at a time."""
GROWN_AFTER_H = 3.0
"""From this hour on memory must not grow, "the first hours" being over."""
GROWTH_BYTES_PER_H = 1 << 20
"""Largest growth of the resident memory: 29 bytes a cycle, of which the rig's record of the wire's edges takes 8."""
OBJECTS_PER_H = 500.0
"""Largest growth of the number of Python's objects, and of what the host's containers hold: one in 72 cycles."""
FALSE_ALARMS = 0.005
"""Largest share of the poses outside of faults that say anything."""
MICROSECONDS_32_S = 2**32 * 1e-6


class DayLink(CanLink):
    """The host's adapter, with a look at what was on the bus before it is spoilt."""

    def __init__(self, day: Day) -> None:
        self._day = day
        super().__init__(day.rig, day.tick)

    def _frames(self) -> list[Frame]:
        self._day.tick()
        frames = RigLink._frames(self)  # type: ignore[no-untyped-call]
        self._day.look(frames)
        return list(self.spoil(frames))


@dataclass(frozen=True)
class Hour:
    """What was at the end of an hour: virtual time, resident bytes, Python's objects, elements that the host holds."""

    hours: float
    resident: int
    objects: int
    held: int


def scenario_of(seed: int, random: np.random.Generator) -> Scenario:
    """Return the bench: a master, a deputy and three more beacons, with crystals that are drawn."""
    whole = load_scenario("prigge8", seed)
    beacons = [
        replace(beacon, clock=replace(beacon.clock, crystal_ppm=float(random.uniform(-50.0, 50.0))), sync_rank=rank)
        for beacon, rank in zip((whole.beacons[number] for number in BEACONS), RANKS, strict=True)
    ]
    motion = Roaming(seed, LOW_M, HIGH_M, SPEED_M_S, RATE_RAD_S)
    return replace(whole, name="day", beacons=tuple(beacons), motion=motion)


class Day(Stage):
    """The bench in the course of a day, and what came of it."""

    def __init__(self, hours: float, seed: int, gap_s: tuple[float, float] = GAP_S) -> None:
        random = np.random.default_rng([seed, 24])
        self.end_s = 3600.0 * hours
        wrap_s = min(WRAP_S, 0.25 * self.end_s)
        self.struck = plan(LEAD_S + SETTLE_S, self.end_s, wrap_s + 60.0, random, gap_s)
        scenario = with_what_comes(scenario_of(seed, random), self.struck, random)
        super().__init__(scenario, seed, "host", random)
        boards = 1 + self.beacons
        self._per_K = random.uniform(-PPM_PER_K, PPM_PER_K, boards)
        self._phases = random.uniform(0.0, 2.0 * np.pi, (boards, len(WARMTH)))
        self._turns = random.uniform(0.0, 2.0 * np.pi, (3, len(EARTH)))
        self._earth_T = scenario.ambient.earth_T
        self._ppm = np.zeros(boards)
        self._now: Struck | None = None
        self.ledger, self.judge = Ledger(), Judge(scenario.motion)
        self.hours: list[Hour] = []
        self.running_s = np.zeros(boards)
        self.restarted: list[int] = []
        self._locked_out: set[int] = set()
        self._first_cycle = CYCLES - round(wrap_s / CYCLE_S)
        for one in self.struck:
            self._await(one)
        self.at(LEAD_S + SETTLE_S, lambda _: self._weather())
        self.at(DRAIN_S, lambda _: self._drain())

    # ---- What happens ----

    def lead(self) -> None:
        """Let a stranger lead the time for a moment, so that the boards go on with its numbers."""
        for number in range(round(LEAD_S / CYCLE_S)):
            begin_s = LEAD_BEGIN_S + number * CYCLE_S
            self.rig.glitch(PULSE_S, begin_s - GLITCH_S - self.rig.now_s)
            signals = {"cycle": self._first_cycle + number, "chips": 1023, "chip_period": 97.75, "rank": 1}
            self.rig.run_until(round((begin_s + 0.01) * 1e12))
            self.rig.can_write(*encode("SYNC", signals, node=STRANGER, index=0))
        self.rig.advance(SETTLE_S)

    def _await(self, one: Struck) -> None:
        self.at(one.begin_s, lambda _: self._begin(one))
        self.at(one.until_s, lambda _: one.kind.end(self))

    def _begin(self, one: Struck) -> None:
        self._now, self.kind, self.notes = one, one.kind, {}
        one.kind.begin(self)

    def _weather(self) -> None:
        """Let temperatures and the constant field go on; while a fault may have changed that field it stays."""
        now_s = self.rig.now_s
        self.at(now_s + WEATHER_S, lambda _: self._weather())
        if self._now is not None and now_s < self._now.until_s + 1.0:
            return
        degrees = sum(
            size * np.sin(2.0 * np.pi * now_s / period + self._phases[:, i]) for i, (period, size) in enumerate(WARMTH)
        )
        ppm = self._per_K * degrees
        for board, by_ppm in enumerate(ppm - self._ppm):
            self.rig.drift(board, float(by_ppm))
        self._ppm = ppm
        drift_T = sum(
            size * np.sin(2.0 * np.pi * now_s / period + self._turns[:, i]) for i, (period, size) in enumerate(EARTH)
        )
        ambient = replace(self.scenario.ambient, earth_T=self._earth_T + drift_T)
        self.scenario = replace(self.scenario, ambient=ambient)
        self.rig.surround(ambient)

    def _drain(self) -> None:
        """Empty the serial lines, and look how long each board runs."""
        self.at(self.rig.now_s + DRAIN_S, lambda _: self._drain())
        for board in range(1 + self.beacons):
            self.rig.serial_read(board)
            self.running_s[board] = max(self.running_s[board], self.rig.now_s - self.rig.power_on_s(board))

    def struck_between(self, from_s: float, to_s: float) -> Struck | None:
        """Return the fault that may explain what happened between two times."""
        return self._now if self._now is not None and self._now.explains(from_s, to_s) else None

    def look(self, frames: list[Frame]) -> None:
        """Look at what was on the bus."""
        if frames:
            struck = self.struck_between(frames[0].time_s, self.rig.now_s)
            self.ledger.take(frames, None if struck is None else struck.kind)
            for frame in frames:
                if frame.identifier >> TYPE_SHIFT == HEALTH_TYPE:
                    self._look_at_drive(frame)

    def _look_at_drive(self, frame: Frame) -> None:
        """Have a board whose drive is locked out, and cleared by nothing else, powered off and on behind the fault."""
        message = decode(frame.identifier, frame.data)
        if message is None or not message.signals["locked_out"] or message.node in self._locked_out:
            return
        board = 1 + [beacon.node for beacon in self.scenario.beacons].index(message.node)
        mended_s = self.rig.now_s if self._now is None else max(self.rig.now_s, self._now.until_s)
        self._locked_out.add(message.node)
        self.at(mended_s + OPERATOR_S, lambda _: self._restart(board, message.node))

    def _restart(self, board: int, node: int) -> None:
        self._locked_out.discard(node)
        self.restarted.append(node)
        self.rig.power_cycle(board, OFF_S)

    # ---- The host ----

    def run(self, out: TextIO | None = None) -> list[str]:
        """Run it, and print a line an hour and write the table; return what is wrong."""
        began, ended = time.process_time(), ""
        self.lead()
        self.link = DayLink(self)
        with tempfile.TemporaryDirectory() as name:
            path = Path(name) / "site.toml"
            path.write_text(site_toml(self.scenario))
            options = Options(method=Method.EACH, node=self.scenario.sensor.node)
            with (
                patch.object(session, "time", self.link),
                patch.object(dialogue, "time", self.link),
                Sensor(self.link, "day", sites.load(path), options) as sensor,
            ):
                try:
                    self._watch(sensor, began, out)
                except (UserError, SystemFailure) as error:
                    ended = f"the host ended at {self.rig.now_s:.1f} s: {error}"
        return [ended] * bool(ended) + self.wrong()

    def _watch(self, sensor: Sensor, began: float, out: TextIO | None) -> None:
        """Take the poses of the day; each hour something is said."""
        seen: list[Seen] = []
        before_s, hour_s = self.rig.now_s, 3600.0
        for epoch in sensor.epochs():
            now_s = self.rig.now_s
            seen.append(Seen(now_s, self.link.latest_s, epoch, self.struck_between(before_s, now_s)))
            before_s = now_s
            ends = now_s >= self.end_s
            if len(seen) >= BATCH or ends:
                self.judge.judge(seen, self.rig.cycles())
                seen = []
            if now_s >= hour_s or ends:
                held = holdings(sensor, self, self.rig, self.scenario).total()
                self.hours.append(Hour(now_s / 3600.0, resident_bytes(), objects(), held))
                hour_s += 3600.0
                self.tell(time.process_time() - began, out)
            if ends:
                return
            if self.takes_s:
                self.rig.advance(self.takes_s)

    # ---- What is said ----

    def wraps(self) -> dict[str, int]:
        """Return how often each number wrapped, at the least."""
        boards = {self.rig.board_name(n): int(s // MICROSECONDS_32_S) for n, s in enumerate(self.running_s)}
        longest_s = float(self.running_s.max())
        return {
            "number of the cycle, 20 bits": self.judge.wraps,
            "its low bits in fields and poses, 4 bits": self.judge.cycles // 16,
            "ticks of a board, 32 bits of 168 MHz": int(longest_s * 168e6 // 2**32),
            "ticks within a chip's timer, 16 bits": int(longest_s * 168e6 // 2**16),
            **{f"microseconds of {name}, 32 bits": count for name, count in boards.items()},
        }

    def grown(self) -> dict[str, float]:
        """Return by how much memory grows in an hour, once the first hours are over."""
        late = [one for one in self.hours if one.hours > GROWN_AFTER_H]
        hours = [one.hours for one in late]
        return {name: slope(hours, [getattr(one, name) for one in late]) for name in ("resident", "objects", "held")}

    def wrong(self) -> list[str]:
        """Return what is not as it must be."""
        judge, grown = self.judge, self.grown()
        found = [*judge.wrong, *self.ledger.unexplained()]
        found += [f"{judge.lost['']} cycles lost behind no fault"] if judge.lost[""] else []
        alarms = sum(judge.not_plain.values())
        if alarms > FALSE_ALARMS * judge.sound + 1:
            found.append(f"{alarms} of {judge.sound} poses outside of faults say something: {dict(judge.not_plain)}")
        for name, most in (("resident", GROWTH_BYTES_PER_H), ("objects", OBJECTS_PER_H), ("held", OBJECTS_PER_H)):
            if grown[name] > most:
                found.append(f"{name} grows by {grown[name]:.0f} an hour, more than {most:g}")
        if self.rig.now_s >= 23.9 * 3600.0:
            found += [f"{name}: has not wrapped" for name, count in self.wraps().items() if not count]
        return found

    def tell(self, processor_s: float, out: TextIO | None) -> None:
        """Print the line of an hour, and write the table so far."""
        judge, now = self.judge, self.hours[-1]
        wrong = self.wrong()
        print(
            f"{now.hours:5.2f} h in {processor_s:.0f} s of processor: {judge.cycles} cycles, "
            f"{sum(judge.poses.values())} poses, {len(wrong)} things wrong, {now.resident / 1e6:.1f} MB, "
            f"{now.objects} objects, {now.held} held",
            flush=True,
        )
        if out is not None:
            out.seek(0)
            out.truncate()
            out.write(self.table() + "\n" + "\n".join(f"WRONG: {one}" for one in wrong) + "\n")
            out.flush()

    def table(self) -> str:
        """Return the table."""
        judge, grown = self.judge, self.grown()
        done = sum(one.until_s < self.rig.now_s for one in self.struck)
        lines = [
            f"seed {self.seed}: {self.rig.now_s / 3600.0:.2f} h, {self.beacons} beacons, {done} faults of "
            f"{len({one.kind.name for one in self.struck[:done]})} kinds",
            f"cycles {judge.cycles}, poses {sum(judge.poses.values())}, without a pose {sum(judge.lost.values())}",
            f"poses by status: {shown(judge.poses)}",
            f"off by more than promised: {len(judge.wrong)}; of kinds that no level covers: {shown(judge.beyond)}",
            f"largest error of an ok pose within its level: {1e3 * judge.worst_m:.0f} mm, behind {judge.worst_said}",
            f"outside of faults {judge.sound} poses, of which say something: {shown(judge.not_plain)}",
            f"memory grows by {grown['resident']:.0f} bytes, {grown['objects']:.1f} objects, {grown['held']:.1f} "
            f"elements of the host's an hour, from hour {GROWN_AFTER_H:g} on",
            f"cycles were numbered anew {judge.renumbered} times; wrapped: {shown(self.wraps())}",
            "cycles without a pose, by fault: " + shown(judge.lost),
        ]
        lines += [
            f"node {node} counted {sum(kinds.values())} {name}: {shown(kinds)}"
            for (node, name), kinds in sorted(self.ledger.counts.items())
        ]
        lines += [
            f"node {node} started, by cause: {dict(causes)}" for node, causes in sorted(self.ledger.starts.items())
        ]
        lines += [f"powered off and on, their drives being locked out: {shown(Counter(self.restarted))}"]
        lines += [
            f"hour {one.hours:.2f}: {one.resident} bytes, {one.objects} objects, {one.held} held" for one in self.hours
        ]
        return "\n".join(lines)


def shown(counts: dict[str, int]) -> str:
    """Return counts by name, the largest first."""
    largest_first = sorted(counts.items(), key=lambda one: -one[1])
    return ", ".join(f"{number} {name or 'no fault'}" for name, number in largest_first) or "none"


def main(words: Sequence[str] | None = None) -> int:
    """Run, and say how it went."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=real_number(least=0.01), default=24.0)
    parser.add_argument("--seed", type=whole_number(), default=1)
    parser.add_argument(
        "--gap",
        type=real_number(least=0.0),
        nargs=2,
        default=GAP_S,
        metavar=("LEAST", "MOST"),
        help="seconds from fault to fault",
    )
    parser.add_argument("--out", type=Path, help="where the table is written each hour (default: build/day/SEED.txt)")
    arguments = parser.parse_args(words)
    if arguments.gap[0] > arguments.gap[1]:
        parser.error("--gap: the least is more than the most")
    path = arguments.out or Path(f"build/day/{arguments.seed}.txt")
    must_be_a_file(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    day = Day(arguments.hours, arguments.seed, tuple(arguments.gap))
    with path.open("w", encoding="utf-8") as out:
        wrong = day.run(out)
    print(day.table())
    print("\n".join(f"WRONG: {one}" for one in wrong) or "nothing is wrong")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(ended(main))
