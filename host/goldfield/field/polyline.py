"""The field of a wire given as a polyline: Biot-Savart over straight segments."""

from __future__ import annotations

import numpy as np

from goldfield.field.constants import MU0_OVER_4PI
from goldfield.types import FloatArray


def polyline(
    point_m: FloatArray, start_m: FloatArray, end_m: FloatArray, ampere_turns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the field of polylines and its gradient.

    A segment from P to Q adds, with a = r - P and b = r - Q,
    B = (mu0 I/4 pi) ((Q - P) x a) (|a| + |b|)/(|a| |b| (|a| |b| + a.b)).

    Parameters
    ----------
    point_m : ndarray, shape (3, ...)
    start_m, end_m : ndarray, shape (3, coils, segments)
        Broadcast against ``point_m[..., None]``; a segment of no length adds nothing, so shorter wires are padded
        with them.
    ampere_turns : ndarray, shape (coils,)

    Returns
    -------
    field_T : ndarray, shape (3, ..., coils)
    gradient_T_m : ndarray, shape (3, 3, ..., coils)
        Row i, column j: dB_i/dr_j.

    Notes
    -----
    The wire is taken as it is listed, open or closed; an open wire lacks its feed. On the wire the result is not
    finite.
    """
    a = point_m[..., None] - start_m
    b = point_m[..., None] - end_m
    d = end_m - start_m
    length_a, length_b = np.sqrt((a * a).sum(axis=0)), np.sqrt((b * b).sum(axis=0))
    product = length_a * length_b
    total = length_a + length_b
    closeness = product + (a * b).sum(axis=0)
    factor = total / (product * closeness)
    turning = np.stack([d[1] * a[2] - d[2] * a[1], d[2] * a[0] - d[0] * a[2], d[0] * a[1] - d[1] * a[0]])

    # Gradient of the logarithm of the factor, as a combination of a and b.
    of_a = 1.0 / (length_a * total) - 1.0 / length_a**2 - (length_b / length_a + 1.0) / closeness
    of_b = 1.0 / (length_b * total) - 1.0 / length_b**2 - (length_a / length_b + 1.0) / closeness
    slope = factor * (of_a * a + of_b * b)

    scale = MU0_OVER_4PI * ampere_turns
    field = scale * (factor * turning).sum(axis=-1)
    gradient = np.stack([np.stack([(turning[i] * slope[j]).sum(axis=-1) for j in range(3)]) for i in range(3)])
    twist = (factor * d).sum(axis=-1)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # (d x)_ij = -d_k for i, j, k cyclic
        gradient[i, j] -= twist[k]
        gradient[j, i] += twist[k]
    return field, scale * gradient
