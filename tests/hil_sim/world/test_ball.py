"""Balls of metal beside coils, against the exact series of a sphere beside dipoles and against images."""

from __future__ import annotations

import numpy as np
import pytest

from hil_sim.world.ball import Ball
from hil_sim.world.metal import BesideMetal, Metal
from hil_sim.world.path import CoilGeometry
from hil_sim.world.sheet import Sheet
from hil_sim.world.sphere import MU_0, Sphere

UP = np.array([0.0, 0.0, 1.0])
CENTRE = np.array([0.2, -0.1, 0.3])
MOMENT = np.array([0.3, -0.5, 0.8])
EXACT = {
    "conductor": Sphere(CENTRE, 0.15, np.inf),
    "iron": Sphere(CENTRE, 0.15, 0.0, relative_permeability=1e9),
}


class Dipole:
    """A dipole of `MOMENT` an ampere."""

    def __init__(self, place_m):
        self.place_m = np.asarray(place_m)

    def field_per_ampere(self, positions_m):
        away = positions_m - self.place_m
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        return 1e-7 * (3.0 * away * (away @ MOMENT)[:, None] / distance**5 - MOMENT / distance**3)


def directions(count, seed):
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("material", EXACT)
@pytest.mark.parametrize(("distance", "tolerance"), [(2.0, 1.5e-3), (4.0, 2e-4)])
def test_a_ball_adds_what_the_exact_series_says(material, distance, tolerance):
    """Dipoles two and four radii from the centre, points at 1.3 to 5 radii."""
    points = CENTRE + 0.15 * np.linspace(1.3, 5.0, 40)[:, None] * directions(40, 1)
    metal = Metal([Ball(CENTRE, 0.15, material)])
    for away in directions(5, 2):
        source = Dipole(CENTRE + distance * 0.15 * away)
        added = metal.field(metal.strengths(source), points)
        expected = MU_0 * EXACT[material].secondary(points, source.place_m, MOMENT, 0.0 if material == "iron" else 1e3)
        size = np.linalg.norm(expected.real, axis=1)
        assert np.all(np.linalg.norm(added - expected.real, axis=1) < tolerance * size.max())


def test_balls_and_sheets_feel_each_other():
    """A ball above a large sheet, which no flux passes, has an image below it: the field is that of two balls."""
    coil = CoilGeometry(turns=5.0, radius_m=0.08, position_m=np.array([0.25, 0.0, 0.3]), axis=UP)
    image = CoilGeometry(turns=5.0, radius_m=0.08, position_m=np.array([0.25, 0.0, -0.3]), axis=-UP)
    above, below = Ball(np.array([0.0, 0.0, 0.2]), 0.1), Ball(np.array([0.0, 0.0, -0.2]), 0.1)
    points = np.array([[-0.2, 0.1, 0.2], [0.0, 0.0, 0.4], [-0.15, -0.2, 0.3]])
    real = BesideMetal(coil, Metal([above, Sheet(np.zeros(3), UP, 1.6)])).field_per_ampere(points)
    mirrored = sum(BesideMetal(one, Metal([above, below])).field_per_ampere(points) for one in (coil, image))
    alone = sum(BesideMetal(one, Metal([above])).field_per_ampere(points) for one in (coil,))
    error = np.linalg.norm(real - mirrored, axis=1)
    assert np.all(error < 0.1 * np.linalg.norm(mirrored - alone, axis=1))


def test_the_two_materials_answer_with_opposite_signs():
    """In a far field a conductor's moment is -1/2 of the volume's, iron's +1 (times 4 pi a^3)."""
    source = Dipole(CENTRE + 3.0 * UP)
    point = CENTRE[None, :] + np.array([[0.6, 0.0, 0.0]])
    added = {}
    for material in EXACT:
        metal = Metal([Ball(CENTRE, 0.15, material)])
        added[material] = metal.field(metal.strengths(source), point)[0]
    np.testing.assert_allclose(added["iron"], -2.0 * added["conductor"], rtol=0.05)
