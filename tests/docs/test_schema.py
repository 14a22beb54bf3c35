"""The JSON schemas in docs/schema against what the commands print."""

from __future__ import annotations

import json
from pathlib import Path

import jsonschema
import pytest

from goldfield.cli import main
from goldfield.types import Status
from hil_sim.clib import ROOT
from tests.host.cli.test_tables import fields_table, samples_table
from tests.host.fake_sensor import SITE, heartbeat, log_of

SCHEMAS = sorted((ROOT / "docs/schema").glob("*.json"))


def validator(name: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json.loads((ROOT / f"docs/schema/{name}.schema.json").read_text()))


def lines_of(capsys: pytest.CaptureFixture[str]) -> list[dict[str, object]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("path", SCHEMAS, ids=lambda path: path.stem)
def test_schema_is_one_and_has_a_version(path: Path) -> None:
    schema = json.loads(path.read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    name = path.name.removesuffix(".schema.json")
    assert schema["$id"].rpartition(":")[0] == f"urn:goldfield:{name}"
    assert int(schema["$id"].rpartition(":")[2]) >= 1
    assert all("description" in value for value in schema["properties"].values())


def test_statuses_are_those_of_poses() -> None:
    assert validator("pose").schema["properties"]["status"]["enum"] == [status.value for status in Status]


def test_locate_prints_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "fields.csv"
    rows = fields_table(2)
    path.write_text("\n".join(rows[:9] + rows[9:11]))  # the second epoch has too few beacons: it fails
    assert main(["locate", "--site", str(SITE), str(path), "--json"]) == 0
    found, failed = lines_of(capsys)
    assert (found["status"], failed["status"]) == ("ok", "failed")
    for line in (found, failed):
        validator("pose").validate(line)


def test_run_prints_poses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "run.log"
    log.write_text("".join(log_of(range(3), [heartbeat()]).splitlines(keepends=True)[:-1]))  # the last message is lost
    assert main(["run", "--log", str(log), "--site", str(SITE), "--json"]) == 0
    lines = lines_of(capsys)
    assert len(lines) == 3
    for line in lines:
        validator("pose").validate(line)
    assert lines[-1]["lost"] == 1


def test_run_writes_a_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, path = tmp_path / "run.log", tmp_path / "summary.json"
    lines = log_of(range(3), [heartbeat()]).splitlines(keepends=True)
    log.write_text("".join([*lines[:-1], "(9.0) can0 123#11\n", "(9.1) can0 456#\n"]))
    words = ["run", "--log", str(log), "--site", str(SITE), "--summary", str(path)]
    assert main([*words, "--json"]) == 0
    assert len(lines_of(capsys)) == 3
    (summary,) = [json.loads(line) for line in path.read_text().splitlines()]
    validator("summary").validate(summary)
    assert (summary["epochs"], summary["statuses"], summary["lost"]) == (3, {"ok": 3}, 1)
    assert summary["link"] == {"frames with 11-bit identifiers": 2}
    assert main(words) == 2, "it is not overwritten"
    assert "--force" in capsys.readouterr().err


@pytest.mark.parametrize("options", [[], ["--mains", "50"], ["--unknown-rise"]])
def test_separate_prints_cycles(options: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "samples.csv"
    path.write_text("\n".join(samples_table()))
    assert main(["separate", "--site", str(SITE), str(path), "--json", *options]) == 0
    (line,) = lines_of(capsys)
    validator("cycle").validate(line)
    assert ("mains_Hz" in line, "tau_s" in line["fields"][0]) == ("--mains" in options, "--unknown-rise" in options)


def test_plan_prints_a_room(capsys: pytest.CaptureFixture[str]) -> None:
    box = ["--box", "0", "0", "0", "40", "1", "1", "--step", "2", "--workers", "1"]  # parts of it are out of hearing
    assert main(["plan", "--site", str(SITE), *box, "--json"]) == 0
    (line,) = lines_of(capsys)
    validator("plan").validate(line)
    assert 0.0 < line["weak"] < 1.0
    assert line["position_m"].keys() == {"median", "p95", "worst"}


def test_hil_prints_a_bench_and_its_truth(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["hil", "anchors4", "--boards", "host", "--can", "none", "--pace", "0", "--seconds", "0.5", "--json"]
    assert main(command) == 0
    bench, *truth = lines_of(capsys)
    validator("bench").validate(bench)
    assert set(bench["anchors"]) == {"a1", "a2", "a3", "a4"}
    assert truth
    for line in truth:
        validator("truth").validate(line)
