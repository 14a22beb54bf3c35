"""A sensor over a copper ball, whose field is the exact series': located with and without the correction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.constants import mu_0
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.field import FieldModel
from goldfield.field.conductor import Material, ball, respond
from goldfield.locate import Locator
from goldfield.locate.own_body import OwnBody, locate_beside
from goldfield.poses import Fields, Status
from hil_sim.world.sphere import Sphere

SITE = sites.load(Path(__file__).parent.parent / "prigge8_site.toml")
CENTRE_M, RADIUS_M, COPPER, FREQUENCY_HZ = np.array([0.02, 0.0, -0.2]), 0.1, 59.9e6, 1e4
SIGMA_T = 6e-9


@pytest.fixture(scope="module")
def body() -> OwnBody:
    return OwnBody(respond(ball(CENTRE_M, RADIUS_M, Material(COPPER), 8), FREQUENCY_HZ))


def measured(position: np.ndarray, rotation: np.ndarray) -> Fields:
    """Beacons' fields with what the true ball adds; beacons as dipoles for the ball, exact loops for the sensor."""
    model = FieldModel(SITE.beacons)
    truth = Sphere(CENTRE_M, RADIUS_M, COPPER)
    added = [
        truth.secondary(np.zeros(3), rotation.T @ (centre - position), rotation.T @ moment, FREQUENCY_HZ).real
        for centre, moment in zip(model.centre_m, model.moment_A_m2, strict=True)
    ]
    field = model.field(position) @ rotation + mu_0 * np.array(added)
    names = tuple(beacon.id for beacon in SITE.beacons)
    return Fields(0, 0.0, names, field, np.full(len(names), SIGMA_T))


def test_correction_removes_the_error_of_the_own_body(body: OwnBody) -> None:
    rng = np.random.default_rng(7)
    locator = Locator(SITE)
    centre = np.mean([beacon.position_m for beacon in SITE.beacons], axis=0)
    without, corrected, turns = [], [], []
    for rotation in Rotation.random(6, rng=rng):
        position = centre + rng.uniform(-0.4, 0.4, 3)
        fields = measured(position, rotation.as_matrix())
        # As a locator that knows nothing of the body: all beacons trusted, or integrity would throw them out.
        without.append(np.linalg.norm(locator.fit_all([fields])[0] - position))
        pose = locate_beside(locator, body, fields)
        assert pose.status is Status.OK
        corrected.append(np.linalg.norm(pose.position_m - position))
        turns.append((Rotation.from_quat(pose.orientation_xyzw) * rotation.inv()).magnitude())
    assert min(without) > 0.003
    assert np.median(without) > 0.01
    assert max(corrected) < 0.0005
    assert max(turns) < 0.002


def test_predicted_field_is_the_true_one(body: OwnBody) -> None:
    position, rotation = np.array([0.2, -0.1, 0.3]), Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    fields = measured(position, rotation)
    model = FieldModel(SITE.beacons)
    added = fields.field_T - model.field(position) @ rotation
    predicted = body.predicted(model, position, rotation)
    error = np.linalg.norm(predicted - fields.field_T, axis=1)
    assert (error < 0.02 * np.linalg.norm(added, axis=1)).all()


def test_a_failed_epoch_stays_failed(body: OwnBody) -> None:
    fields = Fields(0, 0.0, ("nobody",), np.ones((1, 3)), np.ones(1))
    assert locate_beside(Locator(SITE), body, fields).status is Status.FAILED
