"""A building of a thousand host-board beacons, and a sensor that walks through it: poses, hand-over, and what it costs.

    python -m tests.bench.building_figures                       1,000 beacons, 200 m at 1 m/s (an hour or so)
    python -m tests.bench.building_figures --beacons 100 --metres 10

The beacons hang at a ceiling, 4.5 m from each other; the sensor has a noise of .2 mG and reports the codes that it
hears best. Sync master and sensor are on the CAN bus, the other beacons on the sync wire alone: a bus carries neither
a thousand nodes nor what they tell. With --bus all of them are on it all the same, and it is never idle. Everything is
of this process: boards, world, link and host; seconds of its processors stand beside those of the wall, as other
programs may take the machine.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from goldfield import site as sites
from goldfield.planning.code_plan import usable_codes
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.options import Options
from goldfield.sensor.pipeline import Sensor
from goldfield.types import FloatArray, Pose, Status
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario, site_toml
from tests.command import real_number, whole_number
from tests.hil.rig_link import RigSerialLink

SPACING_M, CEILING_M = 4.5, 2.7
STRONGEST = 16
BOOTED_S = 2.5
SENSOR_HEIGHT_M, SPEED_M_S = 1.2, 1.0
NINETY_NINE = 11.345
"""What chi square of three degrees of freedom exceeds in one of 100 cases."""


def building(beacons: int, metres: float, height_m: float, seed: int = 1) -> str:
    """Return the text of a scenario: beacons on a lattice, balanced codes first, a sensor that walks among them."""
    text = (ROOT / "hil_sim/scenarios/prigge8.toml").read_text(encoding="utf-8")
    text = text[: text.index("[[beacon]]")].replace('name = "prigge8"', 'name = "building"')
    text = text.replace("noise_T = 2.0e-7", "noise_T = 2.0e-8").replace("pose = 1 ", "pose = 0 ")
    # A sensor in a building is not taken to the first beacon's place to be calibrated: its axes are known as told.
    columns = int(np.ceil(np.sqrt(1.6 * beacons)))
    rows = int(np.ceil(beacons / columns))
    half_space = f"half_space = {{ point = [0.0, 0.0, {height_m}], normal = [0.0, 0.0, -1.0] }}\n"
    text = text.replace("seed = 1\n", f"seed = {seed}\n" + half_space, 1)
    text = text[: text.index("[motion]")] + walk(metres, columns, rows) + text[text.index("[coil]") :]
    codes = usable_codes(10)[0]
    for i in range(beacons):
        x, y = SPACING_M * (i % columns), SPACING_M * (i // columns)
        text += f'[[beacon]]\nid = "b{i + 1}"\nnode = {i + 1 + (i >= 99)}\nposition_m = [{x}, {y}, {height_m}]\n'
        text += f"code = {codes[i]}\ncrystal_ppm = {(i * 37) % 101 - 50}.0\n"
        text += "sync_master = true\n" if i == 0 else ""
    return text


def walk(metres: float, columns: int, rows: int) -> str:
    """Return the motion: to and fro between the middle of the lattice's rows, at a walking pace, turning a little."""
    width, depth = SPACING_M * (columns - 1), SPACING_M * (rows - 1)
    corners, left = [np.array([0.1 * width, 0.3 * depth])], metres
    forth = True
    while left > 0.0:
        step = np.array([0.8 * width, 0.0]) if forth else np.array([-0.8 * width, 0.0])
        for leg in (step, np.array([0.0, 0.15 * depth])):
            length = float(np.linalg.norm(leg))
            taken = min(left, length)
            if taken > 0.0:
                corners.append(corners[-1] + leg * taken / length)
                left -= taken
        forth = not forth
    times = BOOTED_S + np.cumsum([0.0, *(float(np.linalg.norm(b - a)) / SPEED_M_S for a, b in pairwise(corners))])
    places = [[round(float(x), 6), round(float(y), 6), SENSOR_HEIGHT_M] for x, y in corners]
    turns = [[0.2, -0.1, round(0.4 * i, 6)] for i in range(len(corners))]
    return (
        '[motion]\nkind = "waypoints"\n'
        f"times_s = {[0.0, *times.tolist(), float(times[-1]) + 1.0]}\n"
        f"positions_m = {[places[0], *places, places[-1]]}\n"
        f"rotation_vectors_rad = {[turns[0], *turns, turns[-1]]}\n\n"
    )


@dataclass
class Walked:
    """What came of a walk.

    Attributes
    ----------
    poses : list of (Pose, set of str)
        Each with the beacons whose fields it was made of.
    truth : dict
        True positions by the cycle.
    virtual_s, wall_s, processor_s : float
        While the sensor walked.
    """

    poses: list[tuple[Pose, frozenset[str]]] = field(default_factory=list)
    truth: dict[int, FloatArray] = field(default_factory=dict)
    virtual_s: float = 0.0
    wall_s: float = 0.0
    processor_s: float = 0.0


def walked(given: argparse.Namespace, directory: Path) -> tuple[Walked, float]:
    """Return what came of a walk, and what the boards took to start for a virtual second, s of the processors."""
    beacons, metres = given.beacons, given.metres
    scenario_path, site_path = directory / "building.toml", directory / "site.toml"
    scenario_path.write_text(building(beacons, metres, given.height, given.seed), encoding="utf-8")
    scenario = load_scenario(str(scenario_path))
    site_path.write_text(site_toml(scenario), encoding="utf-8")
    rig = Rig(scenario, "host")
    for board in range(2, 1 if given.bus else 1 + beacons):
        rig.fault(board, "can_cut")
    begin = time.process_time()
    rig.advance(BOOTED_S)
    boot_s = (time.process_time() - begin) / BOOTED_S
    link = RigSerialLink(rig)
    sessions.time = dialogues.time = link  # type: ignore[assignment]
    found = Walked()
    with Sensor(link, "building", sites.load(site_path), Options(strongest=STRONGEST)) as sensor:
        begin_s, wall_s, processor_s = rig.now_s, time.perf_counter(), time.process_time()
        for epoch in sensor.epochs():
            found.poses.append((epoch.pose, frozenset(epoch.fields.beacons if epoch.fields else ())))
            for one in rig.truth():
                found.truth[one.cycle] = one.position_m
            if rig.now_s > BOOTED_S + metres / SPEED_M_S:
                break
        found.virtual_s = rig.now_s - begin_s
        found.wall_s, found.processor_s = time.perf_counter() - wall_s, time.process_time() - processor_s
    rig.close()
    return found, boot_s


def refused(found: Walked) -> dict[tuple[str, str], list[int]]:
    """Return the epochs, counted from the first pose, whose poses are not ``ok``, by status and reason."""
    epochs: dict[tuple[str, str], list[int]] = {}
    for number, (pose, _) in enumerate(found.poses):
        if pose.status is not Status.OK:
            epochs.setdefault((str(pose.status), pose.reason), []).append(number)
    return epochs


def show(found: Walked, boot_s: float, height_m: float) -> None:
    """Print the figures."""
    status = Counter(str(pose.status) for pose, _ in found.poses)
    total = len(found.poses)
    used = [
        (pose, names) for pose, names in found.poses if pose.epoch in found.truth and np.isfinite(pose.position_m).all()
    ]
    off = np.array([pose.position_m - found.truth[pose.epoch] for pose, _ in used])
    error = 1e3 * np.linalg.norm(off, axis=1)
    bound = 1e3 * np.array([np.sqrt(np.trace(pose.position_cov_m2)) for pose, _ in used])
    ratio = np.array([d @ np.linalg.solve(pose.position_cov_m2, d) for d, (pose, _) in zip(off, used, strict=True)])
    steps = [len(b - a) for (_, a), (_, b) in pairwise(found.poses)]
    gaps = sum(max(0, b.epoch - a.epoch - 1) for (a, _), (b, _) in pairwise(found.poses))
    everyone = len({name for _, names in found.poses for name in names})
    alarms = sum(1 for pose, _ in found.poses if pose.findings)
    print(f"ceiling at {height_m} m: {total} epochs, {gaps} missing: {dict(status)}; a beacon is blamed in {alarms}")
    for (told, reason), epochs in refused(found).items():
        print(f"        {told} at {', '.join(map(str, epochs))}: {reason}")
    print(
        f"error: median {np.median(error):.1f} mm, 95 % {np.quantile(error, 0.95):.1f} mm, worst {error.max():.1f} mm"
    )
    print(f"stated: median {np.median(bound):.1f} mm; rms of error over stated {np.sqrt(np.mean(ratio / 3)):.2f}")
    print(f"beyond the 99 % region: {100 * np.mean(ratio > NINETY_NINE):.1f} % of the poses")
    most = max(steps, default=0)
    print(f"hand-over: {everyone} beacons in turn, {sum(steps)} came, {most} at most from one epoch to the next")
    print(f"        at least {min(len(names) for _, names in found.poses)} fields in an epoch")
    print(
        f"cost: {found.virtual_s:.1f} s of the building in {found.wall_s:.1f} s and {found.processor_s:.1f} s of "
        f"processors: {found.virtual_s / found.wall_s:.3f} of real time here, "
        f"{2.0 * found.virtual_s / found.processor_s:.3f} on two that do nothing else"
    )
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"        start-up {boot_s:.1f} s of processors for a second; {memory:.0f} MB at most")


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--beacons", type=whole_number(1), default=1000)
    parser.add_argument("--metres", type=real_number(1.0), default=200.0, help="how far the sensor walks (default 200)")
    parser.add_argument("--height", type=real_number(0.5), default=CEILING_M, help="of the ceiling, m (default 2.7)")
    parser.add_argument("--seed", type=whole_number(), default=1, help="of the noise (default 1)")
    parser.add_argument("--bus", action="store_true", help="all beacons are on the CAN bus")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        found, boot_s = walked(arguments, Path(directory))
        show(found, boot_s, arguments.height)


if __name__ == "__main__":
    main()
