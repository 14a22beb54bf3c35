"""Tables of a run hold what its lines say, to the last bit, in each format."""

import csv
import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from pyarrow import parquet

from goldfield.cli import main
from goldfield.cli.export import FORMATS
from goldfield.foxglove.topics import LINE
from goldfield.recording.tables import WRITERS
from tests.host.fake_sensor import SITE, heartbeat, log_of

CYCLES = 8
NAMES = {"position_m": ["x_m", "y_m", "z_m"], "orientation_xyzw": ["qx", "qy", "qz", "qw"]}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    log = folder / "a.log"
    log.write_text(log_of(range(CYCLES), [heartbeat()]))
    words = ["run", "--log", str(log), "--site", str(SITE), "--json", "--record", str(folder / "a.mcap")]
    assert main(words) == 0
    return folder / "a.mcap", log


@pytest.fixture
def lines(recorded, capsys):
    capsys.readouterr()
    assert main(["run", "--log", str(recorded[1]), "--site", str(SITE), "--json"]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def exported(run, out, *words):
    assert main(["export", str(run), "--out", str(out), *map(str, words)]) == 0
    return out


def test_every_format_that_is_offered_is_written():
    assert tuple(WRITERS) == FORMATS


def test_csv_and_parquet_hold_the_lines(recorded, lines, tmp_path):
    with exported(recorded[0], tmp_path / "a.csv", "--to", "csv").open() as file:
        as_text = list(csv.DictReader(file))
    as_parquet = parquet.read_table(exported(recorded[0], tmp_path / "a.parquet", "--to", "parquet")).to_pylist()
    assert len(as_text) == len(as_parquet) == CYCLES
    for text, row, line in zip(as_text, as_parquet, lines, strict=True):
        assert (row["epoch"], row["t_s"], row["status"]) == (line["epoch"], line["t_s"], line["status"])
        assert text["epoch"] == str(line["epoch"])
        for key, names in NAMES.items():
            assert [row[name] for name in names] == [float(text[name]) for name in names] == line[key]
        assert row["cov_xy_m2"] == float(text["cov_xy_m2"]) == line["position_cov_m2"][0][1]
        assert row["residual_b3"] == float(text["residual_b3"]) == line["beacons"]["b3"]
        assert text["used"] == ",".join(line["used"])
        assert row["unix_s"] < row["arrived_s"]


def test_npz_holds_poses_and_fields(recorded, lines, tmp_path):
    found = np.load(exported(recorded[0], tmp_path / "a.npz", "--to", "npz"))
    for key in ("position_m", "orientation_xyzw", "position_cov_m2", "attitude_cov_rad2", "residual"):
        assert np.array_equal(found[key], np.array([line[key] for line in lines]))
    assert found["beacons"].tolist() == list(lines[0]["beacons"])
    assert found["residuals"][2].tolist() == list(lines[2]["beacons"].values())
    assert len(found["fields_bx_T"]) == CYCLES * len(found["beacons"])


def test_the_fields_of_a_recording_give_its_poses(recorded, lines, tmp_path, capsys):
    table = exported(recorded[0], tmp_path / "f.csv", "--to", "csv", "--table", "fields")
    capsys.readouterr()
    assert main(["locate", "--site", str(SITE), str(table), "--json"]) == 0
    located = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [line["position_m"] for line in located] == [line["position_m"] for line in lines]


def test_a_log_of_messages_and_lines_of_json_are_runs_too(recorded, lines, tmp_path):
    kept = tmp_path / "b.jsonl"
    kept.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    of_log = np.load(exported(recorded[1], tmp_path / "c.npz", "--to", "npz", "--site", SITE))
    of_json = np.load(exported(kept, tmp_path / "d.npz", "--to", "npz"))
    of_mcap = np.load(exported(recorded[0], tmp_path / "e.npz", "--to", "npz", "--again"))
    for found in (of_log, of_json, of_mcap):
        assert np.array_equal(found["position_m"], np.array([line["position_m"] for line in lines]))
    assert "fields_bx_T" not in of_json.files


def test_what_is_not_known_is_empty(lines, tmp_path):
    unknown = {key: None for key in ("position_m", "orientation_xyzw", "position_cov_m2", "attitude_cov_rad2")}
    failed = lines[0] | unknown | {"status": "failed", "residual": None, "beacons": {"b9": 2.0}, "reason": "why, so"}
    kept = tmp_path / "b.jsonl"
    kept.write_text(f"{json.dumps(lines[1])}\n{json.dumps(failed)}\n")
    with exported(kept, tmp_path / "b.csv", "--to", "csv").open() as file:
        first, second = csv.DictReader(file)
    assert (second["x_m"], second["residual"], second["residual_b1"], first["residual_b9"]) == ("", "", "", "")
    assert (second["residual_b9"], second["reason"]) == ("2", "why, so")
    rows = parquet.read_table(exported(kept, tmp_path / "b.parquet", "--to", "parquet")).to_pylist()
    assert rows[1]["x_m"] is None


def test_the_place_of_a_table_and_what_is_wrong(recorded, tmp_path, capsys, monkeypatch):
    run = tmp_path / "a.mcap"
    run.write_bytes(recorded[0].read_bytes())
    assert main(["export", str(run), "--to", "csv"]) == 0
    assert (tmp_path / "a.csv").exists()
    assert main(["export", str(run), "--to", "csv"]) == 2
    assert "not empty" in capsys.readouterr().err
    assert main(["export", "-", "--to", "csv"]) == 2
    assert "--out is missing" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["export", str(run), "--to", "parquet"]) == 2
    assert "pip install 'goldfield[parquet]'" in capsys.readouterr().err


@pytest.mark.parametrize("again", [[], ["--again"]])
def test_a_run_is_drawn(recorded, tmp_path, again):
    """The pictures themselves are looked at by people; here it is a PNG of the stated size."""
    out = tmp_path / "a.png"
    assert main(["plot", str(recorded[0]), "--out", str(out), *again]) == 0
    assert out.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert np.frombuffer(out.read_bytes()[16:24], ">u4").tolist() == [1430, 1045]


def test_errors_are_those_against_the_truth(recorded, lines, tmp_path):
    from goldfield.recording.pictures import read
    from goldfield.recording.runs import open_run
    from goldfield.view.truth import Truth

    truth = tmp_path / "truth.jsonl"
    place, turn = [0.5, 0.25, 1.0], [0.0, 0.0, 0.0, 1.0]
    rows = [{"cycle": n, "t_s": 0.1 * n, "position_m": place, "orientation_xyzw": turn} for n in range(CYCLES)]
    truth.write_text("".join(f"{json.dumps(row)}\n" for row in rows))
    poses, errors = read(open_run(recorded[0]), Truth(truth, wait_s=0.0))
    assert len(poses) == CYCLES
    assert errors.position_m == pytest.approx(
        [np.linalg.norm(np.subtract(line["position_m"], place)) for line in lines]
    )


def test_a_picture_is_no_other_format_than_its_name_says(recorded, tmp_path, capsys):
    out = tmp_path / "a.SVG"
    assert main(["plot", str(recorded[0]), "--out", str(out)]) == 2
    assert f"--out {out}: pictures are written as PNG: give a name that ends in .png" in capsys.readouterr().err
    assert not out.exists()


def test_a_truth_of_other_cycles_is_told(recorded, tmp_path, capsys):
    row = {"t_s": 0.0, "position_m": [0.5, 0.25, 1.0], "orientation_xyzw": [0.0, 0.0, 0.0, 1.0]}
    truth = tmp_path / "truth.jsonl"
    for cycles, silent in (([], True), ([500_000], True), (range(CYCLES), False)):
        truth.write_text("".join(f"{json.dumps(row | {'cycle': cycle})}\n" for cycle in cycles))
        assert main(["plot", str(recorded[0]), "--truth", str(truth), "--out", str(tmp_path / "a.png"), "--force"]) == 0
        assert (f"{truth}: tells of none of these poses" in capsys.readouterr().err) is silent


@pytest.mark.parametrize("value", [0.8, 1e-6])
def test_a_constant_is_drawn_below_the_frame(value):
    from matplotlib.figure import Figure

    from goldfield.recording.pictures import _scaled

    axes = Figure().subplots()
    axes.plot([0.0, 1.0], [value, value])
    _scaled(axes)
    low, high = axes.get_ylim()
    assert low == 0.0
    assert 0.85 * high < value < 0.95 * high


def test_a_clock_that_jumps_far_is_drawn_in_longer_spans(lines, tmp_path):
    """A span for each second would be a thousand millions of them."""
    kept = tmp_path / "b.jsonl"
    kept.write_text("".join(f"{json.dumps(line)}\n" for line in [*lines[:3], lines[4] | {"t_s": 1e9}]))
    assert main(["plot", str(kept), "--out", str(tmp_path / "b.png")]) == 0


@pytest.mark.parametrize("size", [1.0, 20.0])
@pytest.mark.parametrize("plane", [(0, 1), (0, 2)])
def test_the_names_of_beacons_can_be_read(lines, size, plane):
    """Also of coils that hang millimetres off the one below, as after a survey: in the frame, and none on another."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from goldfield import load_site
    from goldfield.recording.pictures import _track
    from goldfield.recording.runs import Item
    from goldfield.recording.tables import PoseTable

    site = load_site(SITE)
    off = np.random.default_rng(7).uniform(-0.01, 0.01, (len(site.beacons), 3))
    moved = [replace(b, position_m=size * b.position_m + d) for b, d in zip(site.beacons, off, strict=True)]
    poses = PoseTable()
    for line in lines:
        poses.add(Item(LINE, math.nan, line))
    figure = Figure(figsize=(6.0, 4.0))
    axes = figure.subplots()
    _track(axes, poses.columns(), replace(site, beacons=tuple(moved)), plane)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    frame = axes.get_window_extent()
    boxes = [text.get_window_extent() for text in axes.texts]
    assert sorted(name for text in axes.texts for name in text.get_text().split(", ")) == [b.id for b in site.beacons]
    for number, box in enumerate(boxes):
        assert frame.x0 < box.x0
        assert box.x1 < frame.x1
        assert frame.y0 < box.y0
        assert box.y1 < frame.y1
        assert not any(box.overlaps(other) for other in boxes[:number])
