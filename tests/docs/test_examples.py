"""The programs of docs/examples and the README's Python run as a reader would run them, on simulated boards."""

import contextlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

TREE = Path(__file__).parents[2]
EXAMPLES = TREE / "docs" / "examples"
POSITION_M = np.array([0.9, 1.2, 0.8])


def run(*command, **options):
    done = subprocess.run([sys.executable, *map(str, command)], capture_output=True, text=True, check=False, **options)
    assert done.returncode == 0, done.stderr
    return done.stdout


@contextlib.contextmanager
def bench(directory):
    """Simulated boards as a process of their own, which stand still until they are read; yields the sensor's port.

    The site file is room.toml.
    """
    command = ["-m", "goldfield", "hil", "prigge8", "--boards", "host", "--wait", "--json", "--can", "none"]
    command += ["--site", str(directory / "room.toml"), "--truth", str(directory / "truth.jsonl")]
    with subprocess.Popen([sys.executable, *command], stdout=subprocess.PIPE, text=True) as rig:
        try:
            yield json.loads(rig.stdout.readline())["serial"]
        finally:
            rig.terminate()


def positions(text):
    return np.array(
        [[float(x) for x in row] for row in re.findall(r"(-?\d\.\d{3}) +(-?\d\.\d{3}) +(-?\d\.\d{3}) m", text)]
    )


def test_live_poses(tmp_path):
    with bench(tmp_path) as port:
        out = run(EXAMPLES / "live_poses.py", port, tmp_path / "room.toml", "0.5")
    *lines, last = out.splitlines()
    assert 5 <= len(lines) <= 7
    assert np.linalg.norm(positions(out) - POSITION_M, axis=1).max() < 0.04
    assert last.startswith("0 corrupt frames")


def test_live_poses_says_what_is_wrong(tmp_path):
    command = [sys.executable, EXAMPLES / "live_poses.py", "/dev/no-such-port", EXAMPLES / "room.toml"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "/dev/no-such-port: there is no such port: check port=\n"


def test_replay():
    alone, tracked = run(EXAMPLES / "replay.py").splitlines()
    scatter = [float(re.search(r"scatter (\d+\.\d\d) mm", line)[1]) for line in (alone, tracked)]
    for line, name in ((alone, "each epoch by itself"), (tracked, "tracked")):
        ok, epochs = map(int, re.match(rf"{name}: (\d+) of (\d+) ok", line).groups())
        assert 30 < epochs - 1 <= ok <= epochs
    assert scatter[1] < scatter[0] < 20.0


def test_locate_table():
    out = run(EXAMPLES / "locate_table.py")
    assert out.count(", ok\n") == len(out.splitlines()) == 10
    assert np.linalg.norm(positions(out) - POSITION_M, axis=1).max() < 0.04


def test_my_robot(tmp_path):
    """The example runs in a stranger's project, which sees no configuration of this tree."""
    test = tmp_path / "test_my_robot.py"
    test.write_text((EXAMPLES / "test_my_robot.py").read_text())
    out = run("-m", "pytest", "-q", "-p", "hil_sim.pytest_plugin", "--goldfield-rig", "host", test, cwd=tmp_path)
    assert "1 passed" in out


def test_the_plugin_stays_out_of_a_project_that_does_not_ask(tmp_path):
    (tmp_path / "test_nothing.py").write_text("def test_nothing():\n    pass\n")
    out = run("-m", "pytest", "-q", "--trace-config", cwd=tmp_path)
    assert "1 passed" in out
    assert "hil_sim" not in out


def test_the_readmes_python(tmp_path):
    """Its port is the simulated bench's; it is ended after a while, as by Ctrl-C."""
    block = re.search(r"^```python\n(.*?)^```", (TREE / "README.md").read_text(), re.M | re.S)
    if block is None:
        pytest.fail("README.md has no block of Python")
    with bench(tmp_path) as port:
        program = block[1].replace("/dev/ttyUSB0", port)
        assert port in program
        environment = os.environ | {"PYTHONUNBUFFERED": "1"}
        command = [sys.executable, "-c", program]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=tmp_path, env=environment) as reader:
            lines = [reader.stdout.readline() for _ in range(5)]
            reader.terminate()
    for line in lines:
        x, y, z = map(float, re.match(r"\[([^]]*)\] \[[^]]*\] ok", line)[1].split())
        assert np.linalg.norm(np.subtract([x, y, z], POSITION_M)) < 0.04
