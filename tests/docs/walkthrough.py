"""Run the commands of a page, one after the other as it tells a reader, and keep what each printed.

In a page of ``docs``

- a block of ``sh`` holds commands, which run in one folder that is empty at first, from the top of the page on: those
  of ``goldfield``, and ``python FILE.py``. A comment ``# exits with N`` behind one says which exit code is right.
- ``goldfield hil`` without ``--seconds`` is a bench: it runs beside the commands that follow, until the next starts.
  One that waits for its readers (``--wait``) runs as fast as it is read, so each run of a page sees the same.
  ``CHANNEL`` stands for the CAN channel that its first line told.
- a block of ``python`` or ``toml`` whose first line is a comment with a file's name is saved under this name.
- a block of ``text`` quotes lines that the last command above it printed.
- an indented block, or one of ``console``, holds commands that need boards or files that the reader has. They are not
  run; `tests.docs.test_commands` has the command line's own parser look at them.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from goldfield import load_site
from hil_sim.clib import ROOT

FENCED = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)
FILE_NAME = re.compile(r"# ([\w-]+\.(?:py|toml))\n")
EXIT_CODE = re.compile(r"# exits with (\d+)")


@dataclass(frozen=True)
class Step:
    """A command of a page, what it printed, and the lines that the page quotes of it."""

    command: str
    printed: str
    quoted: tuple[str, ...]


def page(name: str) -> str:
    """Return the text of a page of ``docs``."""
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def blocks(name: str, language: str) -> list[str]:
    """Return the code blocks of a language, in the order of the page."""
    return [text for kind, text in FENCED.findall(page(name)) if kind == language]


def steps(name: str) -> Iterator[tuple[str, list[str]]]:
    """Yield each command of a page with the lines that the page quotes of it."""
    command, quoted = "", []
    for language, text in FENCED.findall(page(name)):
        if language == "sh":
            for line in text.splitlines():
                if command:
                    yield command, quoted
                command, quoted = line, []
        elif language == "text":
            quoted += [line for line in text.splitlines() if line != "..."]
    if command:
        yield command, quoted


def run_page(
    name: str, folder: Path, tell: Callable[[str], None] = lambda _: None, until: str | None = None
) -> list[Step]:
    """Run all commands of a page, or those in front of one, in a folder and return what each printed.

    Raises
    ------
    RuntimeError
        A command ended with another exit code than the page says.
    """
    for language in ("python", "toml"):
        for text in blocks(name, language):
            if named := FILE_NAME.match(text):
                (folder / named[1]).write_text(text, encoding="utf-8")
    done = []
    with ExitStack() as last:
        bench = last.enter_context(ExitStack())
        channel = ""
        for command, quoted in steps(name):
            if command == until:
                break
            tell(command)
            if command.startswith("goldfield hil") and "--seconds" not in command:
                bench.close()
                printed = _start(command, folder, bench)
                channel = printed.partition(", CAN ")[2].partition(" ")[0]
            else:
                printed = _run(command.replace("CHANNEL", channel), folder)
            done.append(Step(command, printed, tuple(quoted)))
    return done


def words(command: str) -> list[str]:
    """Return the words of a command as this Python runs it, without its comment and without what it writes into."""
    program, *rest = shlex.split(command.partition(" > ")[0], comments=True)
    if program == "goldfield":
        return [sys.executable, "-m", "goldfield", *rest]
    if program == "python":
        return [sys.executable, *rest]
    raise RuntimeError(f"{command}: a page runs goldfield or python, and nothing else")


def environment() -> dict[str, str]:
    """Return the environment of a reader who has installed this tree and has set nothing."""
    own = {name: value for name, value in os.environ.items() if not name.startswith("GOLDFIELD_")}
    return own | {"PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}:{ROOT}"}


def _run(command: str, folder: Path) -> str:
    done = subprocess.run(words(command), cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    expected = EXIT_CODE.search(command)
    if done.returncode != (int(expected[1]) if expected else 0):
        raise RuntimeError(f"{command} ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr}")
    _, redirected, file = command.partition(" > ")
    if redirected:
        (folder / file).write_text(done.stdout, encoding="utf-8")
    return done.stdout + done.stderr


def _start(command: str, folder: Path, bench: ExitStack) -> str:
    """Start a bench and return its first line."""
    process = subprocess.Popen(
        [*words(command), *(["--pace", "0"] if "--wait" in command else [])],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        text=True,
    )
    bench.callback(process.wait)
    bench.callback(process.terminate)
    port = folder / "sensor"
    assert process.stdout is not None
    first = process.stdout.readline()
    if not first.startswith("serial ") or not port.exists():  # its first line: the bench is there
        raise RuntimeError(f"{command}: there is no port {port}")
    return first


def places_m(site: Path) -> npt.NDArray[np.float64]:
    """Return where the beacons of a site file are, shape (beacons, 3), m."""
    return np.array([beacon.position_m for beacon in load_site(site).beacons])


def beacon_rms_m(site: Path, true_site: Path) -> float:
    """Return the rms distance of the beacons of a site file from the true ones, m."""
    return float(np.sqrt(np.mean(np.sum((places_m(site) - places_m(true_site)) ** 2, axis=1))))


def located(poses: Path, truth: Path) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return located and true positions of the epochs that both files tell of, each of shape (epochs, 3), m."""
    true = {line["cycle"]: line["position_m"] for line in map(json.loads, truth.read_text().splitlines())}
    ours = [line for line in map(json.loads, poses.read_text().splitlines()) if line["epoch"] in true]
    return np.array([line["position_m"] for line in ours]), np.array([true[line["epoch"]] for line in ours])
