"""Field and gradient of a coil in single precision, against magpylib."""

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

AXIS = np.array([0.3, -0.5, 0.81])
AXIS = AXIS / np.linalg.norm(AXIS)
CENTRE = np.array([0.4, -0.2, 1.1], dtype=np.float32)
RADIUS = np.float32(0.149)
MOMENT = 13.25


def reference(points, radius=RADIUS):
    """Field in microtesla, shape (n, 3), in double precision."""
    turn = Rotation.align_vectors(AXIS[None], [[0.0, 0.0, 1.0]])[0]
    if radius == 0.0:
        source = magpylib.misc.Dipole(moment=MOMENT * AXIS, position=CENTRE)
    else:
        current = MOMENT / (np.pi * float(radius) ** 2)
        source = magpylib.current.Circle(current=current, diameter=2 * float(radius), position=CENTRE, orientation=turn)
    return source.getB(points) * 1e6


def computed(core, points, radius=RADIUS):
    """Field and gradient, both ways of the module; what lies behind them stays as it is."""
    ffi, lib = core
    loop = ffi.new("loop_t *", [CENTRE.tolist(), AXIS.tolist(), MOMENT * 0.1, float(radius)])
    field, alone, gradient = ffi.new("float[4]"), ffi.new("float[4]"), ffi.new("float[4][3]")
    field[3] = alone[3] = gradient[3][0] = 7.0
    fields, gradients = [], []
    for point in points:
        place = ffi.new("float[3]", point.tolist())
        lib.loop_field_and_gradient(loop, place, field, gradient)
        lib.loop_field(loop, place, alone)
        assert list(alone) == list(field)
        assert (field[3], gradient[3][0]) == (7.0, 7.0)
        fields.append(list(field)[:3])
        gradients.append([list(row) for row in gradient][:3])
    return np.array(fields), np.array(gradients)


def points_around(distances, rng):
    """Points in single precision at given distances from the centre."""
    direction = rng.normal(size=(len(distances), 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return (CENTRE + distances[:, None] * direction).astype(np.float32)


def least_distance_to_wire(points):
    offset = points.astype(float) - CENTRE
    height = offset @ AXIS
    across = np.linalg.norm(offset - height[:, None] * AXIS, axis=1)
    return np.hypot(across - RADIUS, height)


@pytest.mark.parametrize("radius", [RADIUS, np.float32(0.0)])
def test_field_and_gradient_from_inside_the_coil_to_100_radii(core, radius):
    rng = np.random.default_rng(1)
    points = points_around(RADIUS * 10.0 ** rng.uniform(-2 if radius else 0, 2, 2000), rng)
    wire = least_distance_to_wire(points)
    points, wire = points[wire > 0.1 * RADIUS], wire[wire > 0.1 * RADIUS]
    field, gradient = computed(core, points, radius)
    exact = reference(points.astype(float), radius)
    size = np.linalg.norm(exact, axis=1)
    error = np.linalg.norm(field - exact, axis=1) / size
    step = 1e-5
    moved = [
        (reference(points + step * e, radius) - reference(points - step * e, radius)) / (2 * step) for e in np.eye(3)
    ]
    slope_error = np.linalg.norm(gradient - np.stack(moved, axis=2), axis=(1, 2)) / (size / wire)
    far = np.linalg.norm(points - CENTRE, axis=1) > 2.0 * RADIUS
    for name, values in (("field", error), ("gradient", slope_error)):
        print(f"{name}: far {values[far].max():.1e}, near {values[~far].max(initial=0.0):.1e}")
    assert error[far].max() < 2e-6
    assert slope_error[far].max() < 1e-5
    assert error.max() < 1e-5
    assert slope_error.max() < 2e-4


def test_on_the_axis(core):
    points = (CENTRE + np.array([0.0, 1e-6, 0.05, 0.5, 5.0])[:, None] * AXIS).astype(np.float32)
    field, gradient = computed(core, points)
    exact = reference(points.astype(float))
    np.testing.assert_allclose(field, exact, rtol=1e-5, atol=1e-6 * np.abs(exact).max(axis=1).min())
    assert np.isfinite(gradient).all()
    # No source there: divergence and rotation vanish.
    scale = np.abs(gradient).max(axis=(1, 2)) + 1e-12
    assert (np.abs(np.trace(gradient, axis1=1, axis2=2)) / scale).max() < 1e-4
    assert (np.abs(gradient - gradient.transpose(0, 2, 1)).max(axis=(1, 2)) / scale).max() < 1e-4
