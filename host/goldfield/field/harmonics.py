"""Regular solid harmonics: polynomials whose gradients are all the fields that a room without sources can have.

They are R_l^m = r^l P_l^m(cos theta) exp(i m phi)/(l + m)!, without the sign (-1)^m, as their real and imaginary parts.
In this normalisation a derivative is one or two harmonics of the degree below (Epton and Dembart, SIAM Journal on
Scientific Computing 16 (1995) 865, section 2; Steinborn and Ruedenberg, Advances in Quantum Chemistry 7 (1973) 1):

    dR_l^m/dz = R_{l-1}^m,  (d/dx - i d/dy) R_l^m = R_{l-1}^{m-1},  (d/dx + i d/dy) R_l^m = -R_{l-1}^{m+1}.

So one table of values, `harmonic_values`, and constant matrices, `derivative_matrices`, give fields and gradients. The
order everywhere is by degree, then by order m, the real part before the imaginary one: 0, 1 real, 1 imaginary, 2 real,
...
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from goldfield.types import FloatArray


def _row(degree: int, order: int, imaginary: bool) -> int:
    """Return the place of a harmonic in the table, in which that of degree 0 is the first."""
    return degree**2 + max(2 * order - 1, 0) + imaginary


def harmonic_values(point: FloatArray, degree: int) -> FloatArray:
    """Return the harmonics from degree 0 to the given one at points.

    Parameters
    ----------
    point : ndarray, shape (3, ...)
        Without unit; complex numbers are allowed, for derivatives by complex steps.
    degree : int

    Returns
    -------
    value : ndarray, shape ((degree + 1)^2, ...)

    Examples
    --------
    Those of degree 1 are z, x/2 and y/2:

    >>> harmonic_values(np.array([2.0, 4.0, 6.0]), 1).tolist()
    [1.0, 6.0, 1.0, 2.0]
    """
    x, y, z = point
    square = x * x + y * y + z * z
    value = np.zeros(((degree + 1) ** 2, *point.shape[1:]), dtype=point.dtype)
    value[0] = 1.0
    for m in range(degree + 1):
        real, imaginary = _row(m, m, False), _row(m, m, True)
        if m > 0:
            before = _row(m - 1, m - 1, False), _row(m - 1, m - 1, True)
            a, b = value[before[0]], (value[before[1]] if m > 1 else 0.0)
            value[real], value[imaginary] = (x * a - y * b) / (2.0 * m), (x * b + y * a) / (2.0 * m)
        for part in (False, True)[: 1 + (m > 0)]:
            for n in range(m + 1, degree + 1):
                lower = value[_row(n - 2, m, part)] if n - 2 >= m else 0.0
                value[_row(n, m, part)] = ((2 * n - 1) * z * value[_row(n - 1, m, part)] - square * lower) / (
                    (n + m) * (n - m)
                )
    return value


@cache
def derivative_matrices(degree: int) -> FloatArray:
    """Return the derivatives of the harmonics up to a degree as sums of the harmonics themselves.

    Returns
    -------
    matrices : ndarray, shape (3, (degree + 1)^2, (degree + 1)^2)
        ``d value/dx_a = matrices[a] @ value``. Not to be written to: it is shared.
    """
    count = (degree + 1) ** 2
    out = np.zeros((3, count, count))

    def add(axis: int, row: int, factor: float, n: int, m: int, imaginary: bool) -> None:
        if m < 0:  # R_n^{-m} = (-1)^m conj(R_n^m), and m is -1 at least.
            m, factor = -m, factor if imaginary else -factor
        if m <= n and (m > 0 or not imaginary):
            out[axis, row, _row(n, m, imaginary)] += factor

    for n in range(1, degree + 1):
        for m in range(n + 1):
            for part in (False, True)[: 1 + (m > 0)]:
                row, sign = _row(n, m, part), 1.0 if part else -1.0
                add(0, row, 0.5, n - 1, m - 1, part)
                add(0, row, -0.5, n - 1, m + 1, part)
                add(1, row, 0.5 * sign, n - 1, m - 1, not part)
                add(1, row, 0.5 * sign, n - 1, m + 1, not part)
                add(2, row, 1.0, n - 1, m, part)
    out.flags.writeable = False
    return out


@cache
def field_norms(degree: int) -> FloatArray:
    """Return what each harmonic from degree 1 on is multiplied by.

    Its gradient then has a root mean square of 1 over the unit sphere.

    Returns
    -------
    factor : ndarray, shape ((degree + 1)^2 - 1,)
        Not to be written to: it is shared.

    Notes
    -----
    The mean of |grad (r^l Y)|^2 over the unit sphere is l (2 l + 1) times that of Y^2, and the mean of the real part of
    R_l^m squared is 1/((2 l + 1) (l + m)! (l - m)!), half of it with m > 0.
    """
    squares = []
    for n in range(1, degree + 1):
        for m in range(n + 1):
            square = n / (math.factorial(n - m) * math.factorial(n + m))
            squares += [square] if m == 0 else [0.5 * square] * 2
    factor: FloatArray = 1.0 / np.sqrt(np.array(squares))
    factor.flags.writeable = False
    return factor


def harmonic_fields(point: FloatArray, degree: int) -> FloatArray:
    """Return the fields of the harmonics from degree 1 on, each of a root mean square of 1 over the unit sphere.

    Parameters
    ----------
    point : ndarray, shape (3, ...)
        Without unit.
    degree : int
        1 or more.

    Returns
    -------
    field : ndarray, shape (3, (degree + 1)^2 - 1, ...)

    Examples
    --------
    Those of degree 1 are constant:

    >>> harmonic_fields(np.array([0.3, 0.2, 0.1]), 1).T.round(12).tolist()
    [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    sums = derivative_matrices(degree)[:, 1:, : degree**2] * field_norms(degree)[:, None]
    return np.asarray(np.einsum("akt,t...->ak...", sums, harmonic_values(point, degree - 1)))
