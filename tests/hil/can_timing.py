"""What tests and figures of timing over CAN share: a busy bus, and chip edges by a perfect clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil_sim.pytest_plugin import SimulatedBench
from hil_sim.rig import Rig

BRIDGE = (38, 39)
"""PC6, PC7."""
CHIP_S = 16422 / 168e6


class LoadedBus:
    """A rig whose host adapter sends foreign frames, in bursts of random length, on top of what the boards send.

    Half of them win the bus over everything that the boards send, half lose to it; some have 11-bit identifiers.
    """

    def __init__(self, rig: Rig, load: float = 0.65, seed: int = 3) -> None:
        self.rig = rig
        self._load = load
        self._random = np.random.default_rng(seed)
        self._owed_s = 0.0
        self._start = rig.can_statistics()["busy_ps"], rig.now_s

    def advance(self, seconds: float, step_s: float = 0.001) -> None:
        """Run on under load."""
        for _ in range(round(seconds / step_s)):
            self._owed_s += step_s * self._load
            burst = self._random.integers(1, 9)
            if self._owed_s > burst * 135e-6:
                for _ in range(burst):
                    self._send()
                    self._owed_s -= 135e-6
            self.rig.advance(step_s)

    def _send(self) -> None:
        data = self._random.bytes(8)
        kind = self._random.integers(3)
        if kind == 0:
            self.rig.can_write(int(self._random.integers(1, 0x7FF)), data, extended=False)
        elif kind == 1:
            self.rig.can_write(0x00FFF000 | int(self._random.integers(0xFFF)), data)  # type 0: wins against SYNC
        else:
            self.rig.can_write(0x1FFFF000 | int(self._random.integers(0xFFF)), data)

    def share(self) -> float:
        """Share of the time since the start in which the bus was busy."""
        busy_ps, start_s = self._start
        return float((self.rig.can_statistics()["busy_ps"] - busy_ps) * 1e-12 / (self.rig.now_s - start_s))


def beacon_phases(bench: SimulatedBench) -> list[NDArray[np.float64]]:
    """Seconds by which each chip edge of each follower is later than the first beacon's, the master's, chips.

    Takes all pin changes since `Rig.watch_pins` or the last call; they must span less than the crystals' wander.
    """
    fit: NDArray[np.float64] | None = None
    start = stop = 0.0
    phases = []
    for board in range(1, 1 + len(bench.scenario.beacons)):
        changes = bench.rig.pin_changes(board)
        times = np.unique(changes["time_ps"][np.isin(changes["pin"], BRIDGE)]) * 1e-12
        if fit is None:
            number = np.concatenate([[0.0], np.cumsum(np.round(np.diff(times) / CHIP_S))])
            fit, start, stop = np.polyfit(number, times, 1), times[0], times[-1]
            continue
        inside = times[(times >= start) & (times <= stop)]
        phases.append(inside - np.polyval(fit, np.round((inside - fit[1]) / fit[0])))
    return phases
