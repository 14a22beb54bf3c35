"""Wahba's problem: the rotation between two sets of vectors."""

from __future__ import annotations

import numpy as np

from goldfield.poses import FloatArray


def wahba(site: FloatArray, sensor: FloatArray, weight: FloatArray) -> FloatArray:
    """Rotation R that minimises sum_i w_i |site_i - R sensor_i|^2, by singular values (Markley).

    Parameters
    ----------
    site, sensor : ndarray, shape (..., n, 3)
        The same vectors in both frames.
    weight : ndarray, shape (..., n)
        Inverse variances; 0 leaves a pair out.

    Returns
    -------
    rotation : ndarray, shape (..., 3, 3)
        ``B_site = R B_sensor``. At least two pairs of different directions make it unique.
    """
    u, _, vt = np.linalg.svd(_profile(site, sensor, weight))
    vt = vt.copy()
    vt[..., 2, :] *= np.linalg.det(u @ vt)[..., None]
    return np.asarray(u @ vt)


def wahba_loss(site: FloatArray, sensor: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the least value of Wahba's sum, shape (...), without forming the rotation; arguments as `wahba`."""
    profile = _profile(site, sensor, weight)
    singular = np.linalg.svd(profile, compute_uv=False)
    gain = singular[..., 0] + singular[..., 1] + np.sign(np.linalg.det(profile)) * singular[..., 2]
    total = np.einsum("...n,...nc,...nc->...", weight, site, site) + np.einsum(
        "...n,...nc,...nc->...", weight, sensor, sensor
    )
    return np.asarray(total - 2.0 * gain)


def _profile(site: FloatArray, sensor: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(np.swapaxes(site * weight[..., None], -1, -2) @ sensor)
