"""Boundary elements: of a sphere against the exact series; of a cube against finer ones of itself."""

from __future__ import annotations

import numpy as np
import pytest

from hil_sim.world.boundary_elements import PERFECT_CONDUCTOR, BoundaryElements, cube_surface, sphere_surface
from hil_sim.world.emitter_world import CUBE_CENTRE_M, CUBE_EDGE_M, MOMENT_A_M2, OFFSET_M
from hil_sim.world.sphere import Sphere

POINTS = np.array([[0.05, 0.05, 0.0], [0.0, 0.0, -0.2], [0.3, 0.0, -0.1], [-0.2, 0.2, 0.1]])


def relative(a: np.ndarray, b: np.ndarray) -> float:
    return float((np.linalg.norm(a - b, axis=-1) / np.linalg.norm(b, axis=-1)).max())


@pytest.mark.parametrize("permeability", [PERFECT_CONDUCTOR, 1.5, 100.0])
def test_a_sphere_is_within_two_per_cent_of_the_series(permeability: float) -> None:
    elements = BoundaryElements(sphere_surface(CUBE_CENTRE_M, 0.031, 400), permeability)
    exact = (
        Sphere(CUBE_CENTRE_M, 0.031, np.inf) if permeability == 0.0 else Sphere(CUBE_CENTRE_M, 0.031, 1.0, permeability)
    )
    for source, moment in zip(OFFSET_M, MOMENT_A_M2, strict=True):
        truth = exact.secondary(POINTS, source, moment, 1e-9).real
        assert relative(elements.secondary(POINTS, source, moment), truth) < 0.01


def test_a_cube_converges() -> None:
    coarse, middle, fine = (
        BoundaryElements(cube_surface(CUBE_CENTRE_M, CUBE_EDGE_M, pieces), PERFECT_CONDUCTOR).secondary(
            POINTS, OFFSET_M[0], MOMENT_A_M2[0]
        )
        for pieces in (5, 7, 10)
    )
    assert relative(middle, fine) < 0.03
    assert relative(middle, fine) < 0.6 * relative(coarse, fine)
