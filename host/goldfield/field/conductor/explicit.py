"""The explicit formula for the field of eddy currents and magnetisation, from integrals over parts of the body.

Gietler, Ammari & Zangl, eqs. (27) and (31), with G = +1/(4 pi |x - y|) and the mixed derivative (both wrong in print):

    H_a(x) = sum_i grad_x G(x, y_i) x int_i curl H dy  +  (1 - mu/mu_0) sum_i (int_i H dy . grad_y) grad_x G(x, y_i).

The first integral is the current in part i times its length, the second times (mu/mu_0 - 1) its magnetic moment:
Biot-Savart fields of currents and fields of dipoles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.types import FloatArray

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Parts:
    """Small parts of a body in the field of e sources: all that its secondary field needs.

    Attributes
    ----------
    position_m : ndarray, shape (n, 3)
    current_A_m : ndarray of complex, shape (e, n, 3)
        Integral of curl H over each part. Phasors exp(+i omega t).
    moment_A_m2 : ndarray of complex, shape (e, n, 3)
        (mu_r - 1) times the integral of H.
    """

    position_m: FloatArray
    current_A_m: ComplexArray
    moment_A_m2: ComplexArray

    @classmethod
    def of_interior(
        cls,
        position_m: FloatArray,
        volume_m3: FloatArray,
        field_A_m: ComplexArray,
        curl_A_m2: ComplexArray,
        relative_permeability: float,
    ) -> Parts:
        """Return the parts of a body whose interior field and its curl, shape (e, n, 3), are known at their centres."""
        moment = (relative_permeability - 1.0) * volume_m3[:, None] * field_A_m
        return cls(position_m, volume_m3[:, None] * curl_A_m2, moment)

    def field(self, point_m: FloatArray) -> ComplexArray:
        """Return the secondary field at points, shape (p, 3): A/m, shape (e, p, 3)."""
        return self.field_and_gradient(point_m)[0]

    def field_and_gradient(self, point_m: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the secondary field and its gradient.

        Parameters
        ----------
        point_m : ndarray, shape (p, 3)
            Points no nearer to the body than its parts are to each other, or the sum does not stand for the integral.

        Returns
        -------
        field_A_m : ndarray of complex, shape (e, p, 3)
        gradient_A_m2 : ndarray of complex, shape (e, p, 3, 3)
            Row i, column j: dH_i/dx_j.
        """
        points = np.asarray(point_m, dtype=float)
        pairs = [self._at(point) for point in points]
        return np.stack([pair[0] for pair in pairs], axis=1), np.stack([pair[1] for pair in pairs], axis=1)

    def _at(self, point_m: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Return the field and gradient at one point, shapes (e, 3) and (e, 3, 3).

        The sums over the parts are products of matrices: of currents and moments with the powers of the distance.
        """
        r = point_m - self.position_m
        inverse2 = 1.0 / (r * r).sum(axis=1)
        third = inverse2 * np.sqrt(inverse2) / (4.0 * np.pi)
        fifth = 3.0 * third * inverse2
        square = r[:, :, None] * r[:, None, :]
        current, moment = self.current_A_m.swapaxes(1, 2), self.moment_A_m2.swapaxes(1, 2)  # (e, 3, n)

        current_third = current @ third  # (e, i): sum of J_i / (4 pi r^3)
        turn = current @ (third[:, None] * r)  # (e, i, j): J_i r_j / (4 pi r^3)
        bend = _contract(current, fifth[:, None, None] * square)  # (e, i, j, l)
        field = np.einsum("kij,eij->ek", _LEVI_CIVITA, turn)
        gradient = np.einsum("kil,ei->ekl", _LEVI_CIVITA, current_third)
        gradient -= np.einsum("kij,eijl->ekl", _LEVI_CIVITA, bend)

        along = (self.moment_A_m2 * r).sum(axis=2)  # (e, n)
        field += (along * fifth) @ r - moment @ third
        slope = moment @ (fifth[:, None] * r)  # (e, i, j)
        gradient += slope + slope.swapaxes(1, 2) + np.trace(slope, axis1=1, axis2=2)[:, None, None] * np.eye(3)
        gradient -= 5.0 * _contract(along, (fifth * inverse2)[:, None, None] * square)
        return field, gradient


def _contract(rows: ComplexArray, columns: FloatArray) -> ComplexArray:
    """Return the product over the parts: rows (..., n), columns (n, 3, 3)."""
    return np.asarray((rows @ columns.reshape(-1, 9)).reshape(*rows.shape[:-1], 3, 3))


_LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0
