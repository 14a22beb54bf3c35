"""The exact field of a circular loop, in the plane, on the axis, near the wire and far away.

With the point at height z over the loop's plane and at distance rho from its axis, u = a^2 + rho^2 + z^2 and
w = 2 a rho, the Biot-Savart integral needs only the means over one turn

    I_nk = mean of cos^k(phi) / (u - w cos(phi))^(n + 1/2),

namely B_axial = (mu0 I a/2) (a I_10 - rho I_11) and B_radial = (mu0 I a/2) z I_11. Textbooks write them with the
complete elliptic integrals K and E, whose difference loses all digits near the axis and far from the coil. Here
Gauss's arithmetic-geometric mean M of the greatest and the least distance to the wire gives them without
cancellation: with c_n the half differences of its steps and tau = sum_{n>=1} 2^(n-1) c_n^2 / w^2 (c_1 = w/(greatest +
least distance), so that w divides out),

    I_10 = (u - tau w^2) / (M (u^2 - w^2)),      I_11 = w (1 - tau u) / (M (u^2 - w^2)),

and the gradient follows from the recurrences between the I_2k (integration by parts), all of them sums of positive
terms.

In its centre a loop makes mu0 I/(2 a), 6.283 uT for 1 A around 0.1 m:

>>> centre, up = np.zeros((3, 1)), np.array([[0.0], [0.0], [1.0]])
>>> field, _ = loop(centre, up, np.array([0.1]), np.array([1.0]))
>>> (1e6 * field[2]).round(3).tolist()
[6.283]
"""

from __future__ import annotations

import numpy as np

from goldfield.field.constants import MU0_OVER_4PI
from goldfield.types import FloatArray

_MEAN_STEPS = 9
"""Bound on the steps of the arithmetic-geometric mean: enough for points 1e-8 radii from the wire."""


def loop(
    offset_m: FloatArray, axis: FloatArray, radius_m: FloatArray, ampere_turns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the field of circular loops and its gradient.

    Parameters
    ----------
    offset_m : ndarray, shape (3, ...)
        Vectors from the loop's centre to the point, m.
    axis : ndarray, shape (3, ...)
        Unit normals; a positive current turns around them by the right-hand rule.
    radius_m, ampere_turns : ndarray, shape (...)
        Radii, and currents times turns; they broadcast against the offset's trailing shape.

    Returns
    -------
    field_T : ndarray, shape (3, ...)
    gradient_T_m : ndarray, shape (3, 3, ...)
        Row i, column j: dB_i/dr_j.

    Notes
    -----
    On the wire itself the result is not finite. Field and gradient are accurate to 1e-9 of their size down to a
    hundredth of the radius from the wire (tests compare with magpylib and complex steps); nearer, digits are lost
    with the distance squared.
    """
    height = (axis * offset_m).sum(axis=0)
    radial = offset_m - height * axis
    rho2 = (radial * radial).sum(axis=0)
    rho = np.sqrt(rho2)
    height2 = height * height
    greatest2 = (rho + radius_m) ** 2 + height2
    least2 = (rho - radius_m) ** 2 + height2
    u = 0.5 * (greatest2 + least2)
    s = greatest2 * least2  # u^2 - w^2
    mean, tau = _mean(np.sqrt(greatest2), np.sqrt(least2))

    over = 1.0 / (mean * s)
    i10 = (u - tau * (4.0 * radius_m**2) * rho2) * over
    j11 = (1.0 - tau * u) * over  # I_11/w
    w2 = (4.0 * radius_m**2) * rho2
    i20 = (u * i10 + (w2 / 3.0) * j11) / s
    q21 = (j11 / 3.0 + i20) / u  # I_21/w

    scale = (2.0 * np.pi * MU0_OVER_4PI) * radius_m**2 * ampere_turns
    lift = 2.0 * height * j11
    field = scale * ((i10 - 2.0 * rho2 * j11) * axis + lift * radial)

    # Gradients of I_10 and I_11/w, each a combination of the offset and the radial vector.
    d_i10 = (-3.0 * i20) * offset_m + (6.0 * radius_m**2 * q21) * radial
    # (3/2 I_22 - I_11/w)/rho^2 is finite on the axis, where it multiplies two radial vectors: the tiny number only
    # avoids 0/0.
    d_j11 = (-3.0 * q21) * offset_m + ((1.5 * i20 - 2.0 * j11) / (rho2 + 1e-300)) * radial
    d_axial = d_i10 - 2.0 * rho2 * d_j11 - (4.0 * j11) * radial
    d_lift = 2.0 * height * d_j11 + (2.0 * j11) * axis
    gradient = axis[:, None] * (d_axial - lift * axis)[None, :] + radial[:, None] * d_lift[None, :]
    for index in range(3):
        gradient[index, index] += lift
    gradient *= scale
    return field, gradient


def _mean(greatest: FloatArray, least: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Arithmetic-geometric mean, and tau: the sum of 2^(n-1) c_n^2 over w^2, w = (greatest^2 - least^2)/2."""
    total = greatest + least
    a, b = 0.5 * total, np.sqrt(greatest * least)
    quarter_w = 0.125 * total * (greatest - least)
    c2 = 1.0 / (total * total)  # (c_1/w)^2
    tau = c2
    weight = 1.0
    # Each step squares the relative difference of a and b, so the worst point tells how many are needed: until 1e-9.
    difference = float(np.max(1.0 - (b / a).real, initial=0.0))
    for _ in range(_MEAN_STEPS):
        a, b = 0.5 * (a + b), np.sqrt(a * b)
        c = quarter_w * c2 / a
        c2 = c * c
        weight *= 2.0
        tau = tau + weight * c2
        if not difference > 1e-4:
            break
        root = np.sqrt(1.0 - difference)
        difference = 1.0 - 2.0 * root / (1.0 + (1.0 - difference))
    return 0.5 * (a + b), tau
