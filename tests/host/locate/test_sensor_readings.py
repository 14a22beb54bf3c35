"""What the readings of a sensor's axes say of the field: components, their noise, and where they were read."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.locate.sensor_axes import axes_of, levers_of
from goldfield.site import SensorSite

LEANING = np.array([[1.02, 0.3, 0.1], [0.2, -0.95, 0.04], [0.0, 0.1, 0.2]])
TWO = np.array([[1.0, 0.0, 0.0], [0.6, -0.8, 0.0]])
ONE = np.array([[1.3, 0.0, 0.0]])
SQUARE = np.diag([2.0, -0.5, 1.0])
RATIO = np.array([0.5, 1.0, 1.3])


@pytest.mark.parametrize("axes", [LEANING, TWO, ONE, SQUARE])
@pytest.mark.parametrize("ratio", [None, RATIO])
def test_components_are_those_that_the_axes_read(axes, ratio):
    """With fewer axes the components along the sensor's first axes, of fields that have no others."""
    count = len(axes)
    undo = axes_of(SensorSite(1e-7, axes=axes, noise_ratio=None if ratio is None else ratio[:count]))
    rng = np.random.default_rng(1)
    field = rng.normal(size=(4, 5, 3))
    field[..., count:] = 0.0
    readings = np.full((4, 5, 3), np.nan)
    readings[..., :count] = field @ axes.T
    found = undo.components(readings)
    assert (undo.count, undo.inverse.shape) == (count, (3, 3))
    np.testing.assert_allclose(found[..., :count], field[..., :count], atol=1e-12)
    assert np.isnan(found[..., count:]).all()


@pytest.mark.parametrize("axes", [LEANING, TWO, ONE, SQUARE])
@pytest.mark.parametrize("ratio", [None, RATIO])
def test_noise_of_the_components_is_that_of_the_readings_undone(axes, ratio):
    """By the sum over readings of what a deviation of one does."""
    count = len(axes)
    each = np.ones(count) if ratio is None else ratio[:count]
    undo = axes_of(SensorSite(1e-7, axes=axes, noise_ratio=None if ratio is None else each))
    covariance = np.zeros((count, count))
    for k in range(count):
        readings = np.zeros(3)
        readings[k] = each[k]
        effect = undo.components(readings)[:count]
        covariance += np.outer(effect, effect)
    mean = np.trace(covariance) / count
    np.testing.assert_allclose(undo.noise_ratio, np.sqrt(mean))
    np.testing.assert_allclose(undo.noise_shape[:count, :count], covariance / mean)
    np.testing.assert_array_equal(undo.noise_shape[count:, count:], np.eye(3)[count:, count:])
    assert not undo.noise_shape[count:, :count].any()
    np.testing.assert_allclose(undo.noise_of_each[:count], np.sqrt(np.diag(covariance)))


@pytest.mark.parametrize(("axes", "lost"), [(SQUARE, [False, True, False]), (LEANING, [True, True, True])])
def test_a_missing_reading_takes_with_it_what_it_has_a_part_in(axes, lost):
    readings = np.array([1.0, np.nan, 3.0])
    assert np.isnan(axes_of(SensorSite(1e-7, axes=axes)).components(readings)).tolist() == lost


def test_axes_that_read_the_components_as_they_are_need_no_undoing():
    assert axes_of(SensorSite(1e-7)) is None
    noise = axes_of(SensorSite(1e-7, noise_ratio=RATIO))
    np.testing.assert_array_equal(noise.components(np.ones(3)), np.ones(3))


LEVERS = 1e-3 * np.array([[12.0, -3.0, 5.0], [-4.0, 15.0, 2.0], [6.0, 2.0, -14.0]])


@pytest.mark.parametrize("axes", [None, LEANING, SQUARE])
@pytest.mark.parametrize("same", [False, True])
def test_fields_at_several_places_are_read_as_the_axes_do(axes, same):
    """A field that changes with the place, read by each axis at its own; two axes may be at one place."""
    lever = LEVERS.copy()
    if same:
        lever[2] = lever[0]
    levers = levers_of(SensorSite(1e-7, axes=axes, lever_m=lever))
    assert len(levers.lever_m) == (2 if same else 3)
    rng = np.random.default_rng(2)
    gradient = rng.normal(size=(3, 3))
    rows = np.eye(3) if axes is None else axes
    readings = np.array([row @ (gradient @ place) for row, place in zip(rows, lever, strict=True)])
    found = sum(part @ gradient @ place for part, place in zip(levers.part, levers.lever_m, strict=True))
    np.testing.assert_allclose(found, np.linalg.inv(rows) @ readings, atol=1e-14)
    np.testing.assert_allclose(levers.part.sum(axis=0), np.eye(3), atol=1e-14)
    assert levers.reach_m == pytest.approx(np.sqrt((lever**2).sum(axis=1)).max())


def test_axes_that_are_not_there_are_at_the_reference_point():
    levers = levers_of(SensorSite(1e-7, axes=TWO, lever_m=LEVERS[:2]))
    assert sorted(levers.lever_m.tolist()) == sorted([*LEVERS[:2].tolist(), [0.0, 0.0, 0.0]])
    assert levers_of(SensorSite(1e-7)) is None
