"""Small helpers for rotations, batched."""

from __future__ import annotations

import math

import numpy as np

from goldfield.types import FloatArray


def skew(vector: FloatArray) -> FloatArray:
    """Return [v]x, shape (..., 3, 3), of vectors, shape (..., 3): the matrix of the cross product with v."""
    result = np.zeros((*vector.shape, 3))
    for row, column, source in ((2, 1, 0), (0, 2, 1), (1, 0, 2)):
        result[..., row, column] = vector[..., source]
        result[..., column, row] = -vector[..., source]
    return result


def turned(rotation: FloatArray, vector: FloatArray) -> FloatArray:
    """Return exp([vector]x) R, shape (e, 3, 3): R turned by a rotation vector, shape (e, 3), of the site's frame."""
    angle2 = (vector * vector).sum(axis=1)
    angle = np.sqrt(angle2)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    sine = np.where(small, 1.0 - angle2 / 6.0, np.sin(safe) / safe)
    versine = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)  # times the angle's square: what lacks is rounding
    x, y, z = vector.T
    skew = np.zeros_like(rotation)
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -z, y, -x
    skew[:, 1, 0], skew[:, 2, 0], skew[:, 2, 1] = z, -y, x
    step = skew @ rotation
    return np.asarray(rotation + sine[:, None, None] * step + versine[:, None, None] * (skew @ step))


def quaternion_of(rotation: FloatArray) -> FloatArray:
    """Return the unit quaternion (x, y, z, w) of one rotation, shape (3, 3), with w >= 0.

    Examples
    --------
    >>> quaternion_of(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])).round(6)
    array([0.      , 0.      , 0.707107, 0.707107])
    """
    return np.array(_quaternion(rotation.tolist()))


def quaternions_of(rotations: FloatArray) -> FloatArray:
    """Return the unit quaternions, shape (e, 4), of rotations, shape (e, 3, 3): each as `quaternion_of` has it."""
    return np.array([_quaternion(rotation) for rotation in rotations.tolist()])


def _quaternion(rotation: list[list[float]]) -> tuple[float, float, float, float]:
    """Return the quaternion of the three rows of a rotation.

    The largest of its numbers comes first, of a root, and divides the others (Shepperd 1978). SciPy's is ten times as
    long about a single one.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    largest = max(xx, yy, zz, xx + yy + zz)
    if largest == xx:
        x, y, z, w = 1.0 + xx - yy - zz, yx + xy, xz + zx, zy - yz
    elif largest == yy:
        x, y, z, w = yx + xy, 1.0 - xx + yy - zz, zy + yz, xz - zx
    elif largest == zz:
        x, y, z, w = xz + zx, zy + yz, 1.0 - xx - yy + zz, yx - xy
    else:
        x, y, z, w = zy - yz, xz - zx, yx - xy, 1.0 + xx + yy + zz
    length = math.copysign(math.hypot(x, y, z, w), w)
    return x / length, y / length, z / length, w / length


def matrix_of(quaternion_xyzw: FloatArray) -> FloatArray:
    """Return the rotation, shape (3, 3), of one quaternion (x, y, z, w), which need not be of unit length.

    Examples
    --------
    >>> matrix_of(np.array([0.0, 0.0, 2.0, 2.0])).round(6) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    x, y, z, w = quaternion_xyzw.tolist()
    twice = 2.0 / (x * x + y * y + z * z + w * w)
    xx, yy, zz = twice * x * x, twice * y * y, twice * z * z
    xy, xz, yz = twice * x * y, twice * x * z, twice * y * z
    wx, wy, wz = twice * w * x, twice * w * y, twice * w * z
    return np.array(
        [[1.0 - yy - zz, xy - wz, xz + wy], [xy + wz, 1.0 - xx - zz, yz - wx], [xz - wy, yz + wx, 1.0 - xx - yy]]
    )


def vector_of(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector, shape (3,), of one rotation, shape (3, 3): along its axis, as long as its angle.

    Examples
    --------
    >>> vector_of(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])).round(6)
    array([0.      , 0.      , 1.570796])
    """
    *along, real = quaternion_of(rotation).tolist()
    sine = math.hypot(*along)
    factor = 2.0 * math.atan2(sine, real) / sine if sine > 0.0 else 2.0
    return np.array([factor * value for value in along])


def orthonormal(rotation: FloatArray) -> FloatArray:
    """Remove the rounding of many small turns: one Newton step towards the nearest rotation, shape (..., 3, 3)."""
    return np.asarray(0.5 * rotation @ (3.0 * np.eye(3) - np.swapaxes(rotation, -1, -2) @ rotation))
