"""``goldfield calibrate`` on a simulated bench: by the command line alone, against the bench's true site file."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib

import jsonschema
import numpy as np
import pytest

from goldfield.cli import main
from hil_sim import scenario
from hil_sim.clib import ROOT

TURNING = """
[motion]
kind = "turning"
position_m = [0.9, 1.2, 0.8]
seconds = 600.0
sway_m = 0.005

[installation]
current_sd = 0.0002
sensor_gain_sd = 0.01
sensor_axis_sd_rad = 0.01
sensor_offset_sd_T = 1e-6

"""


def bench_file(directory):
    """Write the bench prigge8 with a sensor that a hand turns and that is not as its parameters say."""
    text = scenario.find("prigge8").read_text().replace("noise_T = 2.0e-7", "noise_T = 5.0e-8", 1)
    head, rest = text.split("[motion]")
    path = directory / "turning.toml"
    path.write_text(head + TURNING + rest[rest.index("[coil]") :])
    return path


@pytest.fixture
def bench(tmp_path):
    """Run the bench on host boards, as fast as it is read, and only then; port and files are in the test's folder."""
    files = ["--link", str(tmp_path / "port"), "--site", str(tmp_path / "site.toml")]
    files += ["--true-site", str(tmp_path / "true.toml")]
    command = [sys.executable, "-m", "goldfield", "hil", str(bench_file(tmp_path)), "--boards", "host"]
    command += ["--pace", "0", "--wait"]
    with subprocess.Popen([*command, *files, "--json"], stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        json.loads(process.stdout.readline())
        # Its lines of truth are read on, or it would wait for the reader.
        with subprocess.Popen(["cat"], stdin=process.stdout, stdout=subprocess.DEVNULL) as reader:
            yield tmp_path
            process.terminate()
            process.wait()
            reader.wait()


def schema(name):
    return json.loads((ROOT / f"docs/schema/{name}.schema.json").read_text())


def calibrate(directory, capsys, *more):
    site, out = directory / "site.toml", directory / "calibrated.toml"
    words = ["calibrate", "sensor", "--port", str(directory / "port"), "--site", str(site), "--seconds", "20"]
    assert (
        main([*words, "--out", str(out), "--sensors", str(directory / "sensors.toml"), "--json", "--force", *more]) == 0
    )
    return json.loads(capsys.readouterr().out)


def test_a_sensor_is_calibrated_and_its_board_told(bench, capsys):
    """Gains and axes as exact as is said; the board that was told reads the field itself; the file gives it the same.

    Which seconds are read depends on when the command starts: errors are held to the deviations, and these to 1e-3.
    """
    true_site = (bench / "true.toml").read_text()
    true = tomllib.loads(true_site)["sensor"]["axes"]
    true_offset_T = np.array(json.loads(re.search(r"# The sensor reads (\[.*\]) T", true_site)[1]))
    assert np.abs(np.subtract(true, np.eye(3))).max() > 5e-3
    told = calibrate(bench, capsys, "--write")
    jsonschema.validate(told, schema("sensor_calibration"))
    assert (told["status"], told["written"]) == ("ok", True)
    assert np.max(told["axes_sd"]) < 1e-3
    assert np.all(np.abs(np.subtract(told["axes"], true)) <= 5.0 * np.array(told["axes_sd"]))
    assert np.all(np.abs(told["offset_T"] - true_offset_T) < 5.0 * np.array(told["offset_sd_T"]))
    assert "axes" not in tomllib.loads((bench / "calibrated.toml").read_text())["sensor"]

    again = calibrate(bench, capsys)
    assert not again["written"]
    assert np.all(np.abs(np.subtract(again["axes"], np.eye(3))) <= 5.0 * np.hypot(told["axes_sd"], again["axes_sd"]))
    both_sd_T = np.hypot(told["offset_sd_T"], again["offset_sd_T"])
    assert np.all(np.abs(again["offset_T"]) < 5.0 * both_sd_T)
    assert both_sd_T.max() < 0.1 * np.abs(true_offset_T).max()
    written = tomllib.loads((bench / "calibrated.toml").read_text())["sensor"]
    np.testing.assert_array_equal(written["axes"], again["axes"])
    # The mains leave a part in the beacons' fields that looks like a common gain: the deviation has to tell of it.
    assert written["gain_sd"] == again["gain_sd"] < 1e-3
    gain = np.diag(again["axes"]) - 1.0
    assert np.abs(gain).max() < 4.0 * np.hypot(told["gain_sd"], again["gain_sd"])
    _is_restored(bench, capsys, told["unique_id"])


def _is_restored(directory, capsys, unique_id):
    """What is kept of a board goes to it again, and to no other."""
    sensors, port = directory / "sensors.toml", ["--port", str(directory / "port")]
    (kept,) = tomllib.loads(sensors.read_text())["sensor"]
    assert kept["unique_id"] == unique_id
    assert main(["nodes", *port, "set", "100", "zero_x", "2000"]) == 0
    assert main(["calibrate", "restore", *port, "--sensors", str(sensors)]) == 0
    assert "written to board" in capsys.readouterr().out
    assert main(["nodes", *port, "get", "100", "zero_x", "--json"]) == 0
    value = json.loads(capsys.readouterr().out)["values"][0]
    assert value == pytest.approx(kept["zero"][0], rel=1e-6)
    sensors.write_text(sensors.read_text().replace(unique_id, "0" * 24))
    assert main(["calibrate", "restore", *port, "--sensors", str(sensors)]) == 2
    assert f"has no values for the board {unique_id} (node 100): calibrate it" in capsys.readouterr().err
