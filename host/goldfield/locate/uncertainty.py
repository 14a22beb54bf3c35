"""Uncertainty of poses: the Cramer-Rao bound, dilution of precision, and a covariance that holds near beacons.

Near a beacon the range is known to micrometres and the direction to centimetres. The set of poses that fit is then a
curved ridge, and an error e along it carries the pose e^2/(2r) off its tangent: hundreds of standard deviations of
the Gauss-Newton covariance, which knows only the tangent. `second_order_covariance` adds the second-order term: with
the model expanded along the principal axes L_i of the Gauss-Newton covariance P = L L', a pose error is

    e = L z - 1/2 K sum_ij z_i z_j h_ij,      z standard normal,  K = P A' W,  h_ij = d2h(L_i, L_j),

so that, with q_ij = L^-1 K h_ij, its mean square is L (I + (m m' + 2 sum_ij q_ij q_ij')/4) L',  m = sum_i q_ii. The
second differences are taken one standard deviation apart, so that they are those of the region that matters.
"""

from __future__ import annotations

import math

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.locate.fit import Measurements, whitened_jacobian
from goldfield.locate.rotations import turned
from goldfield.locate.sensor_axes import axes_of, levers_of
from goldfield.locate.site_errors import SiteErrors, errors_of
from goldfield.locate.whitening import Independent, Whitening, whitening_around
from goldfield.site import Site
from goldfield.types import FloatArray

UNOBSERVABLE = 1e-13
"""Eigenvalue of the information, scaled to a unit diagonal, below which rounding hides it: the direction is free."""

FREE_POSITION_M2 = 1e6
"""Variance reported along a direction of position that the measurements do not tell."""

FREE_TURN_RAD2 = np.pi**2 / 3.0
"""Variance of an angle that is not told: uniform over a full turn."""


def root_covariance(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Split information, shape (e, 6, 6), into a root L of its inverse and the covariance of what it does not tell.

    Returns
    -------
    root : ndarray, shape (e, 6, 6)
        L with L L' = inverse information on the observable space; columns of unobservable directions are zero.
    free : ndarray, shape (e, 6, 6)
        Covariance of the unobservable directions: zero if all is observable.
    """
    if not np.isfinite(information).all():
        # Inside a wire nothing is finite. It tells nothing: a decomposition of what is no number may never end.
        information = np.where(np.isfinite(information).all(axis=(1, 2), keepdims=True), information, 0.0)
    scale = 1.0 / np.sqrt(np.einsum("ekk->ek", information) + 1e-300)
    eigenvalue, vector = np.linalg.eigh(information * scale[:, :, None] * scale[:, None, :])
    seen = eigenvalue > UNOBSERVABLE
    axes = scale[:, :, None] * vector
    free = np.zeros_like(information)
    if seen.all():
        root = axes * (1.0 / np.sqrt(eigenvalue))[:, None, :]
    else:
        root = axes * np.where(seen, 1.0 / np.sqrt(np.where(seen, eigenvalue, 1.0)), 0.0)[:, None, :]
        for e, k in zip(*np.nonzero(~seen), strict=True):
            direction = axes[e, :, k] / np.linalg.norm(axes[e, :, k])
            variance = np.repeat([FREE_POSITION_M2, FREE_TURN_RAD2], 3)
            free[e] += np.outer(direction, direction) * np.sqrt(np.outer(variance, variance))
    return root, free


def gauss_newton_covariance(information: FloatArray) -> FloatArray:
    """Return the inverse information, shape (e, 6, 6).

    Unobservable directions get the variances of this module's constants.
    """
    root, free = root_covariance(information)
    return np.asarray(root @ root.swapaxes(1, 2) + free)


def second_order_covariance(
    model: FieldModel, measurements: Measurements, position_m: FloatArray, rotation: FloatArray
) -> FloatArray:
    """Return the mean square error of fitted poses with the second-order terms of the model.

    Parameters
    ----------
    model : FieldModel
    measurements : Measurements
        e epochs.
    position_m, rotation : ndarray, shapes (e, 3) and (e, 3, 3)
        Fitted.

    Returns
    -------
    covariance : ndarray, shape (e, 6, 6)
        Mean square error of position (m) and a small rotation in the site's frame (rad); positive definite. Where the
        model is not finite one standard deviation away, as on a wire, it is that of a pose of which nothing is told.
    """
    quick = kernel.of(model)
    if quick is not None and measurements.levers is None:
        return quick.covariance(
            measurements.field_T,
            measurements.noise_T,
            position_m,
            rotation,
            errors=measurements.errors,
            least_eigenvalue=UNOBSERVABLE,
            free_m2=FREE_POSITION_M2,
            free_rad2=FREE_TURN_RAD2,
        )
    whitening = measurements.whitening(model, position_m, rotation)
    # In the sensor's frame, where the noise is: in the site's a turn would also turn the frame.
    tangent = whitened_jacobian(model, position_m, rotation, whitening, measurements.levers)
    root, free = root_covariance(tangent @ tangent.swapaxes(1, 2))
    back = tangent.swapaxes(1, 2) @ root  # whitened derivatives along the principal axes: orthonormal columns
    # One standard deviation ahead and back along each axis, all in one evaluation: (axis and sign, epoch).
    count = len(position_m)
    step = np.concatenate([root, -root], axis=2).transpose(2, 0, 1).reshape(12 * count, 6)
    moved = np.tile(position_m, (12, 1)) + step[:, :3], turned(np.tile(rotation, (12, 1, 1)), step[:, 3:])
    displaced = whitened_jacobian(model, *moved, whitening.tiled(12), measurements.levers).reshape(2, 6, count, 6, -1)
    q = (0.5 * (root.swapaxes(1, 2) @ (displaced[0] - displaced[1])) @ back).swapaxes(0, 1)
    q = 0.5 * (q + q.swapaxes(1, 2))
    mean = np.einsum("eiik->ek", q)
    bends = np.concatenate([0.5 * mean[:, None], math.sqrt(0.5) * q.reshape(count, 36, 6)], axis=1)
    shown = np.concatenate([root, root @ bends.swapaxes(1, 2)], axis=2)  # a sum of squares, however large they are
    covariance = shown @ shown.swapaxes(1, 2) + free
    told = np.isfinite(covariance).all(axis=(1, 2), keepdims=True)
    nothing = np.diag(np.repeat([FREE_POSITION_M2, FREE_TURN_RAD2], 3))
    return np.asarray(np.where(told, covariance, nothing) + _common_turn(measurements.errors))


def _common_turn(errors: SiteErrors | None) -> FloatArray:
    """Return the covariance, shape (6, 6), of the turn by which all axes of the sensor lean alike."""
    variance = 0.0 if errors is None else errors.common_turn_rad2
    return np.diag(np.repeat([0.0, variance], 3))


def cramer_rao_bound(
    site: Site,
    position_m: FloatArray,
    rotation: FloatArray | None = None,
    *,
    sigma_T: FloatArray | None = None,
    noise_only: bool = False,
) -> FloatArray:
    """Return the least covariance that any unbiased estimator of the pose can have.

    The declared errors of the site and the sensor count as noise whose size is known.

    Parameters
    ----------
    site : Site
    position_m : ndarray, shape (e, 3)
    rotation : ndarray, shape (e, 3, 3), optional
        Only matters to sensors with fewer than three axes or noise that differs between them.
    sigma_T : ndarray, broadcast to shape (e, n, 3), optional
        Standard deviation of each component, infinite where there is no such axis. Default: the sensor's noise per
        sample over the square root of the number of chips.
    noise_only : bool
        Leave out the errors of the site and the sensor: the bound of a single noise, as papers quote it.

    Returns
    -------
    covariance : ndarray, shape (e, 6, 6)
        Covariance of position (m) and a small rotation in the site's frame (rad).
    """
    count = len(position_m)
    if sigma_T is None:
        axes = axes_of(site.sensor)
        ratio = 1.0 if axes is None else axes.noise_ratio
        sigma_T = np.array(ratio * site.sensor.noise_T / np.sqrt(site.chips))
    sigma = np.broadcast_to(sigma_T, (count, len(site.beacons), 3))
    turn = np.broadcast_to(np.eye(3), (count, 3, 3)) if rotation is None else rotation
    model, errors = FieldModel(site.beacons), None if noise_only else errors_of(site.beacons, site.sensor)
    whitening: Whitening = Independent((1.0 / sigma).swapaxes(1, 2))
    if errors is not None:
        whitening = whitening_around(model, errors, sigma, position_m, turn)
    jacobian = whitened_jacobian(model, position_m, turn, whitening, levers_of(site.sensor))
    return gauss_newton_covariance(jacobian @ jacobian.swapaxes(1, 2)) + _common_turn(errors)


def dilution_of_precision(site: Site, position_m: FloatArray) -> FloatArray:
    """Return the position error (root of the sum of variances) over the noise of a component, m/T, shape (e,).

    Multiply by the standard deviation of a separated component for the error in metres.
    """
    bound = cramer_rao_bound(site, position_m, sigma_T=np.array(1.0), noise_only=True)
    return np.asarray(np.sqrt(np.einsum("ekk->e", bound[:, :3, :3])))
