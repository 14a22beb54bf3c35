"""Position and attitude from the ellipses with no prior and no map: their axes first, then all components."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.fit import Fit, Measurements, fit_pose
from goldfield.locate.least_squares import State, minimise
from goldfield.locate.wahba import wahba
from goldfield.site.rotating import RotatingSite
from goldfield.types import FloatArray
from hil_sim.papers.zheng.methods.field_ellipse import range_and_polar_angle
from hil_sim.papers.zheng.methods.trilateration import trilaterate

START_MODEL_ERROR = 0.03
"""Relative error granted to the model in the first fit, so that strong and curved near fields do not dominate it."""


def position_from_axes(site: RotatingSite, field_T: FloatArray, sigma_T: FloatArray) -> FloatArray:
    """Return positions, shape (e, 3), from the semi-axes alone: ranges and heights over each beacon's plane.

    Parameters
    ----------
    site : RotatingSite
        n >= 3 beacons, taken for dipoles.
    field_T : ndarray, shape (e, n, 2, 3)
        Bc and Bs in any frame.
    sigma_T : ndarray, shape (n,)
        Standard deviation of each component.

    Notes
    -----
    A relative error d of the axes, from noise and from the coil's size, (radius/r)^2, makes a relative error d/3 of the
    range and one of (2 + 2 sin^2 phi)/cos phi times that of the height: it knows nothing at the horizon.
    """
    range_m, polar = range_and_polar_angle(field_T, site.strength_T_m3)
    height_m = range_m * np.cos(polar)
    radius_m = np.array([beacon.radius_m for beacon in site.beacons])
    axes_error = np.hypot(sigma_T * range_m**3 / site.strength_T_m3, (radius_m / range_m) ** 2)
    weight_range = 3.0 / (axes_error * range_m)
    weight = np.hstack([weight_range, weight_range * np.cos(polar) / (2.0 + 2.0 * np.sin(polar) ** 2)])
    beacon, normal = site.position_m, site.frame[:, :, 2]
    start = trilaterate(beacon, range_m, site.up)

    def evaluate(state: State, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        offset = state[0][:, None, :] - beacon
        distance = np.linalg.norm(offset, axis=2)
        residual = np.hstack([range_m[rows] - distance, height_m[rows] - np.einsum("enj,nj->en", offset, normal)])
        slope = np.concatenate(
            [offset / np.maximum(distance, 1e-9)[:, :, None], np.broadcast_to(normal, offset.shape)], axis=1
        )
        w = weight[rows]
        return residual * w, (slope * w[:, :, None]).swapaxes(1, 2)

    return minimise(evaluate, lambda state, step: (state[0] + step,), (start,), tolerance=1e-12).state[0]


def locate_by_ellipse(site: RotatingSite, field_T: FloatArray, sigma_T: FloatArray) -> Fit:
    """Return the poses of e epochs, with no prior.

    The axes of the ellipses give a position, Wahba's problem on all components there an attitude, and a fit of position
    and attitude to all components, with the coils as loops of their size, the rest: a dual-axis beacon is two coils
    in one place, which `fit_pose` knows how to treat.

    Parameters
    ----------
    site : RotatingSite
        n >= 3 beacons.
    field_T : ndarray, shape (e, n, 2, 3)
        Bc and Bs in the sensor's frame.
    sigma_T : ndarray, shape (n,)
        Standard deviation of each component.
    """
    epochs = len(field_T)
    model = FieldModel([coil for beacon in site.beacons for coil in beacon.coils()])
    measured = field_T.reshape(epochs, -1, 3)
    sigma = np.tile(np.repeat(sigma_T, 2), (epochs, 1))
    position = position_from_axes(site, field_T, sigma_T)
    modelled = model.field(position)
    weight = 1.0 / (sigma**2 + (START_MODEL_ERROR * np.linalg.norm(measured, axis=2)) ** 2)
    measurements = Measurements(measured, sigma)
    rough = fit_pose(model, measurements, position, wahba(modelled, measured, weight), model_error=START_MODEL_ERROR)
    return fit_pose(model, measurements, rough.position_m, rough.rotation)
