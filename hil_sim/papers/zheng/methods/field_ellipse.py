"""The field of a dual-axis beacon: a moment that turns in a plane, and what its ellipse tells without an attitude.

Two equal coils along the beacon's x and y carry A cos(2 pi f t) and A sin(2 pi f t) (Zheng et al. 2022, eqns 1 to 4;
eqn 3 prints both as sines). At a point r u from the beacon, u a unit vector at the polar angle phi from the beacon's
z and the azimuth theta, the field is Bc cos + Bs sin with

    Bc = (k/r^3) (3 u_x u - x),   Bs = (k/r^3) (3 u_y u - y),   k = (mu0/4 pi) m                    (eqn 1)

and draws an ellipse. Everything here takes the two vectors in any one frame unless it says otherwise.
"""

from __future__ import annotations

import numpy as np

from goldfield.types import FloatArray


def dual_axis_dipole(offset_m: FloatArray, strength_T_m3: FloatArray | float) -> FloatArray:
    """Return the field of two crossed dipoles along x and y, in the beacon's frame (eqn 1).

    Parameters
    ----------
    offset_m : ndarray, shape (..., 3)
        Vector from the beacon to the point.
    strength_T_m3 : ndarray, shape (...), or float
        k, the magnetic constant over 4 pi times the moment of one coil.

    Returns
    -------
    field_T : ndarray, shape (..., 2, 3)
        Bc and Bs, which are not finite at the beacon itself.
    """
    distance = np.linalg.norm(offset_m, axis=-1)
    unit = offset_m / distance[..., None]
    along = 3.0 * unit[..., :2, None] * unit[..., None, :] - np.eye(3)[:2]
    return np.asarray((strength_T_m3 / distance**3)[..., None, None] * along)


def normal_vector(field_T: FloatArray) -> FloatArray:
    """Return the normal Bc x Bs of the ellipse's plane, shape (..., 3), T^2 (eqn 5).

    In the beacon's frame it is (k/r^3)^2 (3 u_x u_z, 3 u_y u_z, 3 u_z^2 - 2). It does not depend on the phase at which
    a turn begins, since B(t1) x B(t2) is the same multiple of it for any two times a quarter turn apart (eqn 8 has the
    factors in the other order, which turns it round).

    Parameters
    ----------
    field_T : ndarray, shape (..., 2, 3)
        Bc and Bs.
    """
    return np.asarray(np.cross(field_T[..., 0, :], field_T[..., 1, :]))


def direction_from_normal(normal: FloatArray) -> FloatArray:
    """Return the unit vector from beacon to point, from the normal in the beacon's frame, shapes (..., 3).

    With phi_cs the angle of the normal from z: phi = (phi_cs - asin(sin(phi_cs)/3))/2, theta = atan2(n_y, n_x). One
    formula for the three branches of eqn 7, from tan(phi_cs) = 3 sin(2 phi)/(3 cos(2 phi) - 1), that is
    sin(phi_cs - 2 phi) = sin(phi_cs)/3.

    Notes
    -----
    The result is always on the z side of the beacon's plane. Below the plane it is the antipode of the truth: a dipole
    makes the same field at r and -r, so no measurement of one beacon could tell.
    """
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    phi_cs = np.arctan2(np.hypot(x, y), z)
    phi = 0.5 * (phi_cs - np.arcsin(np.sin(phi_cs) / 3.0))
    theta = np.arctan2(y, x)
    return np.stack([np.sin(phi) * np.cos(theta), np.sin(phi) * np.sin(theta), np.cos(phi)], axis=-1)


def semi_axes(field_T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the semi-major and the semi-minor axis of the field's ellipse, shapes (...), T.

    They are the singular values of [Bc Bs], from the sum of their squares |Bc|^2 + |Bs|^2 and their product |Bc x Bs|:
    no attitude enters.

    Parameters
    ----------
    field_T : ndarray, shape (..., 2, 3)
        Bc and Bs.
    """
    total = (field_T**2).sum(axis=(-2, -1))
    product = np.linalg.norm(normal_vector(field_T), axis=-1)
    major = np.sqrt(0.5 * (total + np.sqrt(np.maximum(total**2 - 4.0 * product**2, 0.0))))
    return major, product / np.maximum(major, 1e-300)


def range_and_polar_angle(field_T: FloatArray, strength_T_m3: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Return range (m) and angle from the beacon's z or -z (rad, 0 to pi/2), shapes (...), from the ellipse alone.

    The semi-minor axis is k/r^3 in every direction and the semi-major axis k sqrt(1 + 3 sin^2 phi)/r^3: the moment
    turns through the direction across u in its own plane, where |B| = k/r^3, and through the one nearest to u. This is
    exact for dipoles, and not in the paper. Noise that lifts the ratio of the axes over 2 gives pi/2, below 1 gives 0.

    Parameters
    ----------
    field_T : ndarray, shape (..., 2, 3)
        Bc and Bs in any frame.
    strength_T_m3 : ndarray, shape (...), or float
        k of the beacon.
    """
    major, minor = semi_axes(field_T)
    floor = np.maximum(minor, 1e-300)
    sine_square = np.clip(((major / floor) ** 2 - 1.0) / 3.0, 0.0, 1.0)
    return np.cbrt(strength_T_m3 / floor), np.arcsin(np.sqrt(sine_square))


def rms_strength(field_T: FloatArray) -> FloatArray:
    """Return the root mean square of |B| over a turn, shape (...), T: the received strength (RSSI), free of attitude.

    It is sqrt((|Bc|^2 + |Bs|^2)/2), that is (k/r^3) sqrt(1 + 1.5 sin^2 phi) for a dipole. The paper's eqn 15 takes ln
    of it for a line in ln r; the direction's share (up to ln 1.58) is that line's error.

    Parameters
    ----------
    field_T : ndarray, shape (..., 2, 3)
        Bc and Bs.
    """
    return np.asarray(np.sqrt(0.5 * (field_T**2).sum(axis=(-2, -1))))
