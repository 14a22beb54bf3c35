"""How long a hundred boards take from the box to poses, by the commands of docs/boards.md, on host boards and one CAN.

Times are those of the bench, in which the host's own work takes none: what boards, bus and the host's waiting take.
Beacons beyond those that a sensor reports are spare boards: they get their numbers, and no part of the site.

    python -m tests.bench.commissioning_figures                 64 beacons, 35 spare ones and a sensor
    python -m tests.bench.commissioning_figures --boards 20
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from goldfield import site as sites
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.pipeline import Sensor
from tests.command import whole_number
from tests.hil.from_the_box import MOST_SITED, Bench, documented_commands, hall
from tests.hil.rig_link import RigLink

SENSOR_M = (0.9, 1.2, 0.8)
POSES = 20


def measure(boards: int, directory: Path) -> None:
    """Print each command with its time on the bench, what it told, and the poses in the end."""
    scenario, site = directory / "scenario.toml", directory / "room.toml"
    scenario.write_text(hall(boards - 1))
    bench = Bench(scenario, MOST_SITED)
    began_s, wall_s, numbers = bench.rig.now_s, time.perf_counter(), dict[str, int]()
    for words in documented_commands():
        if words[:2] in (["nodes", "set"], ["nodes", "save"], ["nodes", "reset"]):
            words[2] = str(numbers["b1"])  # The wire is that of this board.
        if words[:2] == ["nodes", "identify"]:
            words[2] = str(numbers["b1"])
        begin_s = bench.rig.now_s
        code, out, told = bench.run(*[str(site) if word == "room.toml" else word for word in words])
        said = (out or told).splitlines()
        print(f"{bench.rig.now_s - begin_s:7.1f} s  {' '.join(words)}: exit {code}, {len(said)} lines, the last one:")
        print(f"           {said[-1][:100]}")
        if words[:2] == ["nodes", "assign"]:
            listed = bench.lines("nodes", "boards")
            numbers = bench.numbers(listed)
            bench.write_site(site, listed)
            print(f"           {len({line['node'] for line in listed})} numbers for {len(listed)} boards")
        if words[:2] == ["nodes", "reset"]:
            print(f"           bridges that were enabled so far: {len(bench.energised())}")
    link = RigLink(bench.rig)
    sessions.time = dialogues.time = link  # type: ignore[assignment]
    epochs = Sensor(link, "hall", sites.load(site)).epochs()
    poses = [next(epochs).pose for _ in range(POSES)]
    good = [pose for pose in poses if pose.status == "ok"]
    errors_m = [float(np.linalg.norm(pose.position_m - SENSOR_M)) for pose in good]
    took_s, here_s = bench.rig.now_s - began_s, time.perf_counter() - wall_s
    print(f"{took_s:7.1f} s  altogether, with {POSES} poses; {here_s:.0f} s of this machine")
    print(f"           {len(good)} of {POSES} poses ok, the worst {1e3 * max(errors_m, default=np.nan):.1f} mm off")
    bench.rig.close()


def main() -> None:
    """Measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boards", type=whole_number(2), default=100, help="boards, the sensor among them")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        measure(arguments.boards, Path(directory))


if __name__ == "__main__":
    main()
