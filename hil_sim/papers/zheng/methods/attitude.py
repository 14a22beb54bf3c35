"""Attitude from the normals of the ellipses, once the position is known."""

from __future__ import annotations

import numpy as np

from goldfield.locate.wahba import wahba
from goldfield.site.rotating import RotatingSite
from goldfield.types import FloatArray
from hil_sim.papers.zheng.methods.field_ellipse import direction_from_normal, dual_axis_dipole, normal_vector


def yaw_only_attitude(beacon_m: FloatArray, position_m: FloatArray, field_T: FloatArray) -> FloatArray:
    """Return the attitude matrix as printed (eqns 18 to 22), right for a turn about the beacons' z only.

    Each ellipse measured in the sensor's frame is turned into a direction as if it had been measured in the beacon's,
    and C = B A^T (A A^T)^-1 maps the true directions A to these B. But the step from a normal to a direction does not
    commute with a tilt: in the paper's room, 0.5 m over the floor, a tilt of 2 degrees turns the result by 14 degrees.
    Use `attitude_from_normals`.

    Parameters
    ----------
    beacon_m : ndarray, shape (n, 3)
        Places of at least three beacons with axes parallel to the site's.
    position_m : ndarray, shape (e, 3)
    field_T : ndarray, shape (e, n, 2, 3)
        Bc and Bs in the sensor's frame.

    Returns
    -------
    attitude : ndarray, shape (e, 3, 3)
        C, from the site's frame to the sensor's; in general no rotation. NaN where the directions lie in a plane.
    """
    offset = position_m[:, None, :] - beacon_m
    true = offset / np.linalg.norm(offset, axis=2, keepdims=True)
    pseudo = direction_from_normal(normal_vector(field_T))
    squares = true.swapaxes(1, 2) @ true
    regular = np.linalg.cond(squares) < 1e12
    safe = np.where(regular[:, None, None], squares, np.eye(3))
    attitude = pseudo.swapaxes(1, 2) @ true @ np.linalg.inv(safe)
    return np.where(regular[:, None, None], attitude, np.nan)


def printed_angles(attitude: FloatArray) -> FloatArray:
    """Return psi, gamma, lambda in radians, shape (e, 3), of an attitude matrix C, shape (e, 3, 3) (eqn 23)."""
    psi = -np.arcsin(np.clip(attitude[:, 2, 0], -1.0, 1.0))
    gamma = np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0])
    return np.stack([psi, gamma, np.arctan2(attitude[:, 2, 1], attitude[:, 2, 2])], axis=1)


def attitude_from_normals(site: RotatingSite, position_m: FloatArray, field_T: FloatArray) -> FloatArray:
    """Return the rotation R, ``B_site = R B_sensor``, that best turns the measured normals onto those at the position.

    This is Wahba's problem. The result holds for any attitude, and for beacons that stand at any angle. Every
    beacon counts alike: with a position from strengths the error is that of the position, not the noise.

    Parameters
    ----------
    site : RotatingSite
        n beacons.
    position_m : ndarray, shape (e, 3)
    field_T : ndarray, shape (e, n, 2, 3)
        Bc and Bs in the sensor's frame.

    Returns
    -------
    rotation : ndarray, shape (e, 3, 3)
    """
    frame = site.frame
    offset = np.einsum("nji,enj->eni", frame, position_m[:, None, :] - site.position_m)
    modelled = np.einsum("nij,enj->eni", frame, normal_vector(dual_axis_dipole(offset, site.strength_T_m3)))
    measured = normal_vector(field_T)
    return wahba(_unit(modelled), _unit(measured), np.ones(measured.shape[:2]))


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-300))
