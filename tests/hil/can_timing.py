"""What tests and figures of timing over CAN share: a busy bus, and chip edges by a perfect clock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield_protocol import decode
from hil_sim.bench import SimulatedBench
from hil_sim.rig import SENSOR, Rig
from hil_sim.scenario import Clock

FloatArray = NDArray[np.float64]

BRIDGE = (29, 30)
"""PB13, PB14."""
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
        self._frame_s = 135 / rig.scenario.links.can_bit_s
        self._start = rig.can_statistics()["busy_ps"], rig.now_s

    def advance(self, seconds: float, step_s: float = 0.001) -> None:
        """Run on under load."""
        for _ in range(round(seconds / step_s)):
            self._owed_s += step_s * self._load
            burst = self._random.integers(1, 9)
            if self._owed_s > burst * self._frame_s:
                for _ in range(burst):
                    self._send()
                    self._owed_s -= self._frame_s
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


def beacon_phases(bench: SimulatedBench) -> list[FloatArray]:
    """Seconds by which each chip edge of each follower is later than the first beacon's, the master's, chips.

    Takes all pin changes since `Rig.watch_pins` or the last call; they must span less than the crystals' wander.
    """
    fit: FloatArray | None = None
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


def sensor_phases(bench: SimulatedBench, bus: LoadedBus, seconds: float) -> FloatArray:
    """Run on; rows of time s, locked, and chip clock minus sync wire in microseconds, one a cycle of the sensor.

    Connect the wire to the sensor before: it does not follow it, but tells its phase against it.
    """
    rows = []
    end_s = bench.rig.now_s + seconds
    while bench.rig.now_s < end_s:
        bus.advance(0.01)
        for frame in bench.decoder.feed(bench.rig.serial_read()):
            message = decode(frame.identifier, frame.data)
            if message is not None and message.name == "EPOCH_STATUS":
                rows.append((bench.rig.now_s, message.signals["locked"], message.signals["phase"] * 1e-3))
    return np.array(rows).reshape(-1, 3)


def cold_starts(bench: SimulatedBench, bus: LoadedBus, count: int) -> FloatArray:
    """Switch the sensor off and on, each time for a random while and with another crystal within +-100 ppm.

    Returns
    -------
    ndarray, shape (count, 2)
        Seconds from power-on to the report of the first cycle that is synchronous from end to end (infinite: none in
        1.2 s), and the largest error of a chip edge from then on, microseconds.
    """
    bench.rig.fault(SENSOR, "sync_wire_cut", False)
    random = np.random.default_rng(17)
    results = []
    for _ in range(count):
        off_s = random.uniform(0.001, 0.1)
        bench.rig.power_cycle_sensor(off_s, Clock(crystal_ppm=random.uniform(-100.0, 100.0)))
        on_s = bench.rig.now_s + off_s
        told = sensor_phases(bench, bus, off_s + 1.2)
        locked = told[told[:, 1] == 1.0]
        first_s = locked[0, 0] if len(locked) else np.inf
        after = told[told[:, 0] >= first_s]
        good = len(after) > 0 and after[:, 1].all()
        results.append((first_s - on_s if good else np.inf, np.abs(after[:, 2]).max() if good else np.inf))
    return np.array(results)


def starve(bench: SimulatedBench, seconds: float) -> None:
    """Let frames that win against SYNC take the whole bus: as if it were cut, but busy. Some 15 ms too long."""
    statistics = bench.rig.can_statistics
    first, sent = statistics()["frames"], 0
    end_s = bench.rig.now_s + seconds
    while bench.rig.now_s < end_s:
        while sent - (statistics()["frames"] - first) < 120:
            bench.rig.can_write(0x00FFF000 | sent % 0xFFF, bytes(8))
            sent += 1
        bench.rig.advance(0.01)
