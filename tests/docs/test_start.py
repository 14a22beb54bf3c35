"""The commands of docs/start.md, run one after the other as the page tells."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_sim.clib import ROOT

COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", (ROOT / "docs/start.md").read_text(), re.S)
    for line in block.splitlines()
]
BENCH, LIVE, *LATER = COMMANDS


def words(command: str) -> list[str]:
    program, *rest = shlex.split(command)
    assert program == "goldfield"
    return [sys.executable, "-m", "goldfield", *rest]


@pytest.fixture
def port(tmp_path: Path) -> Iterator[str]:
    """The bench of the page: the path of its serial port."""
    environment = os.environ | {"PYTHONPATH": f"{ROOT / 'host'}:{ROOT / 'protocol'}:{ROOT}"}
    bench = subprocess.Popen(
        [*words(BENCH), "--can", "none"], cwd=tmp_path, stdout=subprocess.PIPE, text=True, env=environment
    )
    assert bench.stdout is not None
    try:
        yield bench.stdout.readline().split()[1].rstrip(",")
    finally:
        bench.terminate()
        bench.communicate()


def run(command: str, directory: Path) -> str:
    done = subprocess.run(words(command), cwd=directory, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_page_works(port: str, tmp_path: Path) -> None:
    live = run(LIVE.replace("PORT", port), tmp_path)
    epochs, ok = map(int, re.search(r"^(\d+) epochs: (\d+) ok", live, re.M).groups())  # type: ignore[union-attr]
    assert epochs == 30
    assert ok >= 29
    replayed, located = (run(command, tmp_path) for command in LATER)
    poses = [line for line in live.splitlines() if line.endswith("  ok")]
    assert len(poses) == ok
    # The recording also has what came while the sensor was set up, so its first poses know more of the ambient field.
    assert set(poses[2:]) <= set(replayed.splitlines())
    statuses = [json.loads(line)["status"] for line in located.splitlines()]
    assert statuses.count("ok") == ok
