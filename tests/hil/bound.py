"""Errors of poses beside the least that any estimate can have, the Cramer-Rao bound of the site's noise."""

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate.fit import whitened_jacobian
from goldfield.locate.uncertainty import cramer_rao_bound
from goldfield.locate.whitening import Independent

WITHIN = 0.3
"""How far from the bound the errors of 20 poses and more may be, as part of it. They scatter by 9 % at the bound."""


def errors(pose, truth):
    """Return the error of a position, m, and of an attitude as a rotation vector, rad: shape (2, 3)."""
    turn = Rotation.from_quat(pose.orientation_xyzw) * Rotation.from_quat(truth.orientation_xyzw).inv()
    return np.array([pose.position_m - truth.position_m, turn.as_rotvec()])


def bound_of_alike(site, truth, covariance_T2):
    """Return the bound at a pose where the errors of fields are alike, as of codes that are shared: shape (6, 6).

    Parameters
    ----------
    site : Site
    truth : Truth
    covariance_T2 : ndarray, shape (n, n)
        Covariance of the fields' components along one axis, T^2; the three axes are independent.
    """
    turn = Rotation.from_quat(truth.orientation_xyzw).as_matrix()
    plain = Independent(np.ones((1, 3, len(site.beacons))))
    jacobian = whitened_jacobian(FieldModel(site.beacons), truth.position_m[None], turn[None], plain)
    axes = jacobian.reshape(6, 3, len(site.beacons))
    return np.linalg.inv(np.einsum("ikn,jkn->ij", axes, np.linalg.solve(covariance_T2, axes[..., None])[..., 0]))


def over_bound(poses, truth, bounds):
    """Return the rms error of position and of attitude, each over its bound in its direction: shape (2,).

    Parameters
    ----------
    poses : sequence of Pose
    truth : mapping
        True poses by epoch.
    bounds : ndarray, shape (e, 6, 6), or (1, 6, 6) for all
    """
    true = [truth[pose.epoch] for pose in poses]
    error = np.array([errors(*pair) for pair in zip(poses, true, strict=True)])
    least = np.stack([bounds[:, :3, :3], bounds[:, 3:, 3:]], axis=1)
    squares = np.einsum("eki,eki->ek", error, np.linalg.solve(least, error[..., None])[..., 0]) / 3.0
    return np.sqrt(squares.mean(axis=0))


def check_at_the_bound(site, poses, truth, within=WITHIN, bound=None):
    """Fail if the errors are further from their bounds than so large a part of them; print how far they are.

    The bound is that of the site's noise, unless one is given, shape (6, 6).
    """
    if bound is None:
        bounds = cramer_rao_bound(site, np.array([truth[pose.epoch].position_m for pose in poses]))
    else:
        bounds = bound[None]
    ratios = over_bound(poses, truth, bounds)
    off_m = np.array([errors(pose, truth[pose.epoch])[0] for pose in poses])
    rms_mm = 1e3 * np.sqrt(np.mean(np.sum(off_m**2, axis=1)))
    bound_mm = 1e3 * np.sqrt(np.mean(np.einsum("ekk->e", bounds[:, :3, :3])))
    print(
        f"error over bound: {ratios[0]:.3f} (position), {ratios[1]:.3f} (attitude), {len(poses)} poses; "
        f"position {rms_mm:.2f} mm, bound {bound_mm:.2f} mm"
    )
    assert np.abs(ratios - 1.0).max() < within
