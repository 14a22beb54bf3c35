"""What a survey says of data and site files that are not what they are taken for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from goldfield.errors import UserError
from goldfield.survey import SurveyData, survey
from goldfield.survey.anchor_tables import ELSEWHERE, FAR_M, MISFIT, SLACK, check_anchor_tables, sensors_elsewhere
from goldfield.survey.data import AnchorFields
from goldfield.types import Fields
from tests.bench.locate_trials import magpylib_fields
from tests.bench.survey_trials import cube, trial


@pytest.fixture(scope="module")
def walked():
    return trial(cube(), 1, epochs=60, points=6, anchors=True)


def with_beacon(site, index, **changes):
    beacons = list(site.beacons)
    beacons[index] = replace(beacons[index], **changes)
    return replace(site, beacons=tuple(beacons))


def test_a_current_far_from_the_site_file_is_named_with_what_to_check(walked):
    wrong = with_beacon(walked.site, 3, current_A=0.8 * walked.site.beacons[3].current_A)
    (line,) = [line for line in survey(wrong, walked.data).advice if "from the site file" in line]
    assert line.startswith("the current of b3 is up to ")
    assert "check current_A, turns, radius_m and its driver, or allow for more in current_sd" in line


def test_a_place_far_from_the_site_file_is_named(walked):
    beacon = walked.site.beacons[5]
    wrong = with_beacon(walked.site, 5, position_m=beacon.position_m + np.array([0.9, 0.0, 0.0]))
    lines = [line for line in survey(wrong, walked.data).advice if line.startswith("the place of ")]
    assert len(lines) == 1
    assert "the place of b5 is up to" in lines[0]
    assert "check position_m" in lines[0]


def test_nothing_is_named_where_the_file_is_as_wrong_as_it_says(walked):
    assert not [line for line in survey(walked.site, walked.data).advice if "from the site file" in line]


def test_a_sensor_far_from_its_calibration_is_named(walked):
    sensor = replace(walked.site.sensor, gain_sd=1e-3, axis_sd_rad=1e-3)
    stretched = tuple(
        replace(fields, field_T=fields.field_T * np.array([1.0, 1.03, 1.0])) for fields in walked.data.epochs
    )
    result = survey(replace(walked.site, sensor=sensor), SurveyData(stretched, walked.data.points))
    assert any(line.startswith("the gain of the sensor's y axis is") and "gain_sd" in line for line in result.advice)


def test_the_same_epoch_many_times_counts_once(walked):
    few = SurveyData(walked.data.epochs[:40], tuple(p for p in walked.data.points if p.epoch < 40))
    again = tuple(replace(fields, epoch=1000 + fields.epoch, time_s=fields.time_s + 60.0) for fields in few.epochs)
    once, twice = survey(walked.site, few), survey(walked.site, replace(few, epochs=(*again, *few.epochs)))
    assert twice.deviation_m == pytest.approx(once.deviation_m, rel=1e-6)
    assert twice.advice[0].startswith("40 epochs have the very fields of another one")
    assert twice.position_m.shape == (80, 3)
    np.testing.assert_array_equal(twice.position_m[:40], twice.position_m[40:])


def test_fields_that_never_change_are_refused(walked):
    stuck = tuple(replace(walked.data.epochs[0], epoch=number) for number in range(30))
    with pytest.raises(UserError, match=r"all of 30 epochs have the same fields.* stuck"):
        survey(walked.site, SurveyData(stuck))


def test_the_table_of_another_anchor_is_refused(walked):
    first, second, *others = walked.data.anchors
    swapped = (AnchorFields(first.beacon, second.fields), AnchorFields(second.beacon, first.fields), *others)
    with pytest.raises(UserError, match="the fields of the anchor b0 are those of a sensor at b1"):
        survey(walked.site, SurveyData((), (), (), swapped))
    survey(walked.site, SurveyData((), (), (), walked.data.anchors))


def heard_above(site, distance_m, **told):
    """Return what the sensor of the first anchor hears of its own coil, on its axis as far as a dipole would be."""
    own = site.beacons[0]
    place = own.position_m + np.sqrt(distance_m**2 - own.radius_m**2) * own.axis
    field = magpylib_fields(site, place[None])[0, :1]
    return AnchorFields(own.id, Fields(0, 0.0, (own.id,), field, np.array([1e-9])), **told)


@pytest.mark.parametrize("part", [0.98, 1.02])
def test_a_sensor_that_hears_its_coil_from_afar_is_named(walked, part):
    """On the axis a field is that of the least distance that it may have, times the cube root of two."""
    anchor = heard_above(walked.site, part * FAR_M * np.cbrt(2.0))
    lines = list(sensors_elsewhere(walked.site, (anchor,)))
    assert len(lines) == (part > 1.0)
    assert all("hears its own coil as if it stood 0.31 to 0.39 m" in line for line in lines)


@pytest.mark.parametrize(("told_m", "fits"), [(0.5, True), (0.49 * SLACK, True), (0.51 * SLACK, False), (0.31, False)])
def test_a_place_that_was_told_is_compared_with_what_the_sensor_hears(walked, told_m, fits):
    anchor = heard_above(walked.site, 0.5, lever_m=np.array([0.0, told_m, 0.0]), lever_sd_m=0.002)
    lines = list(sensors_elsewhere(walked.site, (anchor,)))
    assert len(lines) == (not fits)
    assert all(f"and sensor in --known has {told_m:.2g} m: check it" in line for line in lines)


def test_without_its_own_field_an_anchor_is_not_judged(walked):
    assert not list(sensors_elsewhere(walked.site, walked.data.anchors))


@pytest.mark.parametrize("part", [0.98, 1.02])
def test_a_table_is_that_of_another_anchor_below_a_part_of_its_misfit(part):
    """The strengths lie between those at b0, whose table it is said to be, and those at b1; that of b1 is far off."""
    site = cube().site
    strength = np.log(np.linalg.norm(magpylib_fields(site, np.array([b.position_m for b in site.beacons])), axis=2))

    def between(share):
        measured = (1.0 - share) * strength[1] + share * strength[0]
        measured[1] = strength[0, 1] + 3.0
        others = np.arange(8) != np.arange(8)[:, None]
        others[:, 0] = False
        return measured, np.sqrt(np.mean((measured - strength) ** 2, axis=1, where=others))

    def excess(share):
        misfit = between(share)[1]
        return misfit[1] - part * ELSEWHERE * misfit[0]

    measured, misfit = between(brentq(excess, 0.01, 0.99))
    assert misfit.argmin() == 1
    assert misfit[0] > 1.1 * MISFIT
    names = tuple(beacon.id for beacon in site.beacons[1:])
    field = np.exp(measured[1:, None]) * np.array([0.6, 0.0, 0.8])
    table = AnchorFields("b0", Fields(0, 0.0, names, field, np.full(7, 1e-12)))
    if part < 1.0:
        with pytest.raises(UserError, match="the fields of the anchor b0 are those of a sensor at b1"):
            check_anchor_tables(site, (table,))
    else:
        check_anchor_tables(site, (table,))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (lambda made: ("x", made.data), r"takes a Site, not 'x': goldfield.load_site"),
        (lambda made: (made.site, made.data.epochs[:1]), "takes the measurements as a SurveyData"),
        (lambda made: (made.site, made.data, {"position"}), r"free= of survey\(\) is a set of Free"),
    ],
)
def test_arguments_of_other_types_are_refused_in_a_sentence(walked, arguments, words):
    with pytest.raises(UserError, match=words):
        survey(*arguments(walked))
