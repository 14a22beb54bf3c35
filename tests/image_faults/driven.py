"""A beacon that drives its coil, and a driver that runs away from it: what skipped protection lets happen.

The truth is what flows: the coil carries the driver's amperes as long as the bridge is on, whatever the board says. The
driver makes 6 A more than it shall, 14 A in place of 8 A, from a moment on: more than the board's limit of 12 A, and
less than what the driver's own protection ends (`docs/hardware.md`), so that nothing but the firmware is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_sim.emulator.emulator import Emulator
from tests.firmware.host_rig import MS, PIN_ENABLE, PINS_BRIDGE, US, Board, Coil, beacon, chip_seconds, gold_chips
from tests.image_faults.workload import BEACON_IMAGE, DANGEROUS, NOTHING, SAID, WRONG, Seen, Verdict, told

CODE, AMPLITUDE_A, EXTRA_A, LIMIT_A = 2, 8.0, 6.0, 12.0
PARAMETERS = {"node": 1, "code": CODE, "amplitude": AMPLITUDE_A, "over_current": LIMIT_A, "sync_master": 1}
CHIP = round(chip_seconds(0) * 1e12)
STATED_US = 346.2
"""The latest that `docs/hardware.md` states for a board one of whose own parts has failed beside the fault."""
WATCHED = 15 * MS
"""How long a board is watched behind the fault, and"""
LONGER = 1600 * MS
"""how long one that has said nothing until then: its watchdog strikes within 940 ms."""
WINDOW = 50 * CHIP
FULL_V = 3.3 / 16.0
"""Set-point of one ampere, V."""


@dataclass
class Bridge:
    """The bridge's state while what came out of a board is gone through."""

    enabled: bool = False
    positive: bool = False
    negative: bool = False
    set_point_A: float = 0.0

    def amperes(self, extra_A: float) -> float:
        """Return the current that the driver makes, A."""
        sign = int(self.positive) - int(self.negative)
        return sign * (self.set_point_A + extra_A) if self.enabled else 0.0


def history(board: Board, fault: int, end: int) -> list[tuple[int, int, float]]:
    """Return the current from when to when: (ps, ps, A) without gaps, from power-on to an end."""
    first, second = PINS_BRIDGE[0]
    names = {PIN_ENABLE: "enabled", first: "positive", second: "negative"}
    changes: list[tuple[int, str, Any]] = [(t, names[pin], on) for t, pin, on in board.pins if pin in names]
    changes += [(t, "set_point_A", volts / FULL_V) for t, volts in board.analog[0]]
    changes += [(fault, "", None), (end, "", None)]
    bridge, at, spans = Bridge(), 0, []
    for time, name, value in sorted(changes, key=lambda change: change[0]):
        time = min(time, end)
        if time > at:
            spans.append((at, time, bridge.amperes(EXTRA_A if at >= fault else 0.0)))
            at = time
        if name:
            setattr(bridge, name, value)
    return spans


def above_us(spans: list[tuple[int, int, float]]) -> float:
    """Return for how long the current was above the limit, us."""
    return sum(end - begin for begin, end, amperes in spans if abs(amperes) > LIMIT_A) / US


def chips(spans: list[tuple[int, int, float]], begin: int, end: int) -> NDArray[np.int64] | None:
    """Return the chips that the current makes from one time to another; None: it is none, or not in step with chips.

    The first edge sets the step; all others must lie within 0.3 us of whole chips behind it.
    """
    inside = [(a, np.sign(amperes)) for a, b, amperes in spans if b > begin and a < end]
    edges = [(a, sign) for (a, sign), (_, before) in zip(inside[1:], inside, strict=False) if sign != before]
    if len(edges) < 3 or any(sign == 0 for _, sign in edges):
        return None
    places = np.array([(a - edges[0][0]) / CHIP for a, _ in edges])
    if np.max(np.abs(places - np.round(places))) * CHIP > 0.3 * US:
        return None
    steps = np.diff(np.round(places).astype(int))
    return np.concatenate([np.full(n, sign, dtype=np.int64) for n, (_, sign) in zip(steps, edges, strict=False)])


def is_code(found: NDArray[np.int64] | None) -> bool:
    """Whether these chips are a part of the code."""
    if found is None:
        return False
    code = gold_chips(CODE)
    turned = np.concatenate([code, code[: len(found)]])
    return bool(np.any(np.all(np.lib.stride_tricks.sliding_window_view(turned, len(found)) == found, axis=1)))


@dataclass
class Driven:
    """A beacon that drives, with an upset from ``begin`` on and a fault of its driver from ``fault`` on."""

    name: str
    begin: int
    fault: int
    image: Path = BEACON_IMAGE
    modules: tuple[str, ...] = ("current", "protection", "board")

    def start(self) -> Board:
        """Return the board as it gets its power."""
        coil = Coil(extra_A=EXTRA_A, extra_from=self.fault)
        return beacon(coil, parameters=PARAMETERS, emulated=True, strict=False, stop_at_fault=False)

    def chip(self, bench: Board) -> Emulator:
        """Return the beacon's chip."""
        return bench.emulator

    def observe(self, bench: Board) -> Seen:
        """Run into the fault and beyond, longer if the board says nothing of it."""
        seen: Seen = {}
        for watched in (WATCHED, LONGER):
            end = self.fault + watched
            running = bench.emulator.run(end)
            spans = history(bench, self.fault, end)
            said = told(bench, self.begin if self.begin > 0 else 0)
            window = (self.fault - WINDOW, self.fault)
            levels = [abs(amperes) for a, b, amperes in spans if b > window[0] and a < window[1]]
            seen = {
                **said.as_seen(),
                "running": running,
                "above_us": above_us(spans),
                "drives": any(levels),
                "code": is_code(chips(spans, *window)),
                "level_A": float(np.median(levels)) if levels else 0.0,
                "off": not bench.level.get(PIN_ENABLE),
                "watched_ms": watched // MS,
            }
            if seen["above_us"] > STATED_US or said.causes or not running:
                break
        return seen

    def judge(self, seen: Seen, sound: Seen) -> Verdict:
        """Judge by the current first, then by what was said of it, then by the field that it made before the fault."""
        if seen["above_us"] > STATED_US:
            return Verdict(DANGEROUS, f"{seen['above_us']:.1f} us above the limit")
        late = seen["above_us"] > CHIP / US
        causes = seen["causes"]
        again = seen["resets"] > sound["resets"] or seen["crashed"]
        if not seen["running"]:
            return Verdict(SAID, "the processor locks up")
        if late and (causes or again):
            return Verdict(SAID, f"off after {seen['above_us']:.1f} us")
        if again:
            return Verdict(SAID, "crash" if seen["crashed"] else "reset")
        if causes and causes != sound["causes"]:
            return Verdict(SAID, f"cause {causes[0]}")
        same = abs(seen["level_A"] - AMPLITUDE_A) < 0.02 * AMPLITUDE_A and seen["code"] and seen["drives"]
        if not causes and seen["messages"] == 0:
            return Verdict(SAID, "silence")
        if not seen["drives"] and causes:
            return Verdict(SAID, f"off before the fault: cause {causes[0]}")
        if not same and not self._says_so(seen):
            what = "no drive" if not seen["drives"] else "another code" if not seen["code"] else "another current"
            return Verdict(WRONG, f"{what}: {seen['level_A']:.2f} A")
        if not causes:
            if seen["above_us"] == 0.0 and not same:
                return Verdict(SAID, f"state {seen['state']}")
            return Verdict(WRONG, "no cause is told")
        return Verdict(NOTHING)

    def _says_so(self, seen: Seen) -> bool:
        """Whether the board says that it does not drive as it shall."""
        return seen["headroom_lost"] or seen["state"] not in ("", "running")


def driven() -> list[Driven]:
    """Return the workloads of the drive.

    ``look``: the upset strikes in the looks that meet the fault, which begins before the look behind the edge, amid
    the chip or at its end; ``before``: up to 20 ms before the fault, in which three blocks are planned; ``start``:
    anywhere between power-on and the fault.
    """
    warm, phase = 450 * MS, CHIP // 3
    looks = [Driven(f"look{i}", warm + i * phase, warm + i * phase) for i in range(3)]
    return [*looks, Driven("before", warm, warm + 20 * MS + phase), Driven("start", 0, warm)]
