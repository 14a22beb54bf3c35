"""The board that leads the time is killed at seeded moments: how soon a deputy leads, who steps, and what poses do.

    .venv/bin/python -m tests.bench.takeover_figures --kills 50
    .venv/bin/python -m tests.bench.takeover_figures --kills 50 --sync can
    .venv/bin/python -m tests.bench.takeover_figures --kills 3 --boards emulated
    .venv/bin/python -m tests.bench.takeover_figures --kills 50 --control      another beacon dies: what its coil costs

The room is that of ``prigge8``: beacon b1 is the sync master, b2 to b5 are its deputies. After each death the dead
board gets its power back and follows; the next to die is whoever leads then. Poses are those that `goldfield run` makes
of the sensor's serial line, where no board tells that it is gone: each cycle by itself, with the history of the
residuals beside it.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from goldfield.link.reports import Report
from goldfield.sensor.location import location
from goldfield.sensor.options import Method
from goldfield.sensor.separation import Separation
from goldfield.types import Pose
from goldfield_protocol import decode
from hil_sim.bench import SimulatedBench
from hil_sim.scenario import SCENARIOS
from tests.command import whole_number

FloatArray = NDArray[np.float64]

BRIDGE = (29, 30)
"""PB13, PB14."""
CHIP_S = 16422 / 168e6
DEPUTIES = 4
FIRST_CYCLES = 10
"""Cycles of the first second."""
BEFORE_S, AFTER_S, BACK_S = 0.5, 3.0, 2.5
"""What is looked at before a death and after it, and the time that a board has to come back."""


@dataclass
class Death:
    """What one death did.

    Attributes
    ----------
    killed_s : float
        When.
    told_s, edge_s : float
        From then to the first `SYNC` of the next leader, and to its first edge of the wire.
    step_us, away_us : float
        Largest change from one chip edge of a living beacon to its next against the dead leader's time line, and
        largest distance from that line within a second.
    lost, unlocked : int
        Cycles that did not come, and that came without a lock, of the sensor.
    cycle : int
        The cycle that ran then, whose chips hold the dead coil in part.
    died, first, later : Counter of str
        Poses by status: of that cycle, of the rest of the first second, and of the two after it.
    """

    killed_s: float
    told_s: float
    edge_s: float
    step_us: float
    away_us: float
    lost: int
    unlocked: int
    cycle: int
    died: Counter[str] = field(default_factory=Counter)
    first: Counter[str] = field(default_factory=Counter)
    later: Counter[str] = field(default_factory=Counter)


def scenario(directory: Path, sync: str) -> Path:
    """Write the room with its deputies."""
    head, *beacons = (SCENARIOS / "prigge8.toml").read_text().split("[[beacon]]")
    for number in range(1, 1 + DEPUTIES):
        beacons[number] = beacons[number].replace("\nnode", f"\nsync_rank = {number + 1}\nnode", 1)
    path = directory / "deputies.toml"
    path.write_text("[[beacon]]".join([f'sync = "{sync}"\n{head}', *beacons]))
    return path


def edges_of(bench: SimulatedBench, board: int) -> FloatArray:
    """Take the times at which a beacon's coil changed its sign since the last call, s."""
    changes = bench.rig.pin_changes(board)
    return np.unique(changes["time_ps"][np.isin(changes["pin"], BRIDGE)]) * 1e-12


def syncs(bench: SimulatedBench) -> list[tuple[float, int, int]]:
    """Take times, nodes and cycles of the SYNCs on the bus since the last call."""
    frames = [(frame.time_s, decode(frame.identifier, frame.data)) for frame in bench.rig.can_read()]
    return [(time_s, m.node, int(m.signals["cycle"])) for time_s, m in frames if m is not None and m.name == "SYNC"]


def kill(bench: SimulatedBench, board: int, leader: int) -> tuple[Death, list[Report], list[Report]]:
    """Let a board lose its power, and look on; return the cycles before and after it, too."""
    beacons = range(1, 1 + len(bench.scenario.beacons))
    bench.rig.watch_pins()
    earlier = bench.advance(BEFORE_S)
    before = {number: edges_of(bench, number) for number in beacons}
    synced_s, _, cycle = syncs(bench)[-1]
    killed_s = bench.rig.now_s
    bench.rig.power_cycle(board, 1000.0)
    reports = bench.advance(AFTER_S)
    told = [time_s - killed_s for time_s, node, _ in syncs(bench) if time_s > killed_s and node != leader]
    wire = bench.rig.sync_edges_s() - killed_s
    line = before[leader]
    number = np.concatenate([[0.0], np.cumsum(np.round(np.diff(line) / CHIP_S))])
    chip, start = np.polyfit(number, line, 1)
    steps, away = [0.0], [0.0]
    for other in beacons:
        if other != board:
            times = np.concatenate([before[other][-2000:], edges_of(bench, other)])
            late = times - start - chip * np.round((times - start) / chip)
            steps.append(np.abs(np.diff(late)).max())
            away.append(np.abs(late[times < killed_s + 1.0]).max())
    numbers = [report.cycle for report in reports]
    death = Death(
        killed_s=killed_s,
        told_s=min(told, default=np.nan),
        edge_s=float(wire[wire > 0.0].min(initial=np.inf)),
        step_us=1e6 * max(steps),
        away_us=1e6 * max(away),
        lost=numbers[-1] - numbers[0] + 1 - len(numbers),
        unlocked=sum(not report.locked for report in reports),
        cycle=cycle + int((killed_s - synced_s) / bench.site.cycle_s),
    )
    return death, earlier, reports


def deaths(bench: SimulatedBench, kills: int, control: bool, seed: int) -> Iterator[Death]:
    """Kill the leader again and again."""
    random = np.random.default_rng(seed)
    separation, locate = Separation(bench.site, of_instants=True), location(bench.site, Method.EACH)

    def located(reports: list[Report]) -> list[Pose]:
        return [locate(separation.fields(report), report) for report in reports]

    nodes = {beacon.node: board for board, beacon in enumerate(bench.scenario.beacons, start=1)}
    located(bench.advance(1.0))
    for _ in range(kills):
        located(bench.advance(float(random.uniform(0.0, 0.2))))
        leader = nodes[syncs(bench)[-1][1]]
        board = len(nodes) if control else leader
        death, before, after = kill(bench, board, leader)
        for pose in located([*before, *after])[len(before) :]:
            since = pose.epoch - death.cycle
            part = death.first if since <= FIRST_CYCLES else death.later
            (death.died if since == 0 else part)[pose.status.value] += 1
        yield death
        bench.rig.power_cycle(board, float(random.uniform(0.0, 0.1)))
        located(bench.advance(BACK_S))


def words(found: list[Death], control: bool) -> str:
    """Return what all deaths did, in lines."""
    died, first, later = (
        sum((getattr(death, name) for death in found), Counter()) for name in ("died", "first", "later")
    )
    lines = [f"{len(found)} deaths of {'another beacon' if control else 'the leader'}"]
    if not control:
        told, edge = ([getattr(death, name) for death in found] for name in ("told_s", "edge_s"))
        lines += [
            f"a deputy tells that it leads after {np.median(told):.3f} s at the median, {max(told):.3f} at most",
            f"its first edge comes after {np.median(edge):.3f} s, {max(edge):.3f} at most",
        ]
    lines += [
        f"largest step of a living beacon's chip edge {max(death.step_us for death in found):.3f} us, largest distance "
        f"from the dead leader's time line within a second {max(death.away_us for death in found):.3f} us",
        f"cycles lost {sum(death.lost for death in found)}, not locked {sum(death.unlocked for death in found)}",
        f"poses of the cycle of the death {shown(died)}; of the rest of the first second {shown(first)}; of the two "
        f"seconds after it {shown(later)}",
    ]
    return "\n".join(lines)


def shown(statuses: Counter[str]) -> str:
    """Return counts by status."""
    return ", ".join(f"{count} {status}" for status, count in sorted(statuses.items(), key=lambda item: -item[1]))


def measure(kills: int, sync: str, boards: str, *, control: bool = False, seed: int = 15) -> list[Death]:
    """Return what so many deaths did."""
    with tempfile.TemporaryDirectory() as name:
        bench = SimulatedBench(str(scenario(Path(name), sync)), boards, Path(name))
        try:
            return list(deaths(bench, kills, control, seed))
        finally:
            bench.close()


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=whole_number(1), default=50)
    parser.add_argument("--sync", choices=("wire", "can"), default="wire")
    parser.add_argument("--boards", choices=("host", "emulated"), default="host")
    parser.add_argument("--control", action="store_true", help="kill a beacon that does not lead")
    parser.add_argument("--seed", type=whole_number(), default=15)
    arguments = parser.parse_args()
    found = measure(arguments.kills, arguments.sync, arguments.boards, control=arguments.control, seed=arguments.seed)
    print(f"{arguments.boards} boards by {arguments.sync}, seed {arguments.seed}: {words(found, arguments.control)}")


if __name__ == "__main__":
    main()
