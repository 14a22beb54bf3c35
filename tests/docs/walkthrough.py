"""The commands of docs/new_room.md, run one after the other as the page tells, and how good what they make is."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import numpy.typing as npt

from goldfield import load_site
from hil_sim.clib import ROOT

PAGE = ROOT / "docs/new_room.md"


def blocks(language: str) -> list[str]:
    """Return the code blocks of a language, in the order of the page."""
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)


def commands() -> list[str]:
    """Return all commands of the page, in their order."""
    return [line for block in blocks("sh") for line in block.splitlines()]


def run_page(folder: Path, tell: Callable[[str], None] = lambda _: None) -> dict[str, str]:
    """Run all commands in a folder that is empty, and return what each printed.

    A bench (``goldfield hil`` without ``--seconds``) runs as fast as it is read, beside the commands that follow, until
    the next one starts. Before its reader is there it waits, since its port is held open.

    Raises
    ------
    RuntimeError
        A command ended with another exit code than 0.
    """
    scenario = (ROOT / "hil_sim/scenarios/walk8.toml").read_text(encoding="utf-8")
    quiet = scenario.replace("\nnoise_T = 2.0e-7 ", "\nnoise_T = 2.0e-8 ")
    if quiet == scenario:
        raise RuntimeError("walk8.toml has no noise_T = 2.0e-7, which the page changes")
    (folder / "metal_room.toml").write_text(quiet + "\n" + "\n".join(blocks("toml")), encoding="utf-8")
    printed: dict[str, str] = {}
    with ExitStack() as last:
        bench = last.enter_context(ExitStack())
        for command in commands():
            tell(command)
            if command.startswith("goldfield hil") and "--seconds" not in command:
                bench.close()
                _start(command, folder, bench)
            else:
                printed[command] = _run(command, folder)
    return printed


def _words(command: str) -> list[str]:
    program, *rest = shlex.split(command.partition(" > ")[0])
    if program != "goldfield":
        raise RuntimeError(f"{command}: the page runs goldfield and nothing else")
    return [sys.executable, "-m", "goldfield", *rest]


def _environment() -> dict[str, str]:
    own = {name: value for name, value in os.environ.items() if not name.startswith("GOLDFIELD_")}
    return own | {"PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}:{ROOT}"}


def _run(command: str, folder: Path) -> str:
    done = subprocess.run(_words(command), cwd=folder, env=_environment(), capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{command} ended with {done.returncode}:\n{done.stdout[-2000:]}{done.stderr}")
    _, redirected, file = command.partition(" > ")
    if redirected:
        (folder / file).write_text(done.stdout, encoding="utf-8")
    return done.stdout + done.stderr


def _start(command: str, folder: Path, bench: ExitStack) -> None:
    words = [*_words(command), "--pace", "0"]
    process = subprocess.Popen(words, cwd=folder, env=_environment(), stdout=subprocess.PIPE, text=True)
    bench.callback(process.wait)
    bench.callback(process.terminate)
    port = folder / "sensor"
    assert process.stdout is not None
    if not process.stdout.readline().startswith("serial ") or not port.exists():  # its first line: the bench is there
        raise RuntimeError(f"{command}: there is no port {port}")
    bench.callback(os.close, os.open(port, os.O_RDWR | os.O_NOCTTY))


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
