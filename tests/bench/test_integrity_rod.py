"""The steel rod beside the sensor of the integrity figures, against boundary elements, exact spheres and an ODE."""

from __future__ import annotations

import magpylib
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from hil_sim.world.boundary_elements import PERFECT_CONDUCTOR, BoundaryElements, Surface, sphere_surface
from hil_sim.world.sphere import Sphere
from tests.bench.integrity_coils import Coils
from tests.bench.integrity_rod import MU_0, STEEL, Material, Rod, Spheroid, dipole_tensors
from tests.bench.integrity_sites import hall, places

LONG = Spheroid(0.05, 0.005, STEEL)


def spheroid_surface(half_length, half_width):
    """Triangles of a spheroid along x about the origin."""
    return Surface(sphere_surface(np.zeros(3), 1.0, 500).corner_m * [half_length, half_width, half_width])


@pytest.mark.parametrize("permeability", [PERFECT_CONDUCTOR, 5.0, 50.0])
def test_a_spheroid_adds_the_field_that_boundary_elements_give(permeability):
    """The source is so far away that its field is uniform over the body; points lie near and far, any way round."""
    elements = BoundaryElements(spheroid_surface(0.02, 0.01), permeability)
    rod = Rod(np.zeros(3), np.array([1.0, 0.0, 0.0]), Spheroid(0.02, 0.01, Material(0.0, permeability)))
    points, parts = rod.points()
    seen = np.array([[0.03, 0.0, 0.0], [0.0, 0.02, 0.0], [0.015, 0.012, 0.012], [0.06, -0.05, 0.02]])
    source, moment = np.array([3.0, 1.0, -2.0]), np.array([1.0, -2.0, 0.5])
    uniform = dipole_tensors(-source) @ moment
    field = np.einsum("k,pkij->pij", parts, dipole_tensors(seen[:, None] - points)) @ (rod.moments() @ uniform)
    expected = elements.secondary(seen, source, moment)
    error = np.linalg.norm(field - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert error.max() < 0.03


def test_a_step_begins_as_a_perfect_conductor_and_ends_as_a_magnet():
    still = Spheroid(0.05, 0.005, Material(0.0, 200.0)).polarisability(1.0).real
    perfect = Spheroid(0.05, 0.005, Material(0.0, 0.0)).polarisability(1.0).real
    assert LONG.step_response(1e-13) == pytest.approx(perfect, rel=1e-2)
    assert LONG.step_response(1e4) == pytest.approx(still, rel=1e-5)
    assert (perfect < 0).all()
    assert (still > 0).all()


def test_almost_a_sphere_has_the_exact_limits_of_one():
    a3, ball = 0.005**3, Spheroid(0.005001, 0.005, Material(0.0, 50.0))
    assert ball.factors == pytest.approx(1.0 / 3.0, rel=1e-3)
    assert ball.polarisability(1.0).real == pytest.approx(4.0 * np.pi * a3 * 49.0 / 52.0, rel=1e-3)
    chi = Sphere(np.zeros(3), 0.005, np.inf).susceptibilities(1.0, 1)[0].real
    perfect = Spheroid(0.005001, 0.005, Material(0.0, 0.0)).polarisability(1.0).real
    assert perfect == pytest.approx(-4.0 * np.pi * a3 * chi, rel=1e-3)


def test_the_apparent_permeability_is_that_of_the_field_within_a_cylinder():
    """Along: mean flux over the surface's field, by integration of the diffusion equation from the middle outward."""
    b, mu, sigma, s = 0.005, 200.0, 6e6, 3e3
    k2 = s * MU_0 * mu * sigma

    def slope(r, h):
        return [h[1], k2 * h[0] - (h[1] / r if r > 0.0 else k2 * h[0] / 2.0)]

    found = solve_ivp(slope, (0.0, b), [1.0, 0.0], rtol=1e-9, atol=1e-12)
    apparent = mu * 2.0 * found.y[1, -1] / (k2 * b * found.y[0, -1])  # int h 2 r dr = 2 b h'/k2
    endless = Spheroid(1e3, b, Material(sigma, mu))
    volume = 4.0 / 3.0 * np.pi * 1e3 * b**2
    assert endless.polarisability(s)[0] / volume == pytest.approx(apparent - 1.0, rel=1e-4)


def test_a_step_agrees_with_a_sum_over_the_harmonics_of_a_square_wave():
    """The wave's half period is long against the rod's time constants: each edge is a step of two."""
    body = Spheroid(0.05, 0.005, Material(6e6, 20.0))
    half, time = 0.05, 97.75e-6
    perfect = Spheroid(0.05, 0.005, Material(0.0, 0.0)).polarisability(1.0).real
    value = perfect.copy()
    for k in range(1, 20_001, 2):
        seen = body.polarisability(1j * np.pi * k / half) - perfect
        value += 4.0 / (np.pi * k) * (seen * np.exp(1j * np.pi * k * time / half)).imag
    step = 0.5 * (value + body.polarisability(1e-6).real)
    assert body.step_response(time) == pytest.approx(step, rel=1e-2)


def test_a_small_ball_adds_the_exact_static_field_of_one():
    rng = np.random.default_rng(8)
    site = hall(rng, 4)
    position = places(rng, site, 5, near=False)
    rod = Rod(np.array([0.03, 0.01, -0.02]), np.array([0.6, 0.0, 0.8]), Spheroid(0.005001, 0.005, Material(0.0, 50.0)))
    rotation = Rotation.random(5, rng=rng).as_matrix()
    coils = Coils.of(site, 5)
    added = rod.added(coils, position, rotation)
    for e in range(5):
        centre = position[e] + rotation[e] @ rod.centre_m
        local = coils.field(np.tile(centre, (5, 1)))[e]
        ball = magpylib.magnet.Sphere(diameter=0.01, position=centre, polarization=(0, 0, 1))
        for row in range(4):
            ball.polarization = 3.0 * 49.0 / 52.0 * local[row]  # mu_0 M of a sphere in a uniform field
            expected = ball.getB(position[e])
            assert np.linalg.norm(added[e, row] - expected) < 2e-3 * np.linalg.norm(expected)


def test_a_rods_surface_is_at_its_distance():
    for seed in range(20):
        rod = Rod.beside(np.random.default_rng(seed), 0.02)
        turn = np.linspace(-np.pi, np.pi, 200_001)
        sensor = np.array([-rod.centre_m @ rod.along, np.linalg.norm(np.cross(rod.centre_m, rod.along))])
        surface = np.column_stack([0.05 * np.cos(turn), 0.005 * np.sin(turn)])
        assert np.linalg.norm(surface - sensor, axis=1).min() == pytest.approx(0.02, rel=1e-6)
