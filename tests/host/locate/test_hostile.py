"""Fields that no sensor sends: a sentence, or a pose that is no worse than without them, and never a crash."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from goldfield import Fields, Locator, Tracker, UserError
from goldfield.site import HalfSpace
from goldfield.types import LARGEST_T, LEAST_SIGMA_T, Explanation, Status
from tests.bench import locate_trials as bench
from tests.bench.integrity_sites import told


@pytest.fixture(scope="module")
def room():
    """A site, the ids of its beacons, and the fields and deviations of one sound epoch."""
    site, rng = bench.prigge_cube(), np.random.default_rng(1)
    run = bench.trials(site, bench.cube_positions(rng, 1), rng)
    return site, tuple(beacon.id for beacon in site.beacons), run.field_T[0], run.sigma_T[0]


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        (np.ones((8, 3)) + 1j, "complex128"),
        (np.full((8, 3), "1e-6"), "str"),
        (np.ones((8, 3), dtype=object), "object"),
        (np.ones((8, 3), dtype=bool), "bool"),
    ],
)
def test_anything_but_real_numbers_is_refused(room, values, kind):
    _, names, field, sigma = room
    with pytest.raises(UserError, match=f"field_T= of Fields holds {kind}.* values: it needs real numbers, in tesla"):
        Fields(0, 0.0, names, values, sigma)
    with pytest.raises(UserError, match=f"sigma_T= of Fields holds {kind}"):
        Fields(0, 0.0, names, field, values[:, 0])


def test_lists_and_other_real_numbers_will_do(room):
    site, names, field, sigma = room
    pose = Locator(site).locate(Fields(0, 0.0, names, field, sigma))
    for given in (Fields(0, 0.0, list(names), field.tolist(), sigma.tolist()), Fields(0, 0.0, names, field, sigma)):
        assert Locator(site).locate(given).position_m == pytest.approx(pose.position_m, abs=1e-9)
        assert Tracker(site).update(given).position_m == pytest.approx(pose.position_m, abs=0.01)
    single = Fields(0, 0.0, names, field.astype(np.float32), sigma.astype(np.float32))
    assert Locator(site).locate(single).position_m == pytest.approx(pose.position_m, abs=1e-3)


@pytest.mark.parametrize("size", [2.0 * LARGEST_T, 1e160, 1e300])
@pytest.mark.parametrize("silent", [False, True])
def test_fields_that_cannot_be_are_as_if_not_measured(room, size, silent):
    site, names, field, sigma = room
    site = told(site, None) if silent else site
    without = field.copy()
    without[2] = np.nan
    right = Locator(site).locate(Fields(0, 0.0, names, without, sigma))
    assert right.used == tuple(name for name in names if name != "b2")
    bad = field.copy()
    bad[2] = size
    pose = Locator(site).locate(Fields(0, 0.0, names, bad, sigma))
    assert (pose.status, pose.used) == (right.status, right.used)
    assert np.array_equal(pose.position_m, right.position_m)
    assert Tracker(site).update(Fields(0, 0.0, names, bad, sigma)).used == right.used
    nothing = Fields(0, 0.0, names, np.full((8, 3), size), sigma)
    assert Locator(site).locate(nothing).status is Status.FAILED
    assert Tracker(site).update(nothing).status is Status.FAILED


@pytest.mark.parametrize("sigma_T", [LEAST_SIGMA_T, 1e-40, 1e-160, 1e-320])
@pytest.mark.parametrize("silent", [False, True])
def test_noise_of_next_to_nothing_is_no_failure(room, sigma_T, silent):
    site, names, field, _ = room
    site = told(site, None) if silent else site
    fields = [Fields(i, 0.1 * i, names, field, np.full(8, sigma_T)) for i in range(2)]
    pose = Locator(site).locate(fields[0])
    assert pose.status is Status.INCONSISTENT  # the noise that there is, is far more
    assert "noise_T" in pose.reason
    tracker = Tracker(site)
    assert all(tracker.update(epoch).status in set(Status) for epoch in fields)


@pytest.mark.parametrize("deviations_too", [False, True])
@pytest.mark.parametrize(
    ("factor", "kind", "words"), [(1e4, "units", "gauss"), (70.0, "strength", "times those of the site file")]
)
@pytest.mark.parametrize("beacons", [4, 8])
def test_all_fields_in_another_unit_are_told_with_the_factor(room, deviations_too, factor, kind, words, beacons):
    site, names, field, sigma = room
    site = bench.prigge_cube(keep=range(beacons)) if beacons < 8 else site
    given = Fields(0, 0.0, names[:beacons], field[:beacons] * factor, sigma[:beacons] * factor**deviations_too)
    pose = Locator(site).locate(given)
    assert pose.status is Status.INCONSISTENT
    assert words in pose.reason
    (finding,) = pose.findings
    assert finding.kind == Explanation(kind)
    assert finding.factor == pytest.approx(factor, rel=0.1)
    assert ("nearly" in pose.reason) != deviations_too


def test_what_a_factor_does_not_explain_is_not_told_as_one(room):
    site, names, field, sigma = room
    pose = Locator(site).locate(Fields(0, 0.0, names, field[[3, 0, 5, 1, 7, 2, 4, 6]], sigma))
    assert pose.status is Status.INCONSISTENT
    assert [finding.kind for finding in pose.findings] == [Explanation.UNKNOWN]


@pytest.mark.parametrize("seed", [0, 7, 41])
def test_a_beacon_beside_a_line_of_others_is_judged_where_they_hardly_tell_the_pose(seed):
    """The rounding of a large variance made a small one negative, and a root was drawn of less than nothing."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 3.0, size=(6, 3)) * [1.0, 0.0, 0.0]
    places[-1] = 1.0
    rng.normal(size=places.shape)
    coils = [bench.loop_beacon(i, tuple(place), (0.0, 0.0, 1.0)) for i, place in enumerate(places)]
    site = bench.site_of(coils, HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0])), noise_T=2e-7)
    run = bench.trials(site, rng.uniform([0.2, 0.2, 0.3], [2.7, 2.7, 2.0], size=(12, 3)), rng)
    fields = bench.fields_of(site, replace(run, field_T=run.field_T * [1.0, 0.0, 0.0]))  # two axes are dead
    for pose in Locator(site).locate_many(fields):
        assert pose.status is not Status.OK or np.isfinite(pose.protection_m)
