"""The explicit formula and the host's interior fields, against the world's exact sphere and boundary elements."""

from __future__ import annotations

import math

import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield.field.conductor import Material, Parts, ball, cuboid, respond
from goldfield.field.conductor.interior import SkinResponse, VolumeResponse
from goldfield.field.conductor.surface import layer_matrices, stiffness
from hil_sim.world.boundary_elements import PERFECT_CONDUCTOR, BoundaryElements, cube_surface
from hil_sim.world.emitter_world import CUBE_CENTRE_M, CUBE_EDGE_M, MOMENT_A_M2, OFFSET_M
from hil_sim.world.sphere import Sphere

RADIUS_M = 0.031
POINTS = np.array([[0.05, 0.05, 0.0], [0.0, 0.0, -0.2], [0.3, 0.0, -0.1], [-0.2, 0.2, 0.1]])


def exact(conductivity: float, permeability: float, frequency: float) -> np.ndarray:
    sphere = Sphere(CUBE_CENTRE_M, RADIUS_M, conductivity, permeability)
    return np.array([sphere.secondary(POINTS, o, m, frequency) for o, m in zip(OFFSET_M, MOMENT_A_M2, strict=True)])


def relative(found: np.ndarray, truth: np.ndarray) -> float:
    return float((np.linalg.norm(found - truth, axis=-1) / np.linalg.norm(truth, axis=-1)).max())


@pytest.mark.parametrize(
    ("conductivity", "permeability", "pieces", "bound"),
    [(1000.0, 1.0, 8, 0.025), (59.9e6, 1.0, 8, 0.01), (1e5, 100.0, 11, 0.02)],
    ids=["carbon", "copper", "permeable"],
)
def test_papers_materials_against_the_exact_series(
    conductivity: float, permeability: float, pieces: int, bound: float
) -> None:
    response = respond(ball(CUBE_CENTRE_M, RADIUS_M, Material(conductivity, permeability), pieces), 1e4)
    field = response.parts(OFFSET_M, MOMENT_A_M2).field(POINTS)
    assert relative(field, exact(conductivity, permeability, 1e4)) < bound


@pytest.mark.parametrize(("skin_depths", "kind", "bound"), [(1.0, VolumeResponse, 0.04), (4.0, SkinResponse, 0.03)])
def test_where_skin_and_volume_meet(skin_depths: float, kind: type, bound: float) -> None:
    copper = Material(59.9e6)
    frequency = (copper.skin_depth_m(1.0) * skin_depths / RADIUS_M) ** 2
    response = respond(ball(CUBE_CENTRE_M, RADIUS_M, copper, 7), frequency)
    assert isinstance(response, kind)
    field = response.parts(OFFSET_M, MOMENT_A_M2).field(POINTS)
    assert relative(field, exact(59.9e6, 1.0, frequency)) < bound


def test_first_order_holds_only_for_thin_bodies() -> None:
    body = ball(CUBE_CENTRE_M, RADIUS_M, Material(1000.0), 6)
    thin, thick = 1e3, 1e6
    first = {
        f: VolumeResponse(body, f, first_order=True).parts(OFFSET_M, MOMENT_A_M2).field(POINTS) for f in (thin, thick)
    }
    assert relative(first[thin], exact(1000.0, 1.0, thin)) < 0.04
    assert relative(first[thick], exact(1000.0, 1.0, thick)) > 0.3


def test_formula_fed_with_the_exact_interior_field() -> None:
    """Eq. (31) alone: currents and magnetisation together, at four skin depths."""
    permeability, frequency = 20.0, 1e4
    conductivity = (4.0 / RADIUS_M) ** 2 / (math.pi * frequency * 4e-7 * math.pi * permeability)
    sphere = Sphere(CUBE_CENTRE_M, RADIUS_M, conductivity, permeability)
    place, volume = ball(CUBE_CENTRE_M, RADIUS_M, Material(conductivity, permeability), 8).voxels(10)
    arm = place - CUBE_CENTRE_M
    place = CUBE_CENTRE_M + arm * min(1.0, 0.9999 * RADIUS_M / np.linalg.norm(arm, axis=1).max())
    inside = [sphere.interior(place, o, m, frequency, 30) for o, m in zip(OFFSET_M, MOMENT_A_M2, strict=True)]
    field, curl = (np.stack(part) for part in zip(*inside, strict=True))
    parts = Parts.of_interior(place, volume, field, curl, permeability)
    assert relative(parts.field(POINTS), exact(conductivity, permeability, frequency)) < 0.03
    currents_only = Parts(parts.position_m, parts.current_A_m, 0.0 * parts.moment_A_m2)
    assert relative(currents_only.field(POINTS), exact(conductivity, permeability, frequency)) > 0.3


def test_cube_against_boundary_elements() -> None:
    coarse, fine = (
        np.array([elements.secondary(POINTS, o, m) for o, m in zip(OFFSET_M, MOMENT_A_M2, strict=True)])
        for elements in (
            BoundaryElements(cube_surface(CUBE_CENTRE_M, CUBE_EDGE_M, pieces), PERFECT_CONDUCTOR) for pieces in (8, 11)
        )
    )
    truth = fine + (fine - coarse) * 8**2 / (11**2 - 8**2)  # they converge with the square of the size
    body = cuboid(CUBE_CENTRE_M, np.full(3, CUBE_EDGE_M), Material(math.inf), 11)
    assert relative(respond(body, 1e4).parts(OFFSET_M, MOMENT_A_M2).field(POINTS), truth) < 0.025


def test_gradient_is_that_of_the_field() -> None:
    rng = np.random.default_rng(4)
    current, moment = (rng.normal(size=(2, 5, 3)) + 1.0j * rng.normal(size=(2, 5, 3)) for _ in range(2))
    parts = Parts(0.02 * rng.normal(size=(5, 3)), current, moment)
    point, step = np.array([[0.2, -0.1, 0.15]]), 1e-6
    _, gradient = parts.field_and_gradient(point)
    numeric = [(parts.field(point + step * e) - parts.field(point - step * e)) / (2.0 * step) for e in np.eye(3)]
    assert np.abs(gradient - np.stack(numeric, axis=-1)).max() < 1e-6 * np.abs(gradient).max()


def test_layer_potentials_have_the_spheres_eigenvalues() -> None:
    body = ball(np.zeros(3), 1.0, Material(1.0), 9)
    double, single = layer_matrices(body)
    bending = stiffness(body)
    x, y, z = body.corner_m.T
    for order, harmonic in ((1, z), (2, x * y), (3, x * y * z)):
        norm = harmonic @ harmonic
        assert harmonic @ double @ harmonic / norm == pytest.approx(order / (2 * order + 1), rel=0.03)
        value = harmonic @ single @ (bending @ harmonic) / norm
        assert value == pytest.approx(order * (order + 1) / (2 * order + 1), rel=0.06)


def test_bodies_are_closed_and_have_their_volume() -> None:
    edges = np.array([0.1, 0.2, 0.3])
    for body, volume in (
        (cuboid(np.ones(3), edges, Material(1.0), 5), edges.prod()),
        (ball(np.ones(3), 0.2, Material(1.0), 5), 4.0 / 3.0 * math.pi * 0.2**3),
    ):
        assert body.volume_m3 == pytest.approx(volume)
        assert body.voxels(3)[1].sum() == pytest.approx(volume)
        assert np.abs(body.area_m2.sum(axis=0)).max() < 1e-12


def test_bad_input_is_told_in_sentences() -> None:
    with pytest.raises(UserError, match="conductivity"):
        Material(0.0)
    with pytest.raises(UserError, match="permeability"):
        Material(1.0, 0.5)
    with pytest.raises(UserError, match="frequency"):
        Material(1.0).skin_depth_m(0.0)
    with pytest.raises(UserError, match="edges"):
        cuboid(np.zeros(3), np.array([1.0, -1.0, 1.0]), Material(1.0))
    with pytest.raises(UserError, match="skin depths thick"):
        respond(ball(np.zeros(3), 0.01, Material(1e4, 2.0), 4), 10.0)
    inside = respond(ball(np.zeros(3), 0.01, Material(1e7), 4), 1e6)
    with pytest.raises(UserError, match="inside the conductor"):
        inside.parts(np.zeros((1, 3)), np.ones((1, 3)))
