"""Runs compared: what is bit-identical is said, what is not is found, and how far off."""

import json
import math

import numpy as np
import pytest

from goldfield.cli import main
from tests.host.fake_sensor import SITE, heartbeat, log_of

CYCLES = 12


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    log, kept = folder / "a.log", folder / "a.mcap"
    log.write_text(log_of(range(CYCLES), [heartbeat()]))
    assert main(["run", "--log", str(log), "--site", str(SITE), "--json", "--record", str(kept)]) == 0
    return kept


@pytest.fixture
def lines(recorded, capsys):
    capsys.readouterr()
    assert main(["run", "--log", str(recorded), "--site", str(SITE), "--json"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def written(path, lines):
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    return str(path)


def compared(capsys, *words):
    code = main(["compare-runs", *map(str, words)])
    return code, capsys.readouterr()


def test_todays_estimator_makes_the_recorded_poses_bit_by_bit(recorded, capsys):
    code, said = compared(capsys, recorded, "--exact")
    assert (code, said.out) == (0, f"bit-identical: all {CYCLES} poses that both have\n")


def test_a_last_bit_that_differs_is_found(recorded, lines, tmp_path, capsys):
    lines[3]["position_m"][1] = float(np.nextafter(lines[3]["position_m"][1], 9.0))
    code, said = compared(capsys, written(tmp_path / "b.jsonl", lines), recorded, "--exact")
    assert code == 3
    assert f"{CYCLES - 1} of {CYCLES} poses that both have are bit-identical" in said.out


def test_distances_angles_and_statuses_are_told(recorded, lines, tmp_path, capsys):
    half = 0.5 * math.radians(3.0)
    turn = np.array([0.0, 0.0, math.sin(half), math.cos(half)])
    lines[5]["position_m"][2] += 0.004
    x, y, z, w = lines[7]["orientation_xyzw"]
    a, b, c, d = turn
    product = [d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x, d * z + a * y - b * x + c * w]
    lines[7]["orientation_xyzw"] = [*product, d * w - a * x - b * y - c * z]
    lines[7]["status"] = "weak"
    summary = tmp_path / "summary.json"
    code, said = compared(
        capsys, recorded, written(tmp_path / "b.jsonl", lines), "--json", "--summary", summary, "--exact"
    )
    assert code == 3
    each = [json.loads(line) for line in said.out.splitlines()]
    assert [one["identical"] for one in each] == [number not in (5, 7) for number in range(CYCLES)]
    assert each[5]["position_m"] == pytest.approx(0.004)
    sd_m = math.sqrt(np.trace(lines[5]["position_cov_m2"]))
    assert each[5]["deviations"] == pytest.approx(0.004 / sd_m)
    assert each[7]["attitude_rad"] == pytest.approx(math.radians(3.0))
    told = json.loads(summary.read_text())
    assert told["largest"]["epoch"] == lines[5]["epoch"]
    assert told["rms_m"] == pytest.approx(0.004 / math.sqrt(CYCLES))
    assert told["statuses"] == {"ok -> weak": 1}
    assert (told["bit_identical"], told["identical"], told["common"]) == (False, CYCLES - 2, CYCLES)
    assert "1 were ok and are weak" in said.err


def test_poses_that_one_run_lacks_are_counted(recorded, lines, tmp_path, capsys):
    short = written(tmp_path / "b.jsonl", [*lines[:4], *lines[5:-2]])
    code, said = compared(capsys, short, recorded, "--exact")
    assert code == 3
    assert f"1 pose is only in {recorded}\n2 poses are only in {recorded} at its end" in said.out
    # What a run did not read on to is no difference.
    assert compared(capsys, written(tmp_path / "c.jsonl", lines[:-2]), recorded, "--exact")[0] == 0
    assert compared(capsys, recorded, written(tmp_path / "d.jsonl", lines[:-2]), "--exact")[0] == 3


def test_runs_of_other_times_are_not_compared(recorded, lines, tmp_path, capsys):
    later = [line | {"t_s": line["t_s"] + 0.01} for line in lines]
    code, said = compared(capsys, recorded, written(tmp_path / "b.jsonl", later))
    assert code == 0
    assert "no pose of the same time: nothing can be compared" in said.out


def test_a_changed_site_changes_todays_poses(recorded, tmp_path, capsys):
    text = SITE.read_text()
    site = tmp_path / "site.toml"
    site.write_text(text.replace("position_m = [2.13,", "position_m = [2.14,", 1))
    assert site.read_text() != text
    code, said = compared(capsys, recorded, "--site", site, "--exact")
    assert code == 3
    assert f"0 of {CYCLES} poses that both have are bit-identical" in said.out
    assert "distance:" in said.out


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        ("", "is empty: give a recording"),
        ("(1.0) can0 00000064#00\n", "holds no poses: give --site FILE, with which they are made of its messages"),
        ('{"epoch": 1}\n', ":1: is no line of goldfield run --json: keys are missing"),
        ("{\n", ":1: is no line of goldfield run --json"),
    ],
)
def test_what_is_no_run_is_told(tmp_path, capsys, content, complaint):
    path = tmp_path / "x"
    path.write_text(content)
    code, said = compared(capsys, path, path)
    assert code == 2
    assert complaint in said.err


def test_lines_of_json_cannot_be_made_again(lines, tmp_path, capsys):
    code, said = compared(capsys, written(tmp_path / "b.jsonl", lines))
    assert code == 2
    assert said.err.count("\n") == 1
