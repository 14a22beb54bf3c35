"""Time, memory and sameness of a large plan: ``make plan-figures`` (PLAN="--points 20000" for a small one).

A hall with a ceiling lattice of beacons is planned in one process, in two, and on two Dask workers of this machine,
each from a start of its own, as a user would. It prints the seconds, those of the processor in all processes, the
largest memory of any process and of all together, the ratios, and the largest relative difference of the maps; it ends
with 1 if a map differs by more than 1e-12. What two processes spend beside what one does is the price of spreading,
whatever else the machine does; ``on idle cores`` is how much faster two of them are at best.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import psutil
from distributed import LocalCluster

from tests.command import whole_number

SPACING_M, HEIGHT_M = 4.5, 3.0
STEP_M, HEIGHTS = 0.275, 4
"""With these a hall of a thousand beacons has a million points."""

LARGEST_DIFFERENCE = 1e-12


def lattice_file(folder, beacons):
    """Write the lattice; return its path and its extent along x and y."""
    nx = round((1.6 * beacons) ** 0.5)
    ny = round(beacons / nx)
    path = folder / "hall.toml"
    path.write_text(
        f"[lattice]\ncount = [{nx}, {ny}]\nspacing_m = [{SPACING_M}, {SPACING_M}]\nheight_m = {HEIGHT_M}\n"
        "turns = 19\nradius_m = 0.149\ncurrent_A = 10.0\n[sensor]\nnoise_T = 2e-8\n"
    )
    return path, nx * ny, (SPACING_M * (nx - 1), SPACING_M * (ny - 1))


class Memory:
    """Samples the resident memory of a process and its children until it is stopped."""

    def __init__(self, pid, others=()):
        self.largest = self.together = 0
        self._pids, self._stop = (pid, *others), threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self):
        while not self._stop.wait(0.2):
            sizes = []
            for pid in self._pids:
                with contextlib.suppress(psutil.Error):
                    process = psutil.Process(pid)
                    for one in (process, *process.children(recursive=True)):
                        with contextlib.suppress(psutil.Error):
                            sizes.append(one.memory_info().rss)
            self.largest = max([self.largest, *sizes])
            self.together = max(self.together, sum(sizes))

    def stop(self):
        self._stop.set()
        self._thread.join()


def spent(pids):
    """Return the seconds of the processor that running processes have used."""
    times = [psutil.Process(pid).cpu_times() for pid in pids]
    return sum(one.user + one.system for one in times)


def ended():
    """Return the seconds of the processor that processes which have ended have used, and theirs before them."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def measured(words, out, others=()):
    """Run the command; return its seconds, those of the processor, MB of the largest process and of all, and arrays."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "goldfield", "plan", *words, "--out", str(out), "--json"]
    begin, used = time.perf_counter(), spent(others) + ended()
    process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    memory = Memory(process.pid, others)
    printed, _ = process.communicate()
    seconds, used = time.perf_counter() - begin, spent(others) + ended() - used
    memory.stop()
    if process.returncode:
        raise SystemExit(f"the plan ended with {process.returncode}")
    with np.load(out) as arrays:
        return seconds, used, memory.largest / 1e6, memory.together / 1e6, dict(arrays), printed


def difference(first, second):
    """Return the largest relative difference of the arrays of two maps; infinite where kinds of infinity differ."""
    largest = 0.0
    for key, one in first.items():
        other = second[key]
        if one.dtype.kind != "f":
            largest = max(largest, 0.0 if np.array_equal(one, other) else np.inf)
        elif not np.array_equal(one, other):
            with np.errstate(all="ignore"):
                relative = np.abs(one - other) / np.abs(one)
            largest = max(largest, float(np.where(one == other, 0.0, np.nan_to_num(relative, nan=np.inf)).max()))
    return largest


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--beacons", type=whole_number(1), default=1000)
    parser.add_argument("--points", type=whole_number(1), default=1_000_000)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        lattice, beacons, (wide, long) = lattice_file(folder, given.beacons)
        area = given.points / HEIGHTS * STEP_M**2
        part = min(1.0, (area / (wide * long)) ** 0.5)  # a few points are of the hall's middle
        low = [0.5 * (1.0 - part) * wide, 0.5 * (1.0 - part) * long, 0.5]
        high = [low[0] + part * wide, low[1] + part * long, 0.5 + (HEIGHTS - 1) * STEP_M]
        box = [f"{value:.6f}" for value in (*low, *high)]
        words = ["--lattice", str(lattice), "--box", *box, "--step", str(STEP_M)]
        ways = {"1 process": ["--workers", "1"], "2 processes": ["--workers", "2"]}
        results = {way: measured([*words, *more], folder / f"{way[0]}.npz") for way, more in ways.items()}
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=":0") as cluster:
            workers = [worker.pid for worker in cluster.workers.values()]
            address = ["--scheduler", cluster.scheduler_address]
            results["2 Dask workers"] = measured([*words, *address], folder / "dask.npz", workers)
    first = results["1 process"]
    print(f"{beacons} beacons, {first[4]['position_sd_m'].size} points, step {STEP_M} m: {first[5].strip()}")
    worst = 0.0
    for way, (seconds, used, largest, together, arrays, _) in results.items():
        apart = difference(first[4], arrays)
        idle = (1 if way == "1 process" else 2) * first[1] / used
        worst = max(worst, apart)
        print(
            f"{way:15} {seconds:8.1f} s, {first[0] / seconds:5.2f} times as fast as one process; "
            f"processor {used:7.1f} s, on idle cores at best {idle:.2f} times as fast; "
            f"largest process {largest:5.0f} MB, together {together:5.0f} MB; largest relative difference {apart:.1e}"
        )
    return int(worst > LARGEST_DIFFERENCE)


if __name__ == "__main__":
    sys.exit(main())
