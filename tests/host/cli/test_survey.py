"""``goldfield survey``: from tables to a new site file, and what it says of bad input."""

from __future__ import annotations

import json

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.cli import main, surveying
from goldfield.errors import SystemFailure
from goldfield.sensor.fields_table import FieldsWriter
from goldfield.survey.data import Outlier
from tests.bench.integrity_sites import text_of
from tests.bench.survey_trials import ASTRAY, cube, trial
from tests.host.fake_sensor import SITE


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A folder with site.toml, fields.csv, points.csv and an anchor's table, and the truth."""
    folder = tmp_path_factory.mktemp("room")
    made = trial(cube(), 1, epochs=120, points=6, anchors=True)
    (folder / "site.toml").write_text("# The workshop, measured by pacing.\n" + text_of(made.site, ASTRAY))
    for name, epochs in (("fields.csv", made.data.epochs), ("b3.csv", [made.data.anchors[3].fields])):
        with FieldsWriter(folder / name) as table:
            for fields in epochs:
                table.write(fields)
    rows = [f"{one.epoch}," + ",".join(map(str, one.position_m)) for one in made.data.points]
    (folder / "points.csv").write_text("\n".join(["epoch,x_m,y_m,z_m", *rows]) + "\n")
    return folder, made


def arguments(folder, out, *more):
    tables = [str(folder / "fields.csv"), "--points", str(folder / "points.csv")]
    return ["survey", "--site", str(folder / "site.toml"), *tables, "--out", str(out), *more]


def test_a_new_site_file_is_written_that_locate_takes(room, tmp_path, capsys):
    folder, made = room
    out = tmp_path / "new.toml"
    assert main(arguments(folder, out, "--json", "--anchor", f"b3={folder / 'b3.csv'}")) == 0
    (line,) = capsys.readouterr().out.splitlines()
    result = json.loads(line)
    assert set(result) == {"residual_before", "residual_after", "parameters", "outliers", "advice", "metal"}
    assert result["metal"] is None
    assert result["residual_before"] > 10.0 > 1.2 > result["residual_after"]
    assert result["parameters"]["b0.x_m"].keys() == {"value", "sd", "before"}
    assert out.read_text().startswith("# The workshop, measured by pacing.\n[site]\n")
    new = sites.load(out)
    error = np.linalg.norm([b.position_m for b in new.beacons] - made.coils.position_m[0], axis=1)
    assert error.max() < 0.03
    assert new.beacons[0].position_m[0] == result["parameters"]["b0.x_m"]["value"]
    assert 0.0 < new.beacons[0].survey.position_sd_m < 0.02
    assert new.beacons[0].survey.axis_sd_rad < 0.05
    assert main(["locate", "--site", str(out), str(folder / "fields.csv"), "--json"]) == 0
    statuses = [json.loads(line)["status"] for line in capsys.readouterr().out.splitlines()]
    assert statuses.count("ok") > 100


def test_a_site_that_is_exact_is_refused_before_the_walk(tmp_path, capsys):
    out = tmp_path / "new.toml"
    assert main(["survey", "--site", str(SITE), "--port", str(tmp_path / "none"), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "everything is exact, so there is nothing to estimate" in said
    assert said.count("\n") == 1
    assert not out.exists()


def test_a_table_for_people_ends_with_advice(room, tmp_path, capsys):
    folder, _ = room
    assert main(arguments(folder, tmp_path / "new.toml", "--free", "position, axis,current")) == 0
    out = capsys.readouterr().out
    assert out.splitlines()[0].split()[:5] == ["beacon", "x_m", "y_m", "z_m", "sd_mm"]
    assert "the origin is known to" in out
    assert "measure " in out


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        (["--anchor", "b9=x.csv"], 'the site has no beacon "b9"'),
        (["--anchor", "b3"], "is no ID=FIELDS.csv"),
        (["--known", "{known}"], "tells where the sensor of b4 is, and it measured nothing: give --anchor b4=FILE"),
        (["--log", "x.log"], "FIELDS.csv and --log are both given"),
    ],
)
def test_bad_options_are_told(room, tmp_path, capsys, more, complaint):
    folder, _ = room
    known = tmp_path / "known.toml"
    known.write_text('[known]\nsensor = [{beacon = "b4", m = [0.01, 0.0, 0.0], sd_m = 0.001}]\n')
    words = [word.format(known=known) for word in more]
    assert main(arguments(folder, tmp_path / "new.toml", *words)) == 2
    assert complaint in capsys.readouterr().err


def test_options_without_effect_are_told(room, tmp_path, capsys):
    folder, _ = room
    assert main(arguments(folder, tmp_path / "new.toml", "--seconds", "20", "--enough", "0.01")) == 0
    assert "goldfield: --seconds and --enough have no effect with FIELDS.csv" in capsys.readouterr().err.splitlines()


def test_a_full_disk_does_not_lose_what_was_found(room, tmp_path, capsys, monkeypatch):
    def full(path, data, what, *, force=False):
        raise SystemFailure(f"{path}: {what} cannot be written: No space left on device")

    monkeypatch.setattr(surveying, "write_file", full)
    folder, _ = room
    assert main(arguments(folder, tmp_path / "new.toml", "--json")) == 3
    captured = capsys.readouterr()
    assert "the new site file cannot be written: No space left" in captured.err
    assert "b0.x_m" in json.loads(captured.out)["parameters"]


def test_an_unknown_kind_is_told(room, tmp_path, capsys):
    folder, _ = room
    with pytest.raises(SystemExit) as end:
        main(arguments(folder, tmp_path / "new.toml", "--free", "position,spin"))
    assert end.value.code == 2
    assert "spin is none of position, axis" in capsys.readouterr().err


def test_nothing_measured_is_told(room, tmp_path, capsys):
    folder, _ = room
    assert main(["survey", "--site", str(folder / "site.toml"), "--out", str(tmp_path / "new.toml")]) == 2
    assert "nothing was measured" in capsys.readouterr().err


def test_what_does_not_fit_is_no_new_site(room, tmp_path, capsys):
    folder, _ = room
    out = tmp_path / "new.toml"
    assert main(arguments(folder, out, "--free", "position")) == 3
    assert "no survey fits the fields" in capsys.readouterr().err
    assert not out.exists()


def test_distances_that_contradict_each_other_are_named_where_nothing_fits(room, tmp_path, capsys):
    folder, _ = room
    first, second = (beacon.id for beacon in sites.load(folder / "site.toml").beacons[:2])
    known = tmp_path / "known.toml"
    lines = [f'{{between = ["{first}", "{second}"], m = {metres}, sd_m = 0.001}}' for metres in (2.1, 9.0)]
    known.write_text(f"[known]\ndistance = [{', '.join(lines)}]\n")
    assert main(arguments(folder, tmp_path / "new.toml", "--known", str(known))) == 3
    told = capsys.readouterr().err
    assert "no survey fits the fields" in told
    assert f"the distance from {first} to {second} does not fit, by " in told


def test_outliers_that_follow_each_other_share_a_line():
    epochs = [(3, ("b1",), 2.0), (4, ("b1",), 3.5), (5, (), 2.5), (7, (), 2.25), (8, (), 4.0), (9, (), 3.0)]
    outliers = [Outlier(*one) for one in epochs]
    assert surveying.outlier_lines(outliers) == [
        "epochs 3 to 4: the fields of b1 do not agree (residual up to 3.5): left out",
        "epoch 5: the fields do not agree (residual 2.5): left out",
        "epochs 7 to 9: the fields do not agree (residual up to 4): left out",
    ]
    apart = [Outlier(2 * k, (), 2.0) for k in range(surveying.MOST_OUTLIERS + 1)]
    *named, rest = surveying.outlier_lines(apart)
    assert len(named) == surveying.MOST_OUTLIERS
    assert rest == "and 1 epoch more: left out"
    assert surveying.outlier_lines(apart[:-1]) == named
