"""What location spares where the sound beacons are enough to exclude all but one pose, and that it changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.locate import Locator
from goldfield.locate.constellation import Constellation
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
