"""A sensor whose axes read at different points: found where the data tell it, and said where they do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.cli import main
from goldfield.locate import Locator
from goldfield.sensor.fields_table import FieldsWriter
from goldfield.survey import Free, SurveyData, survey
from tests.bench.integrity_sites import Errors, text_of
from tests.bench.survey_trials import cube, fields_of, measured, trial

LEVER_M = np.array([[0.02, 0.0, -0.01], [0.0, -0.02, 0.0], [0.01, 0.01, 0.02]])
SIGMA_T = 2e-8 / np.sqrt(1023)
SOME = Errors(position_m=0.01, axis_rad=0.02, current=0.01)
FREE = frozenset((Free.POSITION, Free.AXIS, Free.CURRENT, Free.LEVER))


def read_at_levers(coils, position_m, rotation, rng):
    """Return what a sensor with levers reads: each axis at its own place."""
    each = [measured(coils, position_m + lever @ rotation, rotation, np.eye(3), SIGMA_T, rng) for lever in LEVER_M]
    return np.stack([field[..., axis] for axis, field in enumerate(each)], axis=-1)


@pytest.fixture(scope="module")
def walked():
    made = trial(cube(), 2, epochs=120, points=10, errors=SOME)
    field = read_at_levers(made.coils, made.position_m, made.rotation, np.random.default_rng(5))
    epochs = fields_of(tuple(beacon.id for beacon in made.site.beacons), field, SIGMA_T)
    return made, replace(made.data, epochs=epochs)


def levers_of(result):
    names = [f"sensor.lever_{axis}_{letter}_m" for axis in "xyz" for letter in "xyz"]
    found = [result.parameters[name] for name in names]
    return np.array([one.value for one in found]).reshape(3, 3), np.array([one.sd for one in found]).reshape(3, 3)


def rms_of(site, epochs, position_m):
    """Return the root of the mean square error of the poses' places."""
    place = np.array([pose.position_m for pose in Locator(site).locate_many(epochs)])
    return np.sqrt(np.nanmean(((place - position_m) ** 2).sum(axis=1)))


def test_levers_are_found_with_their_deviations(walked):
    made, data = walked
    result = survey(made.site, data, FREE)
    lever, sd = levers_of(result)
    assert sd.max() < 0.003
    assert (np.abs(lever - LEVER_M) < 4.0 * sd).all()
    assert result.residual_after == pytest.approx(1.0, abs=0.05)
    assert not [line for line in result.advice if "not told" in line]


def test_without_known_points_the_common_lever_is_said_to_be_untold(walked):
    made, data = walked
    result = survey(made.site, SurveyData(data.epochs), FREE)
    lever, sd = levers_of(result)
    assert any("reference point is not told" in line and "known points" in line for line in result.advice)
    assert not [line for line in result.advice if "reads beside the others" in line]
    apart, truth = lever - lever.mean(axis=0), LEVER_M - LEVER_M.mean(axis=0)
    assert np.abs(apart - truth).max() < 0.002
    assert sd.min() > 0.01


def test_one_epoch_does_not_tell_of_single_axes(walked):
    made, data = walked
    result = survey(made.site, SurveyData(data.epochs[60:61]), FREE)
    assert any("axis reads beside the others is not told" in line for line in result.advice)


def test_the_new_site_file_has_the_levers_and_locates_with_them(walked, tmp_path, capsys):
    made, data = walked
    site, fields, points, new = (tmp_path / name for name in ("site.toml", "fields.csv", "points.csv", "new.toml"))
    site.write_text(text_of(made.site, SOME))
    with FieldsWriter(fields, live=False) as table:
        for one in data.epochs:
            table.write(one)
    rows = [f"{one.epoch}," + ",".join(map(str, one.position_m)) for one in data.points]
    points.write_text("\n".join(["epoch,x_m,y_m,z_m", *rows]) + "\n")
    words = ["survey", "--site", str(site), str(fields), "--points", str(points), "--out", str(new)]
    assert main([*words, "--free", "position,axis,current,lever"]) == 0
    assert "sensor.lever_x_x_m = 0.0" in capsys.readouterr().out
    found = sites.load(new)
    assert found.sensor.lever_m is not None
    rng = np.random.default_rng(9)
    position, rotation = made.position_m[5:100:5] + 0.01, made.rotation[5:100:5]
    names = tuple(beacon.id for beacon in made.site.beacons)
    epochs = fields_of(names, read_at_levers(made.coils, position, rotation, rng), SIGMA_T)
    pointlike = replace(found, sensor=replace(found.sensor, lever_m=None))
    with_levers, without = (rms_of(site, epochs, position) for site in (found, pointlike))
    assert with_levers < 0.006
    assert without > 2.0 * with_levers
    again = tmp_path / "again.toml"
    words[2], words[-1] = str(new), str(again)
    assert main([*words, "--free", "position", "--json"]) == 0  # a site with levers is surveyed with them
    assert sites.load(again).sensor.lever_m == pytest.approx(found.sensor.lever_m)
