"""Print how long location takes beside the version before integrity: ``python -m tests.bench.locate_before``.

That version is taken from the history of this repository and built in a temporary folder. Both locate the same epochs
in turns, each in a process of its own; the least processor time of each counts, so that other work on the machine
disturbs little and both alike.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tarfile
import tempfile
from io import BytesIO
from pathlib import Path

import numpy as np

from tests.bench import locate_trials as bench
from tests.bench.integrity_sites import EXACT, text_of
from tests.command import whole_number

ROOT = Path(__file__).resolve().parents[2]
BEFORE = "efa029e"
"""The last revision whose poses have neither a reason nor a protection level."""

NEEDED = ("host", "protocol", "firmware/core", "setup.py", "pyproject.toml", "README.md")
TASKS = ("single", "batched")
WORKER = """
import sys, time
import numpy as np
from goldfield import load_site
from goldfield.locate import Locator
from goldfield.types import Fields
site = load_site(sys.argv[1])
names = tuple(beacon.id for beacon in site.beacons)
data = np.load(sys.argv[2])
rows = enumerate(zip(data["field_T"], data["sigma_T"]))
epochs = [Fields(i, 0.1 * i, names, field, sigma) for i, (field, sigma) in rows]
locator = Locator(site)
locator.locate_many(epochs[:10])
for line in sys.stdin:
    some = epochs[:200] if line.strip() == "single" else epochs
    began = time.process_time()
    poses = [locator.locate(one) for one in some] if line.strip() == "single" else locator.locate_many(some)
    spent = time.process_time() - began
    assert sum(str(pose.status) == "ok" for pose in poses) > 0.99 * len(poses)
    print(1e6 * spent / len(some), flush=True)
"""
"""Locates all epochs in one call, or 200 of them one by one, as a line says; answers with us an epoch."""


class Version:
    """A version of the host that locates in a process of its own."""

    def __init__(self, tree: Path, site: Path, fields: Path) -> None:
        path = os.pathsep.join([str(tree / "host"), str(tree / "protocol")])
        self._process = subprocess.Popen(
            [sys.executable, "-c", WORKER, str(site), str(fields)],
            env={**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def time_us(self, task: str) -> float:
        """Return the processor time of an epoch."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(task, file=self._process.stdin, flush=True)
        return float(self._process.stdout.readline())

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def earlier(folder: Path, revision: str) -> bool:
    """Put a revision of the host into a folder and build its kernel; False if the history does not reach so far."""
    archive = subprocess.run(["git", "archive", revision, *NEEDED], cwd=ROOT, capture_output=True, check=False)
    if archive.returncode:
        return False
    with tarfile.open(fileobj=BytesIO(archive.stdout)) as packed:
        packed.extractall(folder, filter="data")
    build = [sys.executable, "setup.py", "-q", "build_ext", "--inplace", "--force"]
    subprocess.run(build, cwd=folder, check=True, capture_output=True)
    return True


def compared(folder: Path, rounds: int, epochs: int, seed: int) -> None:
    """Print the times of both versions and their ratio, of a site file that says it is exact and of a silent one."""
    rng, site = np.random.default_rng(seed), bench.prigge_cube()
    run = bench.trials(site, bench.cube_positions(rng, epochs), rng)
    silent, exact, fields = folder / "silent.toml", folder / "exact.toml", folder / "fields.npz"
    silent.write_text(text_of(site, None), encoding="utf-8")
    exact.write_text(text_of(site, EXACT), encoding="utf-8")
    np.savez(fields, field_T=run.field_T, sigma_T=run.sigma_T)
    before = Version(folder / "before", silent, fields)  # which takes every site for exact
    versions = {"exact": Version(ROOT, exact, fields), "silent": Version(ROOT, silent, fields)}
    for task in TASKS:
        least, reference = dict.fromkeys(versions, np.inf), np.inf
        for _ in range(rounds):
            reference = min(reference, before.time_us(task))
            for name, version in versions.items():
                least[name] = min(least[name], version.time_us(task))
        told = "; ".join(f"site {name} {us:.0f}, {us / reference:.2f} times" for name, us in least.items())
        print(f"location, {task}, us an epoch: before integrity {reference:.0f}; now: {told}")
    for version in (before, *versions.values()):
        version.close()


def main(argv: list[str] | None = None) -> int:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--revision", default=BEFORE, help=f"what to compare with (default {BEFORE})")
    parser.add_argument("--rounds", type=whole_number(1), default=9, help="turns of which the least counts (default 9)")
    parser.add_argument(
        "--epochs", type=whole_number(1), default=2000, help="epochs in the cube of eight beacons (default 2000)"
    )
    parser.add_argument("--seed", type=whole_number(), default=106)
    options = parser.parse_args(argv)
    with tempfile.TemporaryDirectory(prefix="goldfield-before-") as folder:
        (Path(folder) / "before").mkdir()
        if not earlier(Path(folder) / "before", options.revision):
            print(f"the history has no {options.revision}: nothing to compare location with")
            return 0
        compared(Path(folder), options.rounds, options.epochs, options.seed)
    return 0


if __name__ == "__main__":
    sys.exit(main())
