"""What a beacon's fault is called where the pose that tells it is uncertain, and where little of it was measured.

The covariance of what the pose says of the beacon is by differences of the model's fields.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from goldfield.field import FieldModel
from goldfield.locate.beacon_faults import beacon_finding
from goldfield.locate.fit import Fit, Measurements
from goldfield.types import Explanation
from tests.bench import locate_trials as bench

SIGMA_T = 2e-8 / np.sqrt(bench.CHIPS)
ROW = 3


class Case:
    """A pose in the cube that is uncertain along one direction, or hardly at all."""

    def __init__(self, deviation=None, seed=107, position_m=None):
        rng = np.random.default_rng(seed)
        site = bench.prigge_cube(2e-8)
        self.model = FieldModel(site.beacons)
        run = bench.trials(site, bench.cube_positions(rng, 1, 0.6), rng, sigma_T=0.0)
        self.position_m = run.position_m[0] if position_m is None else np.asarray(position_m)
        self.rotation = run.rotation[0]
        self.deviation = np.full(6, 1e-9) if deviation is None else np.asarray(deviation)
        self.field_T = self.read(self.position_m, self.rotation)

    def read(self, position_m, rotation, row=None):
        field = self.model.field(position_m) @ rotation
        return field if row is None else field[row]

    def told(self, value, row=ROW, sigma_T=SIGMA_T):
        """Return the finding and the residual if the beacon's field is ``value``."""
        field = self.field_T.copy()
        field[row] = value
        information = np.diag(1.0 / self.deviation**2)
        pose = Fit(self.position_m[None], self.rotation[None], np.zeros(1), information[None], np.ones(1, dtype=bool))
        return beacon_finding(self.model, Measurements(field[None], np.full((1, 8), sigma_T)), pose, row, "b")

    def spread(self, factor=1.0):
        """Covariance of a beacon's field less ``factor`` times what the pose says of it, in units of the noise."""
        slope = []
        for k in range(6):
            step = np.where(np.arange(6) == k, 1e-5, 0.0)
            ends = [
                self.read(self.position_m + s[:3], Rotation.from_rotvec(s[3:]).as_matrix() @ self.rotation, ROW)
                for s in (step, -step)
            ]
            slope.append((ends[0] - ends[1]) / 2e-5 * self.deviation[k] / SIGMA_T)
        return np.eye(3) + factor**2 * np.array(slope).T @ np.array(slope)


WORSE = (2e-3, 1e-3, 3e-3, 4e-3, 2e-3, 1e-3)
"""Deviations of a pose that make the fields uncertain by some standard deviations of the noise, m and rad."""


@pytest.mark.parametrize(("share", "admitted"), [(0.995, True), (1.005, False)])
@pytest.mark.parametrize(
    ("factor", "kind", "freedom"),
    [
        (0.0, Explanation.DEAD, 3),
        (-1.0, Explanation.REVERSED, 3),
        (-2.5, Explanation.CURRENT, 2),
        (0.6, Explanation.CURRENT, 2),
    ],
)
def test_the_poses_error_counts_as_far_as_the_modelled_field_does(factor, kind, freedom, share, admitted):
    case = Case(WORSE)
    inverse = np.linalg.inv(case.spread(factor))
    told = case.field_T[ROW]
    misfit = np.cross(inverse @ told, [0.3, -0.7, 0.5])  # no other factor explains any of it
    misfit *= np.sqrt(share * chi2.isf(1e-3, freedom) / (misfit @ inverse @ misfit)) * SIGMA_T
    finding, residual = case.told(factor * told + misfit)
    assert (finding.kind is kind) == admitted
    assert finding.factor == (pytest.approx(factor, rel=1e-5) if admitted else finding.factor)
    off = ((factor - 1.0) * told + misfit) / SIGMA_T
    assert residual == pytest.approx(np.sqrt(off @ np.linalg.inv(case.spread()) @ off / 3), rel=1e-6)


def moved_field(case, way_m, row=ROW):
    """The beacon moved by a way makes the field that it made where the sensor is moved back."""
    return case.read(case.position_m - way_m, case.rotation, row)


@pytest.mark.parametrize(
    ("heard", "kinds"), [(3, (Explanation.MOVED,)), (2, (Explanation.BEACON,)), (1, (Explanation.BEACON,))]
)
def test_a_place_takes_three_components(heard, kinds):
    case = Case()
    value = moved_field(case, np.array([0.2, -0.15, 0.1]))
    value[heard:] = np.nan
    assert case.told(value)[0].kind in kinds


@pytest.mark.parametrize(
    ("heard", "kind"), [(3, Explanation.CURRENT), (2, Explanation.CURRENT), (1, Explanation.BEACON)]
)
def test_a_factor_takes_two_components(heard, kind):
    case = Case()
    value = 1.5 * case.field_T[ROW]
    value[heard:] = np.nan
    assert case.told(value)[0].kind is kind


def test_a_dead_and_a_reversed_beacon_have_their_factors():
    case = Case()
    assert case.told(np.zeros(3))[0].factor == 0.0
    assert case.told(-case.field_T[ROW])[0].factor == -1.0


@pytest.mark.parametrize("way_m", [(0.2, -0.15, 0.1), (0.5, -0.6, 0.3), (-0.9, 0.3, 0.4)])
def test_a_place_is_told_with_how_far_it_is(way_m):
    case = Case()
    finding, _ = case.told(moved_field(case, np.array(way_m)))
    assert finding.kind is Explanation.MOVED
    np.testing.assert_allclose(finding.position_m, case.model.centre_m[ROW] + way_m, atol=1e-6)
    assert f" {np.linalg.norm(way_m):.2g} m away" in finding.text


@pytest.mark.parametrize(("share", "told"), [(0.98, True), (1.02, False)])
@pytest.mark.parametrize("turn", range(3))
def test_a_turn_of_the_pose_makes_the_place_uncertain(turn, share, told):
    """What a small turn does to the place that fits is by differences of the search itself."""
    way_m = np.array([0.2, -0.15, 0.1])
    case = Case()
    value = moved_field(case, way_m)
    places, rotation = [], case.rotation
    for sign in (1.0, -1.0):
        case.rotation = Rotation.from_rotvec(sign * 1e-4 * np.eye(3)[turn]).as_matrix() @ rotation
        places.append(case.told(value)[0].position_m)
    case.rotation = rotation
    slope_m = np.linalg.norm(places[0] - places[1]) / 2e-4
    case.deviation[3 + turn] = share * 0.2 * np.linalg.norm(way_m) / slope_m
    assert (case.told(value)[0].kind is Explanation.MOVED) == told


@pytest.mark.parametrize("turn", range(3))
def test_noise_of_the_field_makes_the_place_uncertain(turn):
    """As in the turns; the noise at which the place is not told any more is found by bisection."""
    way_m = 0.7 * np.eye(3)[turn]
    case = Case()
    value = moved_field(case, way_m)
    slope = []
    for step in np.eye(3) * 1e-3 * np.linalg.norm(value):
        ends = [case.told(value + s)[0].position_m for s in (step, -step)]
        slope.append((ends[0] - ends[1]) / (2e-3 * np.linalg.norm(value)))
    most = 0.2 * 0.7 / np.linalg.norm(slope, 2)
    kinds = [case.told(value, sigma_T=share * most)[0].kind for share in (0.98, 1.02)]
    assert kinds[0] is Explanation.MOVED, kinds
    assert kinds[1] is not Explanation.MOVED, kinds


def test_on_the_wire_of_a_beacon_nothing_is_told_of_its_place():
    case = Case()
    first = bench.prigge_cube().beacons[0]
    assert not first.position_m.any()
    case.position_m = np.array([first.radius_m, 0.0, 0.0])
    with np.errstate(all="ignore"):
        assert not np.isfinite(case.read(case.position_m, case.rotation, 0)).all()
        finding, residual = case.told(case.field_T[0], row=0)
    assert finding.kind is Explanation.BEACON
    assert np.isnan(residual)


def test_a_field_that_no_place_near_by_makes_has_none():
    """In the plane of a coil all fields lie along its axis, and a small move changes none of them across the way.

    However well all is known.
    """
    case = Case(position_m=[1.0, 0.3, 0.0])
    here = case.model.field(case.position_m)[0]
    value = (here + np.array([-0.3e-7, 1e-7, -2e-7])) @ case.rotation
    assert case.told(value, row=0)[0].kind is Explanation.BEACON
    case.deviation = np.full(6, 1e-45)
    assert case.told(value, row=0, sigma_T=1e-45)[0].kind is Explanation.BEACON
