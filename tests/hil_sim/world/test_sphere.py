"""The exact series of a sphere against its limits, against Maxwell's equations, and against an image."""

from __future__ import annotations

import numpy as np
import pytest

from hil_sim.world.sphere import MU_0, Sphere

CENTRE = np.array([0.1, -0.2, 0.3])
SOURCE = CENTRE + np.array([0.2, 0.3, 1.6])
MOMENT = np.array([0.3, -1.0, 0.5])
N = np.arange(1, 121)


def dipole(point: np.ndarray, source: np.ndarray, moment: np.ndarray) -> np.ndarray:
    r = point - source
    distance = np.linalg.norm(r, axis=-1, keepdims=True)
    return (3.0 * (r @ moment)[..., None] * r / distance**2 - moment) / (4.0 * np.pi * distance**3)


def directions(count: int) -> np.ndarray:
    v = np.random.default_rng(3).normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


@pytest.mark.parametrize("permeability", [1.5, 100.0, 5000.0])
def test_static_limit_is_the_magnetostatic_sphere(permeability: float) -> None:
    slow = Sphere(CENTRE, 1.0, 1e6, permeability).susceptibilities(1e-12)
    static = N * (1.0 - permeability) / (N + 1.0 + N * permeability)
    assert np.abs(slow / static - 1.0).max() < 1e-6


@pytest.mark.parametrize("permeability", [1.0, 100.0])
def test_fast_limit_is_the_perfect_conductor(permeability: float) -> None:
    fast = Sphere(CENTRE, 1.0, 59.9e6, permeability).susceptibilities(1e18)
    assert np.abs(fast / (N / (N + 1.0)) - 1.0).max() < 1e-6
    assert np.abs(Sphere(CENTRE, 1.0, np.inf).susceptibilities(50.0) / (N / (N + 1.0)) - 1.0).max() < 1e-15


def test_no_field_enters_a_perfect_conductor() -> None:
    x = directions(40)
    point = CENTRE + (1.0 + 1e-12) * x
    field = Sphere(CENTRE, 1.0, np.inf).secondary(point, SOURCE, MOMENT, 1.0) + dipole(point, SOURCE, MOMENT)
    assert np.abs((field * x).sum(axis=1)).max() < 1e-9 * np.abs(field).max()


def test_large_perfect_conductor_mirrors_the_dipole() -> None:
    """Seen from near by it is a plane: the image's normal moment is reversed."""
    sphere = Sphere(np.array([0.0, 0.0, -20.0]), 20.0, np.inf)
    source, moment, point = np.array([0.0, 0.0, 9.0]), np.array([1.0, 0.5, 2.0]), np.array([[3.0, 2.0, 6.0]])
    near = [sphere.secondary(s * point, s * source, moment, 1.0) * s**3 for s in (1.0, 0.5)]
    image = dipole(point, source * [1, 1, -1], moment * [1, 1, -1])
    size = np.linalg.norm(image)
    errors = [np.linalg.norm(field - image) / size for field in near]
    assert errors[1] < 0.62 * errors[0] < 0.5


@pytest.mark.parametrize(("skin_depths", "permeability"), [(0.3, 1.0), (3.0, 5.0), (20.0, 1.0), (25.0, 100.0)])
def test_field_is_continuous_and_obeys_maxwell(skin_depths: float, permeability: float) -> None:
    frequency = 1e3
    conductivity = skin_depths**2 / (np.pi * frequency * MU_0 * permeability)
    sphere = Sphere(CENTRE, 1.0, conductivity, permeability)
    x = directions(30)
    out = CENTRE + (1.0 + 1e-10) * x
    outside = sphere.secondary(out, SOURCE, MOMENT, frequency) + dipole(out, SOURCE, MOMENT)
    inside, _ = sphere.interior(CENTRE + (1.0 - 1e-10) * x, SOURCE, MOMENT, frequency)
    size = np.abs(outside).max()
    normal = ((outside - permeability * inside) * x).sum(axis=1)
    assert np.abs(normal).max() < 1e-6 * size
    assert np.abs(np.cross(x, outside - inside)).max() < 1e-6 * size

    step, point = 1e-5, CENTRE + np.array([0.3, -0.5, 0.7])
    shifts = step * np.concatenate([np.eye(3), -np.eye(3)])
    field, current = sphere.interior(point + shifts, SOURCE, MOMENT, frequency)
    slope, turn = (f[:3] - f[3:] for f in (field, current))  # row: derivative by
    curl, curl_current = (
        np.array([d[1, 2] - d[2, 1], d[2, 0] - d[0, 2], d[0, 1] - d[1, 0]]) / (2.0 * step) for d in (slope, turn)
    )
    here, current_here = (f[0] for f in sphere.interior(point[None], SOURCE, MOMENT, frequency))
    assert np.linalg.norm(curl - current_here) < 1e-6 * np.linalg.norm(current_here)
    assert abs(np.trace(slope)) < 1e-6 * np.abs(slope).max()
    # Faraday: curl J = -i omega mu sigma H.
    rate = -2.0j * np.pi * frequency * MU_0 * permeability * conductivity
    assert np.linalg.norm(curl_current - rate * here) < 1e-5 * np.linalg.norm(curl_current)


def test_points_and_sources_on_the_wrong_side_are_refused() -> None:
    sphere = Sphere(CENTRE, 1.0, 1e6)
    with pytest.raises(ValueError, match="inside the sphere"):
        sphere.secondary(CENTRE[None], SOURCE, MOMENT, 1.0)
    with pytest.raises(ValueError, match="dipole is inside"):
        sphere.secondary(SOURCE[None], CENTRE, MOMENT, 1.0)
