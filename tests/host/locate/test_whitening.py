"""Whitening against the covariance of what it whitens, made of differences of fields of a site that is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate.site_errors import errors_of
from goldfield.locate.whitening import Correlated, Independent, whitening_around
from goldfield.site import Survey
from tests.bench import locate_trials as bench
from tests.host.locate import built_sites as built

SURVEY = Survey(0.01, 0.02, 0.03)
GAIN, LEAN = 0.015, 0.025
AXES = np.array([[1.02, 0.3, 0.0], [0.1, -0.95, 0.2], [0.0, 0.0, 0.6]])
STEP = 1e-4


class Case:
    """Two poses in the cube, the noise of their components, and the covariance of one pose's components."""

    def __init__(self, survey=SURVEY, gain=GAIN, lean=LEAN, axes=None):
        site = built.declared(built.mixed_cube(2e-8), survey, gain, lean)
        site = replace(site, sensor=replace(site.sensor, axes=axes))
        rng = np.random.default_rng(4)
        self.site, self.model, self.survey, self.gain, self.lean, self.axes = (
            site, FieldModel(site.beacons), survey, gain, lean, axes
        )  # fmt: skip
        run = bench.trials(site, built.inside(site, rng, 2), rng)
        self.position, self.rotation = run.position_m, run.rotation
        self.noise = np.full((2, 8, 3), 3e-9) * np.linspace(1.0, 2.0, 8)[None, :, None]
        self.noise[1, 2] = self.noise[1, 5, 1] = np.inf

    def whitening(self):
        errors = errors_of(self.site.beacons, self.site.sensor)
        return whitening_around(self.model, errors, self.noise, self.position, self.rotation)

    def components(self, e, beacons):
        return (FieldModel(beacons).field(self.position[e]) @ self.rotation[e]).T.ravel()

    def effects_of(self, e, i):
        """What a beacon's errors do to the components of all, by differences: (3n, 7)."""
        beacon = self.site.beacons[i]
        changed = [
            *[(lambda s, k=k: replace(beacon, position_m=beacon.position_m + s * np.eye(3)[k])) for k in range(3)],
            *[
                (lambda s, k=k: replace(beacon, axis=Rotation.from_rotvec(s * np.eye(3)[k]).apply(beacon.axis)))
                for k in range(3)
            ],
            lambda s: replace(beacon, current_A=beacon.current_A * (1.0 + s)),
        ]
        size = [self.survey.position_sd_m] * 3 + [self.survey.axis_sd_rad] * 3 + [self.survey.current_sd]
        columns = []
        for change, sd in zip(changed, size, strict=True):
            sites = [[*self.site.beacons[:i], change(s), *self.site.beacons[i + 1 :]] for s in (STEP, -STEP)]
            columns.append(sd * (self.components(e, sites[0]) - self.components(e, sites[1])) / (2.0 * STEP))
        return np.stack(columns, axis=1)

    def covariance(self, e):
        """What the site's and the sensor's errors and the noise do to the components of all beacons, x first."""
        known = np.isfinite(self.noise[e])
        total = np.zeros((24, 24))
        for i in range(8):
            effect = self.effects_of(e, i)
            total += effect @ effect.T
        field = self.components(e, self.site.beacons).reshape(3, 8)
        for k in range(3):
            for m in range(k, 3):
                # Each entry off the diagonal leans by itself; what both lean alike is a turn of the sensor.
                matrix = np.zeros((3, 3))
                matrix[k, m] = matrix[m, k] = self.gain if k == m else self.lean / np.sqrt(2.0)
                effect = (matrix @ field).ravel()
                total += np.outer(effect, effect)
        inner = np.eye(3) if self.axes is None else np.linalg.inv(self.axes)
        shape = inner @ inner.T / (np.trace(inner @ inner.T) / 3.0)
        noise = np.where(known, self.noise[e], 0.0)
        for i in range(8):
            own = noise[i][:, None] * shape * noise[i]
            total[np.ix_([i, 8 + i, 16 + i], [i, 8 + i, 16 + i])] += own
        rows = known.T.ravel()
        return total, rows


CASES = {
    "the site": Case(gain=0.0, lean=0.0),
    "gains": Case(lean=0.0),
    "leaning axes": Case(gain=0.0),
    "all": Case(),
    "noise that is correlated": Case(axes=AXES),
}


@pytest.mark.parametrize("name", CASES)
def test_whitened_errors_are_independent_and_of_unit_variance(name):
    case = CASES[name]
    whiten = case.whitening()
    assert (whiten.mixing is None) == (name == "the site")
    for e in range(2):
        dense = whiten(np.tile(np.eye(24).reshape(1, 24, 3, 8), (2, 1, 1, 1)))[e].T
        total, rows = case.covariance(e)
        assert not dense[~rows].any()
        assert not dense[:, ~rows].any()
        found = dense[np.ix_(rows, rows)] @ total[np.ix_(rows, rows)] @ dense[np.ix_(rows, rows)].T
        np.testing.assert_allclose(found, np.eye(rows.sum()), atol=2e-3)


@pytest.mark.parametrize("name", CASES)
def test_what_is_seen_of_the_fault_of_a_beacon(name):
    """By its own covariance alone a fault is whitened, and by all of them seen."""
    case = CASES[name]
    whiten = case.whitening()
    for e in range(2):
        rows = case.covariance(e)[1]
        some = whiten.take(np.array([e]))
        dense = some(np.eye(24).reshape(1, 24, 3, 8))[0].T
        for i in range(8):
            own = [k for k in (i, 8 + i, 16 + i) if rows[k]]
            if not own:
                assert not some.gram[0, i].any()
                continue
            # The covariance without what the sensor adds, which is that of all beacons.
            field = np.random.default_rng(i).normal(size=(1, 3, 8))
            alone = some.alone(field)[0, i]
            factor = some.beacon[0, i]
            np.testing.assert_allclose(alone, factor @ field[0, :, i], atol=1e-12 * np.abs(alone).max())
            measured = np.array([rows[k] for k in (i, 8 + i, 16 + i)])
            inverse = np.zeros((3, 3))
            inverse[np.ix_(measured, measured)] = np.linalg.inv(factor[np.ix_(measured, measured)])
            seen = dense[:, [i, 8 + i, 16 + i]] @ inverse
            np.testing.assert_allclose(some.gram[0, i], seen.T @ seen, atol=1e-9)
            whitened = np.random.default_rng(i).normal(size=(1, 2, 24))
            np.testing.assert_allclose(
                some.by_beacon(whitened)[0, i][measured], (seen.T @ whitened[0].T)[measured], atol=1e-9
            )


@pytest.mark.parametrize("name", ["the site", "all"])
def test_copies_of_epochs_are_whitened_as_each(name):
    whiten = CASES[name].whitening()
    rng = np.random.default_rng(5)
    components = rng.normal(size=(6, 4, 3, 8))
    each = [whiten(components[2 * k : 2 * k + 2]) for k in range(3)]
    np.testing.assert_array_equal(whiten.tiled(3)(components), np.concatenate(each))


def test_independent_components_are_divided_by_their_deviations():
    rng = np.random.default_rng(6)
    weight = rng.uniform(1.0, 2.0, size=(2, 3, 8))
    weight[1, :, 2] = weight[1, 1, 5] = 0.0
    whiten, components = Independent(weight), rng.normal(size=(2, 4, 3, 8))
    found = whiten(components)
    np.testing.assert_array_equal(found, (components * weight[:, None]).reshape(2, 4, 24))
    np.testing.assert_array_equal(whiten.tiled(2)(np.tile(components, (2, 1, 1, 1))), np.tile(found, (2, 1, 1)))
    np.testing.assert_array_equal(whiten.by_beacon(found)[1, 5, :, 2], found[1, 2, 5::8])
    np.testing.assert_array_equal(whiten.alone(components[:, 0])[0, 3], (components[0, 0] * weight[0])[:, 3])
    np.testing.assert_array_equal(whiten.gram[1, 5], np.diag([1.0, 0.0, 1.0]))
    np.testing.assert_array_equal(whiten.gram[1, 2], np.zeros((3, 3)))
    np.testing.assert_array_equal(whiten.gram[0, 2], np.eye(3))


def test_on_a_wire_no_number_is_whitened_and_elsewhere_all_are():
    case = Case()
    case.position[0] = [case.site.beacons[2].radius_m, 0.0, 0.0]
    case.noise[:] = 3e-9
    beacons = [replace(case.site.beacons[2], position_m=np.zeros(3), axis=np.array([0.0, 0.0, 1.0]))]
    case.model = FieldModel([*beacons, *case.site.beacons[1:]])
    with np.errstate(all="ignore"):
        whiten = case.whitening()
    assert np.isnan(whiten.beacon[0, 0]).all()
    assert np.isfinite(whiten.beacon[0, 1:]).all()
    assert np.isfinite(whiten.beacon[1]).all()
    assert np.isnan(whiten.mixing[0]).all()
    assert np.isfinite(whiten.mixing[1]).all()


def test_some_epochs_are_taken_with_or_without_a_sensor_that_mixes():
    beacon, mixing = np.arange(2 * 8 * 9.0).reshape(2, 8, 3, 3), np.arange(2 * 576.0).reshape(2, 24, 24)
    taken = Correlated(beacon, mixing).take(np.array([1]))
    np.testing.assert_array_equal(taken.beacon, beacon[1:])
    np.testing.assert_array_equal(taken.mixing, mixing[1:])
    assert Correlated(beacon).take(np.array([1])).mixing is None


def test_a_sensor_whose_noise_alone_is_declared_mixes_no_beacons():
    case = Case(Survey(0.0, 0.0, 0.0), 0.0, 0.0, AXES)
    whiten = case.whitening()
    assert whiten.mixing is None
    total = case.covariance(0)[0]
    dense = whiten(np.tile(np.eye(24).reshape(1, 24, 3, 8), (2, 1, 1, 1)))[0].T
    np.testing.assert_allclose(dense @ total @ dense.T, np.eye(24), atol=1e-9)
