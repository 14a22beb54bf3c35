"""Where one beacon alone tells a pose from its image, a fault of that beacon is as much as the way to the image."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.locate import Locator, images
from goldfield.locate.constellation import FLAT_REST, RIVAL_COST, Constellation
from goldfield.locate.fault_statistics import fault_statistics
from goldfield.locate.fit import Fit, Measurements
from goldfield.locate.mirror import Mirror
from goldfield.site import HalfSpace
from goldfield.types import Status
from tests.bench import locate_trials as bench

FLOOR = [(0.0, 0.0, 0.0), (0.0, 2.13, 0.0), (2.13, 0.0, 0.0), (2.13, 2.13, 0.0)]
CEILING = [(2.13, 2.13, 1.78), (0.0, 0.0, 1.78)]
ABOVE = HalfSpace(np.zeros(3), np.array([0.0, 0.0, 1.0]))
SURE = (Status.OK, Status.UNVERIFIED)


def room(ceiling, half_space=None, raised_m=0.0, lean=0.0):
    """Four coils on the floor, one of them raised, all leaning in turn to and fro, and some under the ceiling."""
    places = [*FLOOR[:3], (2.13, 2.13, raised_m), *CEILING[:ceiling]]
    coils = [bench.loop_beacon(i, place, (lean * (-1) ** i, 0.0, 1.0)) for i, place in enumerate(places)]
    return bench.site_of(coils, half_space, noise_T=2e-7)


def located(site, run):
    return Locator(site).locate_many(bench.fields_of(site, run))


def poses(site, count=200, seed=5):
    rng = np.random.default_rng(seed)
    return bench.trials(site, rng.uniform([0.4, 0.4, 0.4], [1.7, 1.7, 1.4], size=(count, 3)), rng)


@pytest.mark.parametrize(("raised_m", "lean"), [(0.0, 0.0), (1e-3, 5e-4)])
def test_a_pose_that_one_beacon_tells_from_its_image_is_unverified(raised_m, lean):
    """Exactly flat, or so nearly that the noise hides it: the level reaches to the other side of the floor."""
    site = room(1, None, raised_m, lean)
    run = poses(site)
    found = located(site, run)
    sure = [(pose, place) for pose, place in zip(found, run.position_m, strict=True) if pose.status in SURE]
    assert len(sure) > 190
    for pose, place in sure:
        assert pose.status is Status.UNVERIFIED
        assert pose.protection_m > 1.7 * place[2]
        assert "a fault of b4 could hide" in pose.reason


@pytest.mark.parametrize(
    "site",
    [room(2), room(1, ABOVE), room(1, None, 0.2, 0.05), room(1, None, 1.0)],
    ids=["two under the ceiling", "a half-space", "flat, but the image does not fit", "not flat"],
)
def test_others_are_as_sure_as_before(site):
    found = located(site, poses(site))
    assert sum(pose.status is Status.OK for pose in found) > 190
    assert all(pose.protection_m < site.alert_limit_m for pose in found if pose.status is Status.OK)


@pytest.mark.parametrize(("half_space", "tried"), [(ABOVE, False), (None, True)])
def test_images_that_the_half_space_rules_out_cost_no_fit(half_space, tried):
    """All coils on the floor, nearly: each of them would have an image of each pose to be fitted."""
    site = room(0, half_space, 1e-3, 5e-4)
    constellation = Constellation(FieldModel(site.beacons), site.half_space)
    here_m = np.random.default_rng(3).uniform([0.4, 0.4, 0.4], [1.7, 1.7, 1.4], size=(50, 3))
    assert bool(list(images._concerned(constellation, here_m))) == tried


@pytest.mark.parametrize(("below_m", "tried"), [(0.49, False), (0.51, True)])
def test_an_image_that_a_fit_may_bring_back_is_tried(below_m, tried):
    """The image of a pose 1 m above the floor is 2 m from it: a quarter of that way back is half a metre."""
    site = room(0, HalfSpace(np.array([0.0, 0.0, -below_m]), np.array([0.0, 0.0, 1.0])))
    constellation = Constellation(FieldModel(site.beacons), site.half_space)
    assert bool(list(images._concerned(constellation, np.array([[1.0, 0.9, 1.0]])))) == tried


def test_what_the_half_space_saves_changes_no_pose(monkeypatch):
    """Near-flat rooms, whose images a fit moves: with all of them tried the levels are the same."""
    for raised_m, lean in ((0.02, 0.01), (0.05, 0.02), (0.1, 0.03)):
        site = room(0, ABOVE, raised_m, lean)
        run = poses(site, 100)
        quick = located(site, run)
        with monkeypatch.context() as patch:
            patch.setattr(images, "MOVED", np.inf)
            slow = located(site, run)
        assert [pose.status for pose in quick] == [pose.status for pose in slow]
        assert [pose.protection_m for pose in quick] == [pose.protection_m for pose in slow]


@pytest.mark.parametrize(("thickness", "flat"), [(0.99 * FLAT_REST, True), (1.01 * FLAT_REST, False)])
def test_what_is_flat_enough_for_an_image(thickness, flat):
    """Four coils at the corners of a square of 2 m, two of them raised and two lowered: their extent is 2 m."""
    up_m = 2.0 * thickness
    corners = [(1.0, 1.0, up_m), (-1.0, 1.0, -up_m), (-1.0, -1.0, up_m), (1.0, -1.0, -up_m)]
    coils = [bench.loop_beacon(i, place) for i, place in enumerate([*corners, (0.0, 0.0, 2.0)])]
    constellation = Constellation(FieldModel(bench.site_of(coils, None).beacons))
    across = [row for row, mirror in constellation.mirrors_without_one if not np.allclose(mirror.turn, np.eye(3))]
    assert (4 in across) == flat


def test_no_image_is_taken_for_the_pose_where_the_coil_that_tells_them_apart_is_dead():
    """At the far end of the room an image below the floor is 4 m from the dead coil, whose field there is near noise.

    Of these poses some were `ok`, and off by 2.7 m with a level of 0.3 m.
    """
    site = room(1)
    rng = np.random.default_rng(6)
    run = bench.trials(site, rng.uniform([0.1, 0.1, 1.2], [0.5, 0.5, 1.5], size=(400, 3)), rng)
    dead = bench.with_fault("dead", site, run, rng, 4)
    found = located(site, replace(run, field_T=dead.field_T))
    off_m = np.array([np.linalg.norm(pose.position_m - p) for pose, p in zip(found, run.position_m, strict=True)])
    level_m = np.array([pose.protection_m for pose in found])
    sure = np.array([pose.status in SURE for pose in found])
    assert (off_m[sure] <= level_m[sure]).all()
    assert (sure & (off_m > 2.0)).any()
    assert not any(pose.status is Status.OK and off > 1.0 for pose, off in zip(found, off_m, strict=True))


@pytest.mark.parametrize(("at_once", "steps"), [(48, [48]), (47, [47, 1])])
def test_the_images_of_all_beacons_are_fitted_in_one_step(monkeypatch, at_once, steps):
    """A hall's coils, nearly flat but for one: fitted one after another the images of 120 took .2 s a pose."""
    rng = np.random.default_rng(8)
    places = [(3.0 * i, 3.0 * j, float(rng.normal(0.0, 0.02))) for i in range(4) for j in range(4)]
    places[5] = (3.0, 3.0, 0.3)
    site = bench.site_of([bench.loop_beacon(i, place) for i, place in enumerate(places)], None, noise_T=2e-9)
    run = bench.trials(site, rng.uniform([3.0, 3.0, 2.5], [6.0, 6.0, 3.5], size=(3, 3)), rng)
    constellation = Constellation(FieldModel(site.beacons))
    measured = Measurements(run.field_T, np.full(run.field_T.shape[:2], 2e-9))
    fit = constellation.at(measured, run.position_m, run.rotation)
    statistics = fault_statistics(constellation.model, measured, fit)
    calls, refine = [], Constellation.refine

    def counted(self, *arguments):
        calls.append(len(arguments[0]))
        return refine(self, *arguments)

    monkeypatch.setattr(Constellation, "refine", counted)
    monkeypatch.setattr(images, "AT_ONCE", at_once)
    distance_m = images.image_distance_m(constellation, measured, fit, statistics)
    assert calls == steps
    expected_m = np.zeros((3, 16))
    for row, mirror in constellation.mirrors_without_one:
        kept = np.delete(np.arange(16), row)
        others, image, rest = constellation.subset(kept), mirror.image(fit), measured.of_beacons(kept)
        found = refine(others, rest, image.position_m, image.rotation)
        own = others.at(rest, fit.position_m, fit.rotation)
        apart_m = np.linalg.norm(found.position_m - fit.position_m, axis=1)
        fits = mirror.concerns(fit.position_m) & (found.cost - own.cost < RIVAL_COST) & (apart_m > 1.0)
        expected_m[:, row] = np.maximum(expected_m[:, row], np.where(fits, apart_m, 0.0))
    assert distance_m == pytest.approx(expected_m, rel=1e-4)
    assert (distance_m[:, 5] > 4.0).all()
    assert (np.delete(distance_m, 5, axis=1) == 0.0).any()


HERE_M = np.array([[1.0, 0.9, 0.8], [0.5, 0.4, 1.5]])
BELOW_M = HERE_M * [1.0, 1.0, -1.0]


def fit_at(position_m, cost):
    return Fit(position_m, np.stack([np.eye(3)] * 2), np.array(cost), np.stack([np.eye(6)] * 2), np.ones(2, dtype=bool))


def distances(monkeypatch, *, exact, refined, coils=5, outside=(False, False)):
    """What is told of two poses whose images across the floor fit all coils but the third, by what the fit is then."""
    across = np.diag([1.0, 1.0, -1.0])
    mirror = Mirror(np.zeros(3), across, -across, exact)
    monkeypatch.setattr(images, "_concerned", lambda *_: [(2, mirror, np.ones(2, dtype=bool))])
    lacking = []

    def refine(measurements, *_):
        lacking.append(np.isnan(measurements.field_T).all(axis=2).tolist())
        return refined

    constellation = SimpleNamespace(model=[None] * coils, inside=lambda position_m: ~np.array(outside), refine=refine)
    measurements = Measurements(np.ones((2, coils, 3)), np.ones((2, coils)))
    drop = np.full((2, coils), 100.0)
    drop[:, 2] = [8.0, 12.0]
    found = images.image_distance_m(
        constellation, measurements, fit_at(HERE_M, [20.0, 30.0]), SimpleNamespace(drop=drop)
    )
    assert not found[:, [i for i in range(coils) if i != 2]].any()
    assert lacking == ([] if exact or coils < 4 else [[[i == 2 for i in range(coils)]] * 2])
    return found[:, 2]


@pytest.mark.parametrize("outside", [(False, False), (True, False)])
def test_an_exact_image_fits_without_a_fit(monkeypatch, outside):
    found = distances(monkeypatch, exact=True, refined=None, outside=outside)
    np.testing.assert_allclose(found, np.where(outside, 0.0, [1.6, 3.0]))


@pytest.mark.parametrize(("more", "told"), [(0.99 * RIVAL_COST, True), (1.01 * RIVAL_COST, False)])
@pytest.mark.parametrize("outside", [(False, False), (True, False)])
def test_another_image_must_fit_the_others_nearly_as_well_as_the_pose(monkeypatch, more, told, outside):
    """Without the third coil the poses cost 12 and 18."""
    refined = fit_at(BELOW_M + 0.1, [12.0 + more, 18.0 + more])
    found = distances(monkeypatch, exact=False, refined=refined, outside=outside)
    apart = np.linalg.norm(BELOW_M + 0.1 - HERE_M, axis=1)
    np.testing.assert_allclose(found, np.where(outside, 0.0, apart) if told else 0.0)


@pytest.mark.parametrize(("way", "told"), [(0.45, True), (0.55, False), (1.0, False)])
def test_an_image_whose_fit_comes_back_to_the_pose_is_none(monkeypatch, way, told):
    """It has come back where it is nearer to the pose than to the image: each is a rival of its own elsewhere."""
    back = BELOW_M + way * (HERE_M - BELOW_M)
    found = distances(monkeypatch, exact=False, refined=fit_at(back, [12.0, 18.0]))
    np.testing.assert_allclose(found, (1.0 - way) * np.array([1.6, 3.0]) if told else 0.0)


@pytest.mark.parametrize(("coils", "told"), [(3, False), (4, True)])
def test_without_one_of_three_coils_an_image_says_nothing(monkeypatch, coils, told):
    found = distances(monkeypatch, exact=False, refined=fit_at(BELOW_M, [12.0, 18.0]), coils=coils)
    np.testing.assert_allclose(found, [1.6, 3.0] if told else 0.0)
