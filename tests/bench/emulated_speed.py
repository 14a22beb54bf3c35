"""Print what a rig of emulated boards costs: processor time and instructions of a virtual second.

``python -m tests.bench.emulated_speed [--scenario NAME] [--cycles N|m4] [--before FOLDER]``. The rig runs on one
thread, and boots first. With a folder of libraries that were built before (``cp build/libgf_*.so FOLDER``, and a link
``FOLDER/unicorn`` to ``build/unicorn``) a rig with those runs the same slices in turns, each in a process of its own:
the factor is the median over the slices, which a loaded machine hardly changes, and both must say the same.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

from hil_sim.clib import LIBRARIES_VARIABLE, ROOT
from hil_sim.options import cycles
from hil_sim.rig import Rig
from hil_sim.scenario import SCENARIOS, load_scenario
from tests.command import one_of, real_number, whole_number

NAMES = sorted(path.stem for path in SCENARIOS.glob("*.toml"))


def serve(scenario: str, cycles: float | str, boot_s: float, slice_s: float) -> None:
    """Run a slice for each line of stdin; print its processor time, instructions, and a hash of all that was said."""
    loaded = load_scenario(str(ROOT / f"hil_sim/scenarios/{scenario}.toml"))
    boards = range(1 + len(loaded.beacons))
    said = hashlib.sha256()
    rig = Rig(loaded, "emulated", threads=1, cycles_per_instruction=cycles)
    rig.advance(boot_s)
    ran = instructions(rig)
    print(json.dumps([0.0, 0, ""]), flush=True)
    for _ in sys.stdin:
        begun_s = time.process_time()
        rig.advance(slice_s)
        spent_s, before, ran = time.process_time() - begun_s, ran, instructions(rig)
        for board in boards:
            said.update(rig.serial_read(board))
        said.update(repr(rig.can_read()).encode())
        print(json.dumps([spent_s, ran - before, said.hexdigest()]), flush=True)
    rig.close()


def instructions(rig: Rig) -> int:
    """Return what all boards have executed so far."""
    return sum(int(rig.statistics(board)["instructions"]) for board in range(1 + len(rig.scenario.beacons)))


class Served:
    """A rig in a process of its own."""

    def __init__(self, words: list[str], libraries: Path | None) -> None:
        environment = dict(os.environ) if libraries is None else {**os.environ, LIBRARIES_VARIABLE: str(libraries)}
        command = [sys.executable, "-m", "tests.bench.emulated_speed", *words, "--serve"]
        self._process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._answer()

    def _answer(self) -> tuple[float, int, str]:
        assert self._process.stdout is not None
        spent_s, ran, said = json.loads(self._process.stdout.readline())
        return spent_s, ran, said

    def slice(self) -> tuple[float, int, str]:
        """Run a slice; see `serve`."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self._answer()

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenario", type=one_of(NAMES), default="prigge8")
    parser.add_argument("--cycles", type=cycles, default=1.0, help="cycles of an instruction, or m4: by class")
    parser.add_argument("--before", type=Path, help="folder of libraries to compare with")
    parser.add_argument("--boot", type=real_number(0.0), default=0.8, help="virtual seconds before")
    parser.add_argument("--slice", type=real_number(0.001), default=0.02, help="virtual seconds of a slice")
    parser.add_argument("--slices", type=whole_number(1), default=15)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.serve:
        serve(arguments.scenario, arguments.cycles, arguments.boot, arguments.slice)
        return
    words = ["--scenario", arguments.scenario, "--cycles", str(arguments.cycles)]
    words += ["--boot", str(arguments.boot), "--slice", str(arguments.slice)]
    rigs = [Served(words, None)] + ([Served(words, arguments.before.resolve())] if arguments.before else [])
    slices = []
    for number in range(arguments.slices):
        order = rigs if number % 2 == 0 else rigs[::-1]
        taken = {id(rig): rig.slice() for rig in order}
        slices.append([taken[id(rig)] for rig in rigs])
    for rig in rigs:
        rig.close()
    virtual_s = arguments.slices * arguments.slice
    for name, column in zip(("now", "before"), zip(*slices, strict=True), strict=False):
        spent_s, ran = sum(one[0] for one in column), sum(one[1] for one in column)
        print(
            f"{name}: {spent_s / virtual_s:.2f} s of a processor, {ran / virtual_s * 1e-6:.1f} M instructions a second"
        )
    if arguments.before:
        factors = sorted(before[0] / now[0] for now, before in slices)
        same = "the same" if slices[-1][0][2] == slices[-1][1][2] else "ANOTHER"
        quarter = len(factors) // 4
        print(
            f"factor {statistics.median(factors):.3f} ({factors[quarter]:.3f} to {factors[-1 - quarter]:.3f}), {same}"
        )


if __name__ == "__main__":
    main()
