"""Wahba's problem: the rotation between two sets of vectors."""

from __future__ import annotations

import numpy as np

from goldfield.types import FloatArray


def wahba(site: FloatArray, sensor: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the rotation R that minimises sum_i w_i |site_i - R sensor_i|^2, by singular values.

    The method is Markley's (J. Astronautical Sciences 36, 1988).

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

    Examples
    --------
    A sensor that is turned by a quarter about z sees the site's x along its own -y:

    >>> site, sensor = np.array([[1.0, 0, 0], [0, 0, 1.0]]), np.array([[0, -1.0, 0], [0, 0, 1.0]])
    >>> (wahba(site, sensor, np.ones(2)) @ [1.0, 0.0, 0.0]).round(6).tolist()
    [0.0, 1.0, 0.0]
    """
    u, _, vt = np.linalg.svd(_profile(site, sensor, weight))
    vt = vt.copy()
    vt[..., 2, :] *= np.linalg.det(u @ vt)[..., None]
    return np.asarray(u @ vt)


def wahba_loss(site: FloatArray, sensor: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the least value of Wahba's sum, shape (...), without its rotation; the arguments are those of `wahba`.

    It follows from the largest root of Davenport's quartic, found by Newton's method from an upper bound (Shuster's
    QUEST), which the iteration can only approach from above. Twelve steps leave 1e-6 of the fields' energy: enough to
    rank candidates, without a decomposition of thousands of matrices.
    """
    h = _profile(site, sensor, weight)
    energy = np.asarray((weight * ((site * site).sum(axis=-1) + (sensor * sensor).sum(axis=-1))).sum(axis=-1))
    scale = np.maximum(0.5 * energy, 1e-300)
    h = h / scale[..., None, None]
    s = h + np.swapaxes(h, -1, -2)
    trace = np.trace(h, axis1=-2, axis2=-1)
    z = np.stack([h[..., 1, 2] - h[..., 2, 1], h[..., 2, 0] - h[..., 0, 2], h[..., 0, 1] - h[..., 1, 0]], axis=-1)
    sz = (s @ z[..., None])[..., 0]
    trace_adjugate = 0.5 * (np.trace(s, axis1=-2, axis2=-1) ** 2 - (s * s).sum(axis=(-2, -1)))
    a = trace**2 - trace_adjugate
    b = trace**2 + (z * z).sum(axis=-1)
    c = np.linalg.det(s) + (z * sz).sum(axis=-1)
    d = (sz * sz).sum(axis=-1)
    root = np.ones_like(trace)
    for _ in range(12):
        value = ((root * root - a - b) * root - c) * root + a * b + c * trace - d
        slope = (4.0 * root * root - 2.0 * (a + b)) * root - c
        root = root - np.maximum(value, 0.0) / np.maximum(slope, 1e-12)
    return np.asarray(energy - 2.0 * scale * root)


def _profile(site: FloatArray, sensor: FloatArray, weight: FloatArray) -> FloatArray:
    return np.asarray(np.swapaxes(site * weight[..., None], -1, -2) @ sensor)
