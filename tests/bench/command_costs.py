"""Print what each subcommand costs: its start-up, its time for a cycle, and its memory.

``python -m tests.bench.command_costs [--cycles N] [--turns N]``. Start-up is the processor time of ``goldfield COMMAND
--help`` over that of ``import numpy``. The time for a cycle is the difference of two runs, of ``N`` and of ``N / 4``
cycles, over the difference of their cycles, so that start-up is not in it; the least of several turns counts. It is
printed over the 100 ms that a cycle lasts (below 1: the command keeps up with a sensor) and in cycles a second. Memory
is the peak of the longer run. The recording is made first, by simulated boards that are compiled for this machine.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from goldfield.cli.entry import build_parser
from tests.command import whole_number

CYCLE_S = 0.1
GOLDFIELD = [sys.executable, "-m", "goldfield"]
SCENARIO = "prigge8"


@dataclass(frozen=True, slots=True)
class Cost:
    """Processor time, s, and peak memory, bytes, of one process that ended well."""

    processor_s: float
    peak_bytes: int


def cost(command: list[str]) -> Cost:
    """Run a command to its end and return what it cost; a command that fails ends the table."""
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode != 0:
            errors.seek(0)
            sys.exit(f"{' '.join(command)} ended with {process.returncode}: {errors.read().decode(errors='replace')}")
    return Cost(usage.ru_utime + usage.ru_stime, usage.ru_maxrss * 1024)


def least(command: list[str], turns: int) -> Cost:
    """Return the least time, and the memory that went with it, of several runs."""
    return min((cost(command) for _ in range(turns)), key=lambda run: run.processor_s)


def subcommands() -> list[str]:
    """Return the names of all subcommands, those of other packages too."""
    (choices,) = (action.choices for action in build_parser()._actions if isinstance(action.choices, dict))
    return list(choices)


def print_start_up(turns: int) -> None:
    """Print the start-up of each subcommand beside ``import numpy``."""
    numpy = least([sys.executable, "-c", "import numpy"], turns)
    print(f"{'start-up':<28} over import numpy ({numpy.processor_s * 1e3:.0f} ms)   peak MB")
    for name in ["--version", *(f"{name} --help" for name in subcommands())]:
        run = least([*GOLDFIELD, *name.split()], turns)
        print(f"{name:<28} {run.processor_s / numpy.processor_s:>10.2f} {run.peak_bytes / 1e6:>27.0f}", flush=True)


def record(folder: Path, cycles: int) -> None:
    """Record a sensor of a simulated bench, its fields, and its raw samples: site.toml, log, fields.csv."""
    site = folder / "site.toml"
    hil = [
        *GOLDFIELD,
        "hil",
        SCENARIO,
        "--boards",
        "host",
        "--pace",
        "0",
        "--can",
        "none",
        "--json",
        "--site",
        str(site),
    ]
    bench = subprocess.Popen(hil, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        port = json.loads(bench.stdout.readline())["serial"]
        run = ["run", "--port", port, "--site", str(site), "--seconds", str(cycles * CYCLE_S)]
        run += ["--record", str(folder / "all.log"), "--fields", str(folder / "all.csv")]
        cost([*GOLDFIELD, *run])
    finally:
        bench.terminate()
        bench.communicate()


def shorten(folder: Path, share: float) -> Callable[[str, bool], str]:
    """Cut the recording and the table after a share of their cycles; return the path of either, whole or cut."""
    for name in ("all.log", "all.csv"):
        lines = (folder / name).read_text(encoding="utf-8").splitlines(keepends=True)
        (folder / f"part_{name}").write_text("".join(lines[: int(len(lines) * share)]), encoding="utf-8")
    return lambda name, whole: str(folder / (name if whole else f"part_{name}"))


def print_work(folder: Path, cycles: int, turns: int) -> None:
    """Print the time for a cycle and the memory of the commands that take a recording, and of the bench itself."""
    record(folder, cycles)
    share = 0.25
    path = shorten(folder, share)
    site = ["--site", str(folder / "site.toml")]

    def seconds(whole: bool) -> str:
        return str(cycles * CYCLE_S * (1.0 if whole else share))

    hil = ["hil", SCENARIO, "--pace", "0", "--can", "none", "--seconds"]
    work: dict[str, Callable[[bool], list[str]]] = {
        "run --log": lambda whole: ["run", "--log", path("all.log", whole), *site],
        "run --log --json": lambda whole: ["run", "--log", path("all.log", whole), *site, "--json"],
        "run --log --track": lambda whole: ["run", "--log", path("all.log", whole), *site, "--track"],
        "locate": lambda whole: ["locate", path("all.csv", whole), *site],
        "locate --track": lambda whole: ["locate", path("all.csv", whole), *site, "--track"],
        "hil --boards host": lambda whole: [*hil, seconds(whole), "--boards", "host"],
        "hil --boards emulated": lambda whole: [*hil, seconds(whole)],
    }
    print(f"\n{'work':<28} over 100 ms a cycle   cycles a second   peak MB")
    for name, words in work.items():
        short, long = (least([*GOLDFIELD, *words(whole)], turns) for whole in (False, True))
        each = (long.processor_s - short.processor_s) / (cycles * (1.0 - share))
        row = f"{name:<28} {each / CYCLE_S:>19.4f} {1.0 / each:>17.0f} {long.peak_bytes / 1e6:>9.0f}"
        print(row, flush=True)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cycles", type=whole_number(1), default=200, help="length of the recording")
    parser.add_argument("--turns", type=whole_number(1), default=3, help="runs of each, of which the least time counts")
    arguments = parser.parse_args()
    print_start_up(arguments.turns)
    with tempfile.TemporaryDirectory() as name:
        print_work(Path(name), arguments.cycles, arguments.turns)


if __name__ == "__main__":
    main()
