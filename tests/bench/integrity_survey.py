"""Errors of survey and sensor: drawn for the truth, and the bound of a pose that includes them.

The derivatives are differences of magpylib's fields, so that neither the truth nor the bound knows the host's model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.site import Site
from tests.bench.integrity_coils import Coils
from tests.bench.integrity_sites import Errors

FloatArray = NDArray[np.float64]

STEP_M = 1e-4
STEP_RAD = 1e-4


def really(site: Site, count: int, errors: Errors, rng: np.random.Generator) -> tuple[Coils, FloatArray]:
    """Draw what a site is really like, anew for each epoch.

    Each epoch is a site and a sensor of its own, so that means over epochs are those over sites.

    Returns
    -------
    coils : Coils
    sensor : ndarray, shape (e, 3, 3)
        The sensor's matrix: gains on its diagonal, axes that are off beside it.
    """
    coils = Coils.of(site, count)
    shape = coils.axis.shape
    true = coils.moved(errors.position_m * rng.normal(size=shape))
    true = true.turned(errors.axis_rad * rng.normal(size=shape))
    true = true.scaled(1.0 + errors.current * rng.normal(size=shape[:2]))
    size = np.where(np.eye(3, dtype=bool), errors.gain, errors.sensor_axis_rad)
    return true, np.eye(3) + size * rng.normal(size=(count, 3, 3))


def bound_m(site: Site, position_m: FloatArray, rotation: FloatArray, sigma_T: float, errors: Errors) -> FloatArray:
    """Return the least root of the mean square position error, shape (e,), m, noise and errors together.

    Parameters
    ----------
    site : Site
    position_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
    sigma_T : float
        Noise of each separated component.
    errors : Errors
    """
    coils = Coils.of(site, len(position_m))
    field = coils.field(position_m)
    wanted = np.concatenate([slopes(coils, position_m), turns(field)], axis=3)  # (e, n, 3, 6)
    parts = [errors.position_m * wanted[..., :3], errors.axis_rad * _axes(coils, position_m)]
    own = np.concatenate([*parts, errors.current * field[..., None]], axis=3)
    count, beacons = field.shape[:2]
    covariance = np.zeros((count, beacons, 3, beacons, 3))
    each = np.arange(beacons)
    covariance[:, each, :, each] += np.moveaxis(own @ own.swapaxes(2, 3) + sigma_T**2 * np.eye(3), 1, 0)
    common = _sensor(field, rotation, errors)
    covariance += np.einsum("enik,emjk->enimj", common, common)
    jacobian = wanted.reshape(count, 3 * beacons, 6)
    weight = np.linalg.inv(covariance.reshape(count, 3 * beacons, 3 * beacons) / sigma_T**2)
    scale = np.linalg.norm(jacobian, axis=1)[:, None]
    information = (jacobian / scale).swapaxes(1, 2) @ weight @ (jacobian / scale)
    least = sigma_T**2 * np.linalg.inv(information) / (scale.swapaxes(1, 2) * scale)
    return np.sqrt(np.einsum("ekk->e", least[:, :3, :3]))


def slopes(coils: Coils, position_m: FloatArray) -> FloatArray:
    """Derivatives of the fields by the position, shape (e, n, 3, 3), column j along axis j."""
    steps = STEP_M * np.eye(3)
    ends = [coils.field(position_m + step) - coils.field(position_m - step) for step in steps]
    return np.stack(ends, axis=3) / (2.0 * STEP_M)


def _axes(coils: Coils, position_m: FloatArray) -> FloatArray:
    """Derivatives of the fields by turns of each coil about its centre, shape (e, n, 3, 3)."""
    steps = STEP_RAD * np.eye(3)
    ends = [coils.turned(step).field(position_m) - coils.turned(-step).field(position_m) for step in steps]
    return np.stack(ends, axis=3) / (2.0 * STEP_RAD)


def turns(field_T: FloatArray) -> FloatArray:
    """Derivatives of what a sensor measures by its turn, in the site's frame, shape (e, n, 3, 3)."""
    return np.stack([np.cross(field_T, axis) for axis in np.eye(3)], axis=3)


def _sensor(field_T: FloatArray, rotation: FloatArray, errors: Errors) -> FloatArray:
    """Effect of one standard deviation of each of the sensor's nine errors, site's frame, shape (e, n, 3, 9)."""
    seen = np.einsum("eki,enk->eni", rotation, field_T)
    size = np.where(np.eye(3, dtype=bool), errors.gain, errors.sensor_axis_rad)
    effect = np.zeros((*field_T.shape, 3, 3))
    for i in range(3):
        for j in range(3):
            effect[:, :, i, i, j] = size[i, j] * seen[:, :, j]
    effect = effect.reshape(*field_T.shape, 9)
    return np.asarray(np.einsum("eij,enjk->enik", rotation, effect))
