"""The point dipole: what any coil looks like from far away."""

from __future__ import annotations

import numpy as np

from goldfield.field.constants import MU0_OVER_4PI
from goldfield.types import FloatArray


def dipole(offset_m: FloatArray, moment_A_m2: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the field of magnetic dipoles and its gradient.

    The field is B = (mu0/4 pi) (3 (m.u) u - m)/r^3 with u = r/|r| (Jackson, Classical Electrodynamics, eqn 5.56).

    Parameters
    ----------
    offset_m : ndarray, shape (3, ...)
        Vectors from the dipole to the point, m.
    moment_A_m2 : ndarray, shape (3, ...)
        Moments, which broadcast against the offset.

    Returns
    -------
    field_T : ndarray, shape (3, ...)
    gradient_T_m : ndarray, shape (3, 3, ...)
        Row i, column j: dB_i/dr_j. Symmetric and without trace, as curl and divergence vanish.

    Notes
    -----
    At the dipole itself the result is not finite. Components lead, so that every operation runs along contiguous
    memory.

    Examples
    --------
    One metre from a moment of 10 A m^2 the field is 2 uT on its axis and half of that, turned round, beside it:

    >>> moment = np.array([[0.0], [0.0], [10.0]])
    >>> field, _ = dipole(np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0]]), moment)
    >>> (1e6 * field[2]).round(6).tolist()
    [2.0, -1.0]
    """
    inverse_square = 1.0 / (offset_m * offset_m).sum(axis=0)
    strength = MU0_OVER_4PI * inverse_square * np.sqrt(inverse_square)
    along = (moment_A_m2 * offset_m).sum(axis=0) * inverse_square
    field = strength * (3.0 * along * offset_m - moment_A_m2)
    # d/dr of the above: (3/r^5) (m r' + r m' + (m.r) (I - 5 u u'))
    radial = (strength * inverse_square) * offset_m
    mixed = moment_A_m2[:, None] * radial[None, :]
    gradient = mixed + mixed.swapaxes(0, 1) - (5.0 * along) * (offset_m[:, None] * radial[None, :])
    isotropic = strength * along
    for axis in range(3):
        gradient[axis, axis] += isotropic
    gradient *= 3.0
    return field, gradient
