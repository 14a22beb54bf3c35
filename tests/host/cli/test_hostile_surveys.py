"""Hostile input of the commands that find out instead of assume: survey, plan and calibrate.

As in `test_hostile`: one sentence, never a traceback, never an answer that rests on what cannot be.
"""

import re

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.errors import UserError
from goldfield.planning import Grid
from goldfield.sensor.fields_table import FieldsWriter, read_fields
from goldfield.survey import SurveyData, survey
from goldfield.survey.data import AnchorFields, Distance, KnownPoint
from tests.bench.integrity_sites import text_of
from tests.bench.survey_trials import ASTRAY, cube, trial
from tests.host.calibration.turning import record
from tests.host.cli.test_hostile import GOOD_SITE, SAMPLES, check_refused, outcome
from tests.host.cli.test_plan import BOX, LATTICE


@pytest.fixture(scope="module")
def turned(tmp_path_factory):
    """A folder with the site and the fields of a sensor that is turned."""
    folder = tmp_path_factory.mktemp("turned")
    recording = record(folder, 1, cycles=60)
    with FieldsWriter(folder / "fields.csv", live=False) as table:
        for fields in recording.turn.fields(recording.site):
            table.write(fields)
    return folder


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """A folder with a site, the fields of a short walk, and what an anchor measured."""
    folder = tmp_path_factory.mktemp("walked")
    made = trial(cube(), 1, epochs=20, points=4, anchors=True)
    (folder / "site.toml").write_text(text_of(made.site, ASTRAY))
    for name, epochs in (("fields.csv", made.data.epochs), ("b3.csv", [made.data.anchors[3].fields])):
        with FieldsWriter(folder / name) as table:
            for fields in epochs:
                table.write(fields)
    return folder


def changed(table, out, change):
    """Write a table with its cells changed, row by row; None leaves the row out."""
    header, *rows = table.read_text().splitlines()
    rows = [change(row.split(",")) for row in rows]
    out.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows if row is not None)]) + "\n")
    return out


WRONG_FIELDS = {
    "a dead axis": lambda c: [*c[:4], "0.0", *c[5:]],
    "too large": lambda c: [*c[:3], *(1e3 * float(x) for x in c[3:6]), *c[6:]],
    "far too large": lambda c: [*c[:3], "0.9", "0.9", "0.9", *c[6:]],
}


@pytest.mark.parametrize("wrong", WRONG_FIELDS)
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_sensor_is_not_calibrated_from_wrong_fields(turned, tmp_path, capsys, wrong):
    fields = changed(turned / "fields.csv", tmp_path / "f.csv", WRONG_FIELDS[wrong])
    told = check_refused(
        capsys, ["calibrate", "sensor", "--site", turned / "site.toml", "--fields", fields], codes=(2, 3)
    )
    assert any(part in told for part in ("the best fit leaves", "reads almost nothing", "more than a sensor measures"))


NO_WALKS = {
    "zeros": (lambda c: [*c[:3], "0", "0", "0", *c[6:]], "do not stand out of their noise"),
    "teslas taken for microteslas": (lambda c: [*c[:3], *(1e-6 * float(x) for x in c[3:6]), *c[6:]], "in tesla"),
    "one beacon": (lambda c: c if c[2] == "b0" else None, "of more than 1 beacon: "),
    "two beacons": (lambda c: c if c[2] in ("b0", "b7") else None, "of more than 2 beacons: "),
}


@pytest.mark.parametrize("walk", NO_WALKS)
def test_nothing_is_surveyed_from_fields_that_tell_nothing(walked, tmp_path, capsys, walk):
    change, words = NO_WALKS[walk]
    fields = changed(walked / "fields.csv", tmp_path / "f.csv", change)
    told = check_refused(capsys, ["survey", "--site", walked / "site.toml", fields, "--out", tmp_path / "new.toml"])
    assert words in told
    assert not (tmp_path / "new.toml").exists()


SENSORS = {
    "axes = [[1, 0, 0]]": "axes has 1 row: a survey takes a sensor of three axes",
}


@pytest.mark.parametrize("line", SENSORS)
def test_a_sensor_that_a_survey_does_not_model_is_refused(walked, tmp_path, capsys, line):
    site = tmp_path / "site.toml"
    site.write_text((walked / "site.toml").read_text().replace("[sensor]", f"[sensor]\n{line}"))
    words = ["survey", "--site", site, walked / "fields.csv", "--out", tmp_path / "new.toml"]
    assert SENSORS[line] in check_refused(capsys, words)


@pytest.mark.parametrize("other", ["b3", "b4"])
def test_an_anchor_is_given_once(walked, tmp_path, capsys, other):
    table = walked / "b3.csv"
    words = ["survey", "--site", walked / "site.toml", walked / "fields.csv", "--out", tmp_path / "new.toml"]
    told = check_refused(capsys, [*words, "--anchor", f"b3={table}", "--anchor", f"{other}={table}"])
    assert "twice: give the table of each anchor's own sensor, once" in told


SITE_LINES = {
    "position_sd_m = 1e-300": "nothing is known so well: write 0",
    "[metal]\n[[metal.body]]\nposition_m = PLACE\npolarisability_A_m2_T = [1, 1, 1, 0, 0, 0]": "the centre of a beacon",
}


@pytest.mark.parametrize("lines", SITE_LINES)
def test_a_site_that_cannot_be_is_refused(tmp_path, capsys, lines):
    place = re.search(r"position_m = (.*)", GOOD_SITE)[1]
    (tmp_path / "site.toml").write_text(GOOD_SITE + "\n" + lines.replace("PLACE", place) + "\n")
    assert SITE_LINES[lines] in check_refused(capsys, ["locate", "--site", tmp_path / "site.toml", "fields.csv"])


@pytest.mark.parametrize("value", ["0", "1e-6"])
def test_no_time_constant_is_told_of_samples_without_a_beacon(tmp_path, capsys, value):
    rows = [f"{chip},{value},{value},{value}" for chip in range(1023)]
    (tmp_path / "samples.csv").write_text("\n".join([SAMPLES[0], *rows]) + "\n")
    (tmp_path / "site.toml").write_text(GOOD_SITE)
    words = ["calibrate", "coils", tmp_path / "samples.csv", "--site", tmp_path / "site.toml"]
    assert "no beacon is heard in the samples" in check_refused(capsys, words)


MILLIMETRES = {
    "spacing_m": ("spacing_m = [1.7, 1.7]", "spacing_m = [2500, 2500]", "that is 2.5 m"),
    "radius_m": ("radius_m = 0.149", "radius_m = 149", "that is 0.149 m"),
    "current_A": ("current_A = 10.0", "current_A = 10001", "that is 10.001 A"),
    "noise_T": ("noise_T = 2e-8", "noise_T = 0.2", "milligauss, that is 2e-08 T"),
    "height_m": ("height_m = 2.7", "height_m = 2700", "from the nearest beacon, where none is heard: give metres"),
    "a deviation": ("noise_T", "gain_sd = 1e-300\nnoise_T", "nothing is known so well"),
}


@pytest.mark.parametrize("key", MILLIMETRES)
def test_a_lattice_in_other_units_is_refused(tmp_path, capsys, key):
    old, new, words = MILLIMETRES[key]
    (tmp_path / "lattice.toml").write_text(LATTICE.replace(old, new))
    assert words in check_refused(capsys, ["plan", "--lattice", tmp_path / "lattice.toml", *BOX, "--workers", "1"])


def test_an_unusual_lattice_is_told(tmp_path, capsys):
    (tmp_path / "lattice.toml").write_text(LATTICE.replace("radius_m = 0.149", "radius_m = 14.9"))
    code, captured = outcome(capsys, ["plan", "--lattice", tmp_path / "lattice.toml", *BOX, "--workers", "1"])
    assert code == 0
    assert "14.9 m, which is unusual; if it is in millimetres" in captured.err


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("step", ["1e-300", "1e-5"])
def test_a_grid_of_too_many_points_is_refused(tmp_path, capsys, step):
    (tmp_path / "lattice.toml").write_text(LATTICE)
    words = ["plan", "--lattice", tmp_path / "lattice.toml", *BOX[:-1], step]
    assert "points in the box: at most" in check_refused(capsys, words)


ID = "0102030405060708090a0b0c"
PLACES = ["nowhere/new", "folder", "x" * 300, "a\0b"]
WRITERS = {
    "the site of survey": ["survey", "--site", "site.toml", "fields.csv", "--out"],
    "the site of calibrate sensor": ["calibrate", "sensor", "--site", "site.toml", "--fields", "fields.csv", "--out"],
    "the kept sensor": ["calibrate", "sensor", "--site", "site.toml", "--fields", "x", "--unique-id", ID, "--sensors"],
    "the site of calibrate coils": ["calibrate", "coils", "fields.csv", "--site", "site.toml", "--out"],
    "the map": ["plan", "--site", "site.toml", *BOX, "--out"],
    "the better site": ["plan", "--site", "site.toml", *BOX, "--optimise", "site.toml", "--site-out"],
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("writer", WRITERS)
def test_a_place_that_cannot_be_written_is_told_before_the_work(tmp_path, monkeypatch, capsys, writer, place):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "site.toml").write_text("no site: whoever reads it says so")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder.png").mkdir()
    end = ".png" if writer == "the map" else ""
    assert "cannot be written" in check_refused(capsys, [*WRITERS[writer], place + end])


def test_a_broken_file_of_sensors_is_told_before_the_work(turned, tmp_path, capsys):
    (tmp_path / "sensors.toml").write_text("no sensors")
    words = ["calibrate", "sensor", "--site", tmp_path / "nowhere.toml", "--fields", turned / "fields.csv"]
    more = ["--unique-id", ID, "--sensors", tmp_path / "sensors.toml"]
    assert "sensors.toml: is no valid TOML" in check_refused(capsys, [*words, *more])


MISUSES = {
    "a point of no epoch": {"points": (KnownPoint(999, np.zeros(3), 0.01),)},
    "a point without deviation": {"points": (KnownPoint(0, np.zeros(3), 0.0),)},
    "a point in the plane": {"points": (KnownPoint(0, np.zeros(2), 0.01),)},
    "a distance to no beacon": {"known": (Distance(("b0", "zz"), 1.0, 0.1),)},
    "a distance without deviation": {"known": (Distance(("b0", "b1"), 1.0, 0.0),)},
}


@pytest.mark.parametrize("misuse", MISUSES)
def test_data_that_cannot_be_surveyed_are_refused(walked, misuse):
    site = sites.load(walked / "site.toml")
    epochs = tuple(read_fields(site, walked / "fields.csv"))
    with pytest.raises(UserError, match="of SurveyData"):
        survey(site, SurveyData(epochs, **MISUSES[misuse]))
    with pytest.raises(UserError, match='of SurveyData name "zz"'):
        survey(site, SurveyData(epochs, anchors=(AnchorFields("zz", epochs[0]),)))


GRIDS = [([np.nan] * 3, 1.0), ([0.0, 0.0], 1.0), ([0.0] * 3, 0.0), ([0.0] * 3, -1.0)]


@pytest.mark.parametrize(("low_m", "step_m"), GRIDS)
def test_a_grid_that_is_none_is_refused(low_m, step_m):
    with pytest.raises(UserError, match=r"box|step"):
        Grid.of_box(np.array(low_m), np.ones(3), step_m)
