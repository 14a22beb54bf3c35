"""What location spares where the sound beacons are enough to exclude all but one pose, and that it changes nothing."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from goldfield.locate import Locator, exclusion, integrity, sensor_rivals
from goldfield.locate.budget import Budget
from goldfield.locate.constellation import Constellation
from goldfield.site import SensorSite
from tests.bench import locate_trials as bench


def with_one_faulty(site, rng, count, factor=0.7):
    """Fields of epochs of a site whose beacon b3 has another current."""
    run = bench.trials(site, bench.cube_positions(rng, count, 0.6), rng)
    run.field_T[:, 3] *= factor
    return bench.fields_of(site, run)


def told(pose):
    return pose.status, pose.excluded, pose.reason, pose.findings and pose.findings[0].kind


@pytest.mark.parametrize("beacons", [8, 7])
def test_what_is_spared_where_six_sound_beacons_stand_out_changes_no_answer(monkeypatch, beacons):
    """One beacon of seven or eight is faulty, then two; the same is told where nothing is spared."""
    site = bench.prigge_cube(2e-8, range(beacons))
    epochs = with_one_faulty(site, np.random.default_rng(141), 40)
    for fields in with_one_faulty(site, np.random.default_rng(142), 20):
        fields.field_T[5] *= -1.0
        epochs.append(fields)
    quick = Locator(site).locate_many(epochs)
    assert sum(pose.excluded == ("b3",) for pose in quick) >= 35
    monkeypatch.setattr(Constellation, "_enough_without_one", lambda *_: None)
    monkeypatch.setattr(Constellation, "sure", lambda _, measurements, fit: np.zeros(len(fit.cost), dtype=bool))
    for one, other in zip(quick, Locator(site).locate_many(epochs), strict=True):
        assert told(one) == told(other)
        np.testing.assert_allclose(one.position_m, other.position_m, atol=1e-6)


@pytest.mark.parametrize(("silent", "searches"), [((), 0), ((1,), 0), ((1, 6), 2)])
def test_a_search_is_spared_if_six_beacons_stand_out_beside_the_faulty_one(monkeypatch, silent, searches):
    """With five left that do, all of space is searched: for the fields, and for those negated."""
    site = bench.prigge_cube(2e-8)
    (fields,) = with_one_faulty(site, np.random.default_rng(143), 1)
    for row in silent:
        fields.field_T[row], fields.sigma_T[row] = 0.0, 1.0
    counted = []
    whole = Constellation.searched

    def searched(self, measurements, most, **options):
        counted.append(most)
        return whole(self, measurements, most, **options)

    monkeypatch.setattr(Constellation, "searched", searched)
    pose = Locator(site).locate(fields)
    assert pose.excluded == ("b3",)
    assert len(counted) >= searches if searches else not counted


def faulty(site, rng, count):
    """Fields of epochs that raise the alarm: each kind of fault of one beacon, two, a gain, other units, other places.

    The site has six beacons or more.
    """
    beacons = len(site.beacons)
    middle = np.mean([beacon.position_m for beacon in site.beacons], axis=0)
    trials = [
        bench.trials(site, middle + rng.uniform(-0.6, 0.6, size=(count, 3)), rng) for _ in range(len(bench.FAULTS) + 4)
    ]
    found = [bench.with_fault(kind, site, trials.pop(), rng, int(rng.integers(beacons))) for kind in bench.FAULTS]
    two, gain, units, places = trials
    found.append(bench.with_fault("moved", site, bench.with_fault("polarity", site, two, rng, 1), rng, 4))
    found.append(replace(gain, field_T=gain.field_T * [1.3, 1.0, 1.0]))
    found.append(replace(units, field_T=units.field_T * 1.1e4))
    found.append(replace(places, field_T=places.field_T[:, rng.permutation(beacons)]))
    return [fields for run in found for fields in bench.fields_of(site, run)]


def sites_with_alarms(count):
    """Sites, exact and not, each with epochs that raise the alarm."""
    rng = np.random.default_rng(144)
    for noise_T in (2e-7, 2e-8):
        site = bench.prigge_cube(noise_T)
        yield site, faulty(site, rng, count)
        yield (
            replace(site, sensor=SensorSite(noise_T=noise_T, gain_sd=0.003, axis_sd_rad=0.005)),
            faulty(site, rng, count),
        )
    for beacons in (6, 12):
        some = [bench.loop_beacon(i, rng.uniform(0.0, 4.0, size=3), rng.normal(size=3)) for i in range(beacons)]
        site = bench.site_of(some, noise_T=2e-8)
        yield site, faulty(site, rng, count)


def with_subsets_by_numpy(monkeypatch):
    """Every subset is compared by the NumPy code of `exclusion`, whose fits alone are the kernel's."""
    monkeypatch.setattr(exclusion, "kernel", SimpleNamespace(of=lambda _: None))


def without_what_is_known(monkeypatch):
    """The rest is located as if nothing were known of it, and one factor of all fields is sought twice.

    The second time has a budget of its own, which would end it here and there.
    """
    solve = Constellation.solve

    def nearly(constellation, measurements, poses, _):
        return sensor_rivals.nearly_one_factor(constellation, measurements.within(Budget(1000)), poses, None)

    monkeypatch.setattr(
        Constellation, "solve", lambda self, *given, known=None, **options: solve(self, *given, **options)
    )
    monkeypatch.setattr(integrity, "nearly_one_factor", nearly)


@pytest.mark.parametrize("spare_nothing", [with_subsets_by_numpy, without_what_is_known])
def test_epochs_that_alarm_get_the_same_poses_by_the_longer_way(monkeypatch, spare_nothing):
    work = list(sites_with_alarms(2))
    quick = [Locator(site).locate_many(epochs) for site, epochs in work]
    assert sum(bool(pose.excluded) for poses in quick for pose in poses) > 40
    assert len({finding.kind for poses in quick for pose in poses for finding in pose.findings}) > 6
    spare_nothing(monkeypatch)
    for (site, epochs), poses in zip(work, quick, strict=True):
        for pose, other in zip(poses, Locator(site).locate_many(epochs), strict=True):
            assert told(pose) == told(other)
            sigma = np.sqrt(np.trace(other.position_cov_m2))
            np.testing.assert_allclose(pose.position_m, other.position_m, atol=1e-4 * sigma)
            np.testing.assert_allclose(pose.position_cov_m2, other.position_cov_m2, atol=1e-4 * sigma**2)
            np.testing.assert_allclose(pose.protection_m, other.protection_m, rtol=1e-4)
