"""What the fields of some beacons tell of a pose: whitened columns of the model, and the matrices made of them.

A component's error is that of `goldfield.locate.site_errors`. Written in the site's frame, the covariance of one
beacon's components, C_i, does not depend on the sensor's orientation, and neither does what the pose does to them. Only
the errors of the sensor's own axes do: (I + E) with E symmetric in the sensor's frame. As R E R' is symmetric too, its
effects are combinations of those of the six symmetric matrices of the site's frame, whatever R is. So twelve columns a
beacon are enough for every orientation: three of place, three of attitude and six of distortion, and

    M = sum_i A_i' C_i^-1 A_i        (12 x 12)

is all that a point needs. With T the 6 x 6 matrix that turns unit errors of the sensor into distortions of the site's
frame, the joint covariance of pose and distortion is that of M with the prior (T T')^-1 on the latter. Where the
sensor is exact six columns do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.locate.site_errors import SiteErrors
from goldfield.locate.uncertainty import root_covariance
from goldfield.types import FloatArray

SYMMETRIC = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
"""Row and column of the six symmetric matrices that are the basis of distortions."""

ORIENTATIONS = Rotation.from_rotvec(0.25 * np.pi * np.vstack([np.zeros(3), np.eye(3)])).as_matrix()
"""Orientations over which bounds are averaged, shape (4, 3, 3): the sensor's axes along the site's, and turned by half
a right angle about each. Quarter turns change nothing, since the axes are alike."""


def pose_columns(field_T: FloatArray, gradient_T_m: FloatArray) -> FloatArray:
    """Return derivatives of fields by place and by a small turn of the sensor, shape (6, 3, e, n), components second.

    Parameters
    ----------
    field_T, gradient_T_m : ndarray, shapes (3, e, n) and (3, 3, e, n)
        As `FieldModel.evaluate` returns them.
    """
    x, y, z = field_T
    column = np.zeros((6, *field_T.shape))
    column[:3] = gradient_T_m.swapaxes(0, 1)
    column[3, 1], column[3, 2] = z, -y
    column[4, 0], column[4, 2] = -z, x
    column[5, 0], column[5, 1] = y, -x
    return column


def distortion_columns(field_T: FloatArray) -> FloatArray:
    """Return what each of the symmetric distortions adds to fields, shape (6, 3, e, n)."""
    column = np.zeros((6, *field_T.shape))
    for k, (i, j) in enumerate(SYMMETRIC):
        column[k, i] = field_T[j]
        column[k, j] = field_T[i]
    return column


def turned_distortions(errors: SiteErrors, rotation: FloatArray) -> FloatArray:
    """Return T, shape (6, 6): columns of one standard deviation of each of the sensor's errors, in the site's frame."""
    lean = errors.sensor_axis_sd_rad * np.sqrt(0.5)
    turned = np.empty((6, 6))
    for k, (i, j) in enumerate(SYMMETRIC):
        error = np.zeros((3, 3))
        error[i, j] = error[j, i] = errors.gain_sd if i == j else lean
        turned[:, k] = [(rotation @ error @ rotation.T)[index] for index in SYMMETRIC]
    return turned


def covariance_of_beacons(
    errors: SiteErrors | None, sigma_T: FloatArray, offset_m: FloatArray, field_T: FloatArray, gradient_T_m: FloatArray
) -> FloatArray:
    """Return the covariances C_i of beacons' components in the site's frame, shape (3, 3, e, n), T^2.

    Parameters
    ----------
    errors : SiteErrors or None
    sigma_T : ndarray, shape (n,)
        Standard deviation of a component by noise.
    offset_m : ndarray, shape (3, e, n)
        Points seen from the beacons.
    """
    covariance = np.zeros((3, *field_T.shape))
    for i in range(3):
        covariance[i, i] = sigma_T**2
    if errors is None:
        return covariance
    x, y, z = offset_m
    turn = -pose_columns(field_T, gradient_T_m)[3:]
    gx, gy, gz = gradient_T_m.swapaxes(0, 1)
    turn = turn + np.stack([gy * z - gz * y, gz * x - gx * z, gx * y - gy * x])
    effects = (
        (errors.position_sd_m**2, gradient_T_m.swapaxes(0, 1)),
        (errors.axis_sd_rad**2, turn),
        (errors.current_sd**2, field_T[None]),
    )
    for variance, effect in effects:
        if not variance.any():
            continue
        for i in range(3):
            for j in range(i + 1):
                part = variance * (effect[:, i] * effect[:, j]).sum(axis=0)
                covariance[i, j] += part
                if i != j:
                    covariance[j, i] += part
    return covariance


def whitened(covariance: FloatArray, column: FloatArray) -> FloatArray:
    """Return columns, shape (k, 3, e, n), multiplied by the inverse Cholesky factors of C_i: shape (e, n, 3, k)."""
    c = covariance
    l00 = np.sqrt(c[0, 0])
    l10, l20 = c[1, 0] / l00, c[2, 0] / l00
    l11 = np.sqrt(c[1, 1] - l10 * l10)
    l21 = (c[2, 1] - l20 * l10) / l11
    l22 = np.sqrt(c[2, 2] - l20 * l20 - l21 * l21)
    result = np.empty((*column.shape[2:], 3, len(column)))
    first = column[:, 0] / l00
    second = (column[:, 1] - l10 * first) / l11
    third = (column[:, 2] - l20 * first - l21 * second) / l22
    for i, row in enumerate((first, second, third)):
        result[:, :, i] = np.moveaxis(row, 0, -1)
    return result


def gram(columns: FloatArray) -> FloatArray:
    """Return the sums of the products of whitened columns, shape (e, n, 3, k), over the beacons: M, shape (e, k, k)."""
    flat = columns.reshape(len(columns), -1, columns.shape[-1])
    return np.asarray(flat.swapaxes(1, 2) @ flat)


def distortion_covariance(own: FloatArray, distortion: FloatArray) -> FloatArray:
    """Return the covariance of the distortion where the pose is known, shape (e, 6, 6).

    Parameters
    ----------
    own : ndarray, shape (e, 6, 6)
        Block of M.
    distortion : ndarray, shape (6, 6)
        T.
    """
    return np.asarray(distortion @ np.linalg.inv(np.eye(6) + distortion.T @ own @ distortion) @ distortion.T)


@dataclass(frozen=True, eq=False)
class Joint:
    """Covariance of pose and distortion at e points.

    Attributes
    ----------
    covariance : ndarray, shape (e, k, k)
        k is 12, or 6 for an exact sensor; directions that are not told do not count.
    free : ndarray, shape (e, 6, 6)
        Covariance of the pose along the directions that are not told: zero if all is.
    """

    covariance: FloatArray
    free: FloatArray


def joint_covariance(information: FloatArray, distortion: FloatArray | None) -> Joint:
    """Return the covariance of pose and distortion.

    Parameters
    ----------
    information : ndarray, shape (e, k, k)
        M.
    distortion : ndarray, shape (6, 6), or None
        T; None for an exact sensor.
    """
    pose = information[:, :6, :6]
    if distortion is None:
        root, free = root_covariance(pose)
        return Joint(root @ root.swapaxes(1, 2), free)
    cross, own = information[:, 6:, :6], information[:, 6:, 6:]
    posterior = distortion_covariance(own, distortion)
    gain = posterior @ cross  # distortion by pose
    root, free = root_covariance(pose - cross.swapaxes(1, 2) @ gain)
    covariance = np.empty_like(information)
    covariance[:, :6, :6] = root @ root.swapaxes(1, 2)
    covariance[:, 6:, :6] = -gain @ covariance[:, :6, :6]
    covariance[:, :6, 6:] = covariance[:, 6:, :6].swapaxes(1, 2)
    covariance[:, 6:, 6:] = posterior - covariance[:, 6:, :6] @ gain.swapaxes(1, 2)
    return Joint(covariance, free)
