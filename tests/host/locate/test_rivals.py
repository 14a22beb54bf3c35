"""What is wrong with the whole sensor or site is never ok, and named: wiring, gains, units; from fields by magpylib."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.field import FieldModel
from goldfield.locate import Locator
from goldfield.locate.constellation import Constellation
from goldfield.locate.exclusion import without_one, without_two
from goldfield.locate.fit import Measurements
from goldfield.sensor.fields_table import read_fields
from goldfield.types import Explanation, Status
from tests.bench import locate_trials as bench

DATA = Path(__file__).parent / "data"


def axis(row, value):
    gains = np.ones(3)
    gains[row] = value
    return np.diag(gains)


FAULTS = {
    "x reversed": (axis(0, -1.0), Explanation.MIRRORED),
    "y reversed": (axis(1, -1.0), Explanation.MIRRORED),
    "z reversed": (axis(2, -1.0), Explanation.MIRRORED),
    "x and y swapped": (np.eye(3)[[1, 0, 2]], Explanation.MIRRORED),
    "x and z swapped": (np.eye(3)[[2, 1, 0]], Explanation.MIRRORED),
    "y and z swapped": (np.eye(3)[[0, 2, 1]], Explanation.MIRRORED),
    "all coils reversed": (-np.eye(3), Explanation.MIRRORED),
    "gain 0.8": (0.8 * np.eye(3), Explanation.STRENGTH),
    "gain 1.2": (1.2 * np.eye(3), Explanation.STRENGTH),
    "x gain 1.2": (axis(0, 1.2), Explanation.AXIS_GAIN),
    "z gain 0.8": (axis(2, 0.8), Explanation.AXIS_GAIN),
    "feet for metres": (np.eye(3) / 0.3048, Explanation.UNITS),
}


def located(site, distortion, seed, count):
    rng = np.random.default_rng(seed)
    run = bench.trials(site, bench.cube_positions(rng, count, 0.9), rng)
    truth = np.einsum("eki,enk->eni", run.rotation, bench.magpylib_fields(site, run.position_m))
    field = run.field_T - truth + truth @ distortion.T
    faulty = bench.Trials(run.position_m, run.rotation, field, run.sigma_T)
    return run, Locator(site).locate_many(bench.fields_of(site, faulty))


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_of_the_whole_is_named_and_no_wrong_pose_is_ok(kind):
    distortion, explanation = FAULTS[kind]
    quick = explanation is Explanation.MIRRORED
    site = bench.prigge_cube(2e-8)
    run, poses = located(site, distortion, 71, 60 if quick else 8)
    for pose, truth in zip(poses, run.position_m, strict=True):
        assert pose.status is not Status.OK or np.linalg.norm(pose.position_m - truth) < 0.02
    named = [pose for pose in poses if [f.kind for f in pose.findings] == [explanation]]
    assert len(named) >= 0.85 * len(poses)
    assert all(pose.status is Status.INCONSISTENT and pose.reason == pose.findings[0].text for pose in named)


def test_the_figures_of_a_fault_are_told():
    site = bench.prigge_cube(2e-8)
    _, (pose, *_) = located(site, 1.2 * np.eye(3), 72, 2)
    assert pose.findings[0].factor == pytest.approx(1.2, abs=0.01)
    _, (pose, *_) = located(site, axis(1, 0.0), 72, 2)
    assert "y axis shows nothing" in pose.reason
    _, (pose, *_) = located(site, np.eye(3) / 0.3048, 72, 2)
    assert "positions and radii were feet taken for metres" in pose.reason


def test_a_sensor_of_which_an_axis_is_negated():
    """Fields of a simulated sensor with one axis wired the wrong way round."""
    site = sites.load(DATA / "sensor_axis_negated_site.toml")
    for pose in Locator(site).locate_many(list(read_fields(site, str(DATA / "sensor_axis_negated_fields.csv")))):
        assert pose.status is Status.INCONSISTENT
        assert "sensor's axes mirrored (or all coils reversed): check the wiring" in pose.reason


@pytest.mark.parametrize(("beacons", "excluded"), [(4, False), (5, True)])
def test_one_beacon_is_left_out_of_five_and_not_of_four(beacons, excluded):
    site = bench.prigge_cube(2e-8, keep=(0, 3, 5, 6, 1)[:beacons])
    rng = np.random.default_rng(73)
    run = bench.trials(site, bench.cube_positions(rng, 10, 0.6), rng)
    faulty = bench.with_fault("dead", site, run, rng, 1)
    poses = Locator(site).locate_many(bench.fields_of(site, faulty))
    left_out = sum(pose.excluded == (site.beacons[1].id,) for pose in poses)
    assert left_out >= 7 if excluded else left_out == 0
    for pose in poses:
        assert excluded or pose.status is not Status.OK
        if pose.excluded:
            (finding,) = pose.findings
            assert (finding.kind, finding.beacons, finding.factor) == (Explanation.DEAD, pose.excluded, 0.0)
            assert f"{pose.excluded[0]} has no field" in pose.reason
            assert pose.residuals[pose.excluded[0]] > 5.0


@pytest.mark.parametrize(("beacons", "excluded"), [(6, False), (7, True)])
def test_two_beacons_are_left_out_of_seven_and_not_of_six(beacons, excluded):
    site = bench.prigge_cube(2e-8, keep=range(beacons))
    rng = np.random.default_rng(74)
    run = bench.trials(site, bench.cube_positions(rng, 6, 0.6), rng)
    faulty = bench.with_fault("polarity", site, bench.with_fault("dead", site, run, rng, 1), rng, 4)
    poses = Locator(site).locate_many(bench.fields_of(site, faulty))
    left_out = sum(set(pose.excluded) == {"b1", "b4"} for pose in poses)
    assert left_out >= 5 if excluded else all(pose.status is not Status.OK for pose in poses)


def of_many(count, faulty):
    """A site of 48 coils, and epochs at places between them with these reversed."""
    rng = np.random.default_rng(77)
    site = bench.site_of([bench.loop_beacon(i, rng.uniform(0, 6, 3), rng.normal(size=3)) for i in range(48)])
    run = bench.trials(site, rng.uniform(2, 4, (count, 3)), rng)
    for row in faulty:
        run = bench.with_fault("polarity", site, run, rng, row)
    return site, run


def test_of_48_beacons_the_reversed_one_is_left_out():
    site, run = of_many(5, [7])
    for pose, truth in zip(Locator(site).locate_many(bench.fields_of(site, run)), run.position_m, strict=True):
        assert pose.status in (Status.OK, Status.UNVERIFIED)
        assert pose.excluded == ("b7",)
        assert np.linalg.norm(pose.position_m - truth) < 0.1


def test_of_48_beacons_the_likeliest_pairs_are_tried_and_no_others():
    site, run = of_many(3, [7, 30])
    constellation = Constellation(FieldModel(site.beacons))
    for field, sigma in zip(run.field_T, run.sigma_T, strict=True):
        measurements = Measurements(field[None], sigma[None])
        ones = without_one(constellation, measurements, constellation.solve(measurements).best)
        pairs = without_two(constellation, measurements, ones)
        assert len(pairs.left_out) == 66 + 36  # all of twelve, and the first with each of the others
        assert set(pairs.left_out[0].tolist()) == {7, 30}


@pytest.mark.parametrize(
    ("kind", "explanation"),
    [("polarity", Explanation.REVERSED), ("current", Explanation.CURRENT), ("moved", Explanation.MOVED)],
)
def test_what_is_wrong_with_a_beacon_is_named(kind, explanation):
    site = bench.prigge_cube(2e-8)
    rng = np.random.default_rng(75)
    run = bench.trials(site, bench.cube_positions(rng, 10, 0.6), rng)
    poses = Locator(site).locate_many(bench.fields_of(site, bench.with_fault(kind, site, run, rng, 5)))
    named = [pose.findings[0] for pose in poses if [f.kind for f in pose.findings] == [explanation]]
    assert len(named) >= 7
    for finding in named:
        assert finding.beacons == ("b5",)
        if kind == "current":
            assert min(abs(finding.factor - 0.5), abs(finding.factor - 1.5)) < 0.05
        if kind == "moved":  # `with_fault` moves by 20 cm
            distance = np.linalg.norm(finding.position_m - site.beacons[5].position_m)
            assert distance == pytest.approx(0.2, abs=0.1)


def test_above_the_alert_limit_a_pose_is_unverified():
    site = bench.prigge_cube()
    rng = np.random.default_rng(76)
    (fields,) = bench.fields_of(site, bench.trials(site, bench.cube_positions(rng, 1, 0.5), rng))
    level = Locator(site).locate(fields).protection_m
    above, below = (Locator(replace(site, alert_limit_m=level * by)).locate(fields) for by in (0.999, 1.001))
    assert (above.status, below.status) == (Status.UNVERIFIED, Status.OK)
    assert f"could hide an error of {level:.2f} m; the alert limit is" in above.reason
    assert below.reason is None
    assert Locator(replace(site, alert_limit_m=np.nan)).locate(fields).status is Status.UNVERIFIED
