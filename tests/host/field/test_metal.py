"""What metal adds to the fields: harmonic polynomials against SciPy's spherical harmonics, bodies against magpylib."""

from __future__ import annotations

import math
from dataclasses import replace

import magpylib
import numpy as np
import pytest
from scipy.integrate import lebedev_rule
from scipy.special import sph_harm_y

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.field.harmonics import derivative_matrices, field_norms, harmonic_values
from goldfield.locate import kernel
from goldfield.site import Beacon
from goldfield.site.metal import BeaconMetal, Metal, harmonic_count

DEGREE = 5


def _points(seed: int, count: int = 7) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (3, count))


def test_harmonics_are_those_of_scipy() -> None:
    point = _points(1)
    r = np.linalg.norm(point, axis=0)
    theta, phi = np.arccos(point[2] / r), np.arctan2(point[1], point[0])
    value, row = harmonic_values(point, DEGREE), 0
    for n in range(DEGREE + 1):
        for m in range(n + 1):
            scale = (2 * n + 1) / (4.0 * np.pi) * math.factorial(n - m) * math.factorial(n + m)
            expected = (-1) ** m * r**n * sph_harm_y(n, m, theta, phi) / math.sqrt(scale)
            np.testing.assert_allclose(value[row], expected.real, rtol=0.0, atol=1e-15)
            if m:
                np.testing.assert_allclose(value[row + 1], expected.imag, rtol=0.0, atol=1e-15)
            row += 1 + (m > 0)
    assert row == len(value) == harmonic_count(DEGREE) + 1


@pytest.mark.parametrize("axis", range(3))
def test_derivatives_are_those_of_a_complex_step(axis: int) -> None:
    point = _points(2)
    moved = point.astype(complex)
    moved[axis] += 1e-30j
    expected = harmonic_values(moved, DEGREE).imag / 1e-30
    found = derivative_matrices(DEGREE)[axis] @ harmonic_values(point, DEGREE)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-14)


def test_a_coefficient_is_the_rms_of_its_field_over_the_sphere() -> None:
    point, weight = lebedev_rule(2 * DEGREE + 1)
    value = harmonic_values(point, DEGREE)
    gradient = np.stack([matrix @ value for matrix in derivative_matrices(DEGREE)])[:, 1:]
    square = ((gradient * field_norms(DEGREE)[:, None]) ** 2).sum(axis=0) @ weight / weight.sum()
    np.testing.assert_allclose(square, 1.0, rtol=1e-12)


def _coil(name: str, place: tuple[float, float, float], current: float = 10.0) -> Beacon:
    axis = np.array([0.6, 0.0, 0.8])
    return Beacon(name, np.array(place), axis, 20.0, 0.15, None, current, code=2)


POLARISABILITY = 1e5 * np.array([[2.0, 0.3, -0.1], [0.3, 1.0, 0.2], [-0.1, 0.2, 1.5]])
BODY = np.array([1.4, 0.3, 0.9])


def _metal(**changes: object) -> Metal:
    values: dict[str, object] = {
        "centre_m": np.array([0.2, 0.1, 0.4]),
        "radius_m": 1.3,
        "degree": 3,
        "body_m": BODY[None],
        "polarisability_A_m2_T": POLARISABILITY[None],
        "sd_T_A": 1e-9,
        "walked_m": np.empty((0, 3)),
    }
    return Metal(**{**values, **changes})  # type: ignore[arg-type]


def _beacons(metal: Metal, seed: int = 3) -> list[Beacon]:
    rng = np.random.default_rng(seed)
    places = ((0.0, 0.0, 2.0), (2.0, 0.2, 1.8), (-0.4, 1.9, 2.1))
    return [
        replace(_coil(f"b{i}", place), metal=BeaconMetal(metal, 1e-9 * rng.normal(size=harmonic_count(metal.degree))))
        for i, place in enumerate(places)
    ]


def test_a_body_answers_as_magpylib_says() -> None:
    """The moment follows from magpylib's field of the coil at the body, the body's field is magpylib's dipole."""
    metal = _metal(degree=0)
    beacons = _beacons(metal)
    point = _points(4).T
    found = FieldModel(beacons).field(point) - FieldModel([replace(b, metal=None) for b in beacons]).field(point)
    for row, beacon in enumerate(beacons):
        turned = magpylib.current.Circle(diameter=0.3, current=200.0, position=beacon.position_m)
        turned.rotate_from_angax(math.degrees(math.atan2(0.6, 0.8)), "y", anchor=beacon.position_m)
        moment = POLARISABILITY @ turned.getB(BODY)
        expected = magpylib.misc.Dipole(moment=moment, position=BODY).getB(point)
        np.testing.assert_allclose(found[:, row], expected, rtol=1e-9, atol=1e-18)


def test_gradients_are_those_of_differences() -> None:
    model, point, step = FieldModel(_beacons(_metal())), _points(5).T, 1e-6
    _, gradient = model.field_and_gradient(point)
    for axis in range(3):
        shift = step * np.eye(3)[axis]
        expected = (model.field(point + shift) - model.field(point - shift)) / (2.0 * step)
        np.testing.assert_allclose(gradient[..., axis], expected, rtol=0.0, atol=1e-9 * np.abs(gradient).max())


@pytest.mark.parametrize("degree", range(DEGREE + 1))
def test_the_kernel_agrees(degree: int) -> None:
    """Costs of fits that start and stay at the truth: any difference of the fields would show as residuals."""
    model = FieldModel(_beacons(_metal(degree=degree)))
    position = _points(6, 4).T
    field = model.field(position)
    compiled = kernel.of(model)
    if compiled is None:
        pytest.skip("the kernel is not built")
    _, _, cost, *_ = compiled.fit(
        field,
        np.full(field.shape[:2], 1e-16),
        position,
        np.tile(np.eye(3), (4, 1, 1)),
        errors=None,
        model_error=0.0,
        iterations=0,
        tolerance=1e-9,
    )
    assert np.abs(field).min() > 1e-12
    assert (cost < 1e-2).all()


def test_polynomials_follow_a_distant_source() -> None:
    """What is left of a dipole's field at twice the radius is mainly the next degree: (l + 3)/(2 l + 4) of it."""
    rng = np.random.default_rng(7)
    source = magpylib.misc.Dipole(moment=(1.0, 2.0, 3.0), position=(0.0, 0.0, 2.0))
    inner = rng.normal(size=(200, 3))
    inner *= rng.uniform(0.0, 1.0, 200)[:, None] ** (1 / 3) / np.linalg.norm(inner, axis=1)[:, None]
    field, error = source.getB(inner), []
    for degree in range(1, DEGREE + 1):
        value = harmonic_values(inner.T, degree)
        basis = np.stack([matrix @ value for matrix in derivative_matrices(degree)])[:, 1:]  # (3, k, e)
        rows = basis.transpose(2, 0, 1).reshape(-1, basis.shape[1])
        rest = field.reshape(-1) - rows @ np.linalg.lstsq(rows, field.reshape(-1))[0]
        error.append(float(np.sqrt((rest**2).mean())))
    ratio = np.array(error[1:]) / np.array(error[:-1])
    degrees = np.arange(1, DEGREE)
    np.testing.assert_allclose(ratio, 0.5 * (degrees + 3) / (degrees + 2), rtol=0.05)


def test_metal_follows_the_current() -> None:
    metal = _metal()
    point = _points(8).T
    ten = _beacons(metal)[0]
    twice = replace(ten, current_A=20.0)
    np.testing.assert_allclose(FieldModel([twice]).field(point), 2.0 * FieldModel([ten]).field(point), rtol=1e-12)


def test_beacons_without_metal_are_left_alone() -> None:
    metal = _metal()
    with_metal, without = _beacons(metal)[:2]
    without = replace(without, metal=None)
    point = _points(9).T
    both = FieldModel([with_metal, without]).field(point)
    np.testing.assert_array_equal(both[:, 1], FieldModel([without]).field(point)[:, 0])
    np.testing.assert_allclose(both[:, 0], FieldModel([with_metal]).field(point)[:, 0], rtol=1e-12)


def test_the_walked_room_is_known() -> None:
    corners = np.array(np.meshgrid([0.0, 1.0], [0.0, 2.0], [0.0, 1.0])).reshape(3, -1).T
    model = FieldModel(_beacons(_metal(walked_m=corners)))
    assert model.metal is not None
    inside = model.metal.learned(
        np.array([[0.5, 1.0, 0.5], [0.999, 1.999, 0.999], [1.001, 1.0, 0.5], [0.5, -0.001, 0.5]])
    )
    assert inside.tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"radius_m": 0.0}, "radius_m= of Metal is 0: it must be above 0"),
        ({"degree": 6}, "degree= of Metal is 6: it must be 0 to 5"),
        ({"sd_T_A": -1.0}, "sd_T_A= of Metal is -1: it must be 0 or more"),
        ({"centre_m": np.array([0.0, np.nan, 0.0])}, "centre_m= of Metal must be finite"),
        ({"body_m": np.zeros((9, 3)), "polarisability_A_m2_T": np.zeros((9, 3, 3))}, "has 9 bodies"),
        ({"polarisability_A_m2_T": np.triu(np.ones((3, 3)))[None]}, "must be symmetric"),
    ],
)
def test_nonsense_is_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(UserError, match=words):
        _metal(**changes)


def test_coefficients_belong_to_the_degree() -> None:
    with pytest.raises(UserError, match="degree 3 needs 15 finite numbers"):
        BeaconMetal(_metal(), np.zeros(14))


def test_two_sites_do_not_mix() -> None:
    with pytest.raises(UserError, match="two sites"):
        FieldModel([_beacons(_metal())[0], _beacons(_metal())[1]])
