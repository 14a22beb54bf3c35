"""``goldfield calibrate`` on tables, and what it says when it is called wrongly."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from goldfield.cli import calibrations, main
from goldfield.cli.board_calibration import BoardCalibration
from goldfield.sensor.fields_table import FieldsWriter
from hil_sim import scenario
from hil_sim.clib import ROOT
from tests.host.calibration.test_coils import PLACE_M, TAUS_US, samples
from tests.host.calibration.turning import record

ID = "0102030405060708090a0b0c"


def schema(name):
    return json.loads((ROOT / f"docs/schema/{name}.schema.json").read_text())


@pytest.fixture
def turned(tmp_path):
    """Write a table of fields of a turned sensor and its site; return the truth."""
    recording = record(tmp_path, 1, cycles=60)
    with FieldsWriter(tmp_path / "fields.csv", live=False) as writer:
        for fields in recording.turn.fields(recording.site):
            writer.write(fields)
    return recording


@pytest.fixture
def chips(tmp_path):
    """Write a table of samples and its site; the coil of b3 is reversed."""
    bench = scenario.load_scenario("prigge8")
    (tmp_path / "site.toml").write_text(scenario.site_toml(bench))
    signs = np.array([1, 1, -1, 1, 1, 1, 1, 1])
    rows = samples(bench, taus_us=TAUS_US, signs=signs, cycles=2).reshape(-1, 3).tolist()
    lines = ["chip,bx_T,by_T,bz_T", *(f"{row},{x!r},{y!r},{z!r}" for row, (x, y, z) in enumerate(rows))]
    (tmp_path / "samples.csv").write_text("\n".join(lines) + "\n")
    return [str(tmp_path / "samples.csv"), "--site", str(tmp_path / "site.toml")]


def test_a_table_of_fields_gives_axes_and_no_offset(turned, tmp_path, capsys):
    out, sensors = tmp_path / "new.toml", tmp_path / "sensors.toml"
    words = ["calibrate", "sensor", "--site", str(tmp_path / "site.toml"), "--fields", str(tmp_path / "fields.csv")]
    more = ["--out", str(out), "--sensors", str(sensors), "--unique-id", ID, "--json"]
    assert main([*words, *more]) == 0
    found = json.loads(capsys.readouterr().out)
    jsonschema.validate(found, schema("sensor_calibration"))
    assert found["offset_T"] is None
    assert np.abs(found["axes"] - turned.axes).max() < 1e-3
    assert tomllib.loads(out.read_text())["sensor"]["axes"] == found["axes"]
    assert tomllib.loads(sensors.read_text())["sensor"][0]["unique_id"] == ID
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "weak: the offset is not known" in text
    assert all(len(line) <= 120 for line in text.splitlines())


def test_coils(chips, tmp_path, capsys):
    out = tmp_path / "new.toml"
    place = [str(value) for value in PLACE_M]
    assert main(["calibrate", "coils", *chips, "--at", *place, "--out", str(out), "--json"]) == 0
    lines = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    for line in lines:
        jsonschema.validate(line, schema("coil_calibration"))
    assert [line["beacon"] for line in lines if line["reversed"]] == ["b3"]
    beacons = tomllib.loads(out.read_text())["beacon"]
    assert [beacon["current_A"] for beacon in beacons] == [10.0, 10.0, -10.0, 10.0, 10.0, 10.0, 10.0, 10.0]
    assert beacons[6]["tau_s"] == pytest.approx(200e-6, rel=0.1)
    assert "tau_s" not in beacons[0]
    assert main(["calibrate", "coils", *chips, "--at", *place]) == 0
    told = capsys.readouterr().out.splitlines()
    assert told[3].endswith("reversed")
    assert told[7].split()[0] == "b7"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["sensor", "--log", "x.log"], "--site is missing"),
        (["sensor", "--site", "s.toml"], "no source is given: give one of --port PATH, --can INTERFACE:CHANNEL and"),
        (["sensor", "--site", "s.toml", "--log", "x.log", "--write"], "--write needs the board: give --port or --can"),
        (
            ["sensor", "--site", "s.toml", "--log", "x", "--sensors", "f"],
            "--sensors needs --unique-id with a recording",
        ),
        (["sensor", "--site", "s.toml", "--log", "x", "--unique-id", "12"], "'12' is no unique id: 24 hexadecimal"),
        (["restore", "--port", "p"], "the following arguments are required: --sensors"),
        ([], "the following arguments are required: sensor|coils|restore"),
    ],
)
def test_what_is_wrong_is_said(words, complaint, capsys):
    try:
        code = main(["calibrate", *words])
    except SystemExit as end:
        code = end.code
    assert code == 2
    assert complaint in capsys.readouterr().err


@pytest.fixture
def board(turned, tmp_path, monkeypatch):
    """A board whose sensor is turned as the fixture `turned` was; return what it was set to, and the command line."""
    written = []
    before = BoardCalibration(100, ID, np.zeros(3), np.eye(3))
    monkeypatch.setattr(calibrations, "_record", lambda *_: (100, turned.turn))
    monkeypatch.setattr(calibrations.board_calibration, "read", lambda *_: before)
    monkeypatch.setattr(calibrations.board_calibration, "write", lambda *told: written.append(told))
    files = ["--out", str(tmp_path / "new.toml"), "--sensors", str(tmp_path / "sensors.toml")]
    return written, ["calibrate", "sensor", "--port", "p", "--site", str(tmp_path / "site.toml"), *files, "--json"]


@pytest.mark.parametrize(
    ("weak", "more", "code", "times"),
    [("turn it further", [], 3, 0), ("turn it further", ["--accept-weak"], 0, 1), (None, [], 0, 1)],
)
def test_a_weak_calibration_is_not_written_unasked(board, tmp_path, monkeypatch, capsys, weak, more, code, times):
    written, words = board
    judged = calibrations.calibrate_sensor
    monkeypatch.setattr(calibrations, "calibrate_sensor", lambda *given: replace(judged(*given), weak=weak))
    assert main([*words, "--write", *more]) == code
    told = capsys.readouterr()
    assert json.loads(told.out)["written"] is bool(times)
    assert len(written) == times
    assert [(tmp_path / name).exists() for name in ("new.toml", "sensors.toml")] == [bool(times)] * 2
    if code:
        assert "weak: neither the board nor a file was written" in told.err
        assert told.err.count("\n") == 1


def test_accept_weak_alone_has_no_effect(turned, tmp_path, capsys):
    words = ["calibrate", "sensor", "--site", str(tmp_path / "site.toml"), "--fields", str(tmp_path / "fields.csv")]
    assert main([*words, "--accept-weak"]) == 0
    assert "--accept-weak has no effect with" in capsys.readouterr().err
