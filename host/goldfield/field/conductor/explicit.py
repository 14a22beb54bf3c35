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

from goldfield.poses import FloatArray

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
        """Secondary field at points, shape (p, 3): A/m, shape (e, p, 3)."""
        return self.field_and_gradient(point_m)[0]

    def field_and_gradient(self, point_m: FloatArray) -> tuple[ComplexArray, ComplexArray]:
        """Secondary field and its gradient.

        Parameters
        ----------
        point_m : ndarray, shape (p, 3)
            Not nearer to the body than its parts are to each other, or the sum does not stand for the integral.

        Returns
        -------
        field_A_m : ndarray of complex, shape (e, p, 3)
        gradient_A_m2 : ndarray of complex, shape (e, p, 3, 3)
            Row i, column j: dH_i/dx_j.
        """
        r = np.asarray(point_m, dtype=float)[:, None, :] - self.position_m  # (p, n, 3)
        inverse2 = 1.0 / (r * r).sum(axis=-1)
        inverse3 = inverse2 * np.sqrt(inverse2) / (4.0 * np.pi)
        # Tensors that act on a part's current and moment: first index the field's component, last the source's.
        weight = inverse3[..., None] * r
        eye = np.eye(3)
        by_moment = 3.0 * np.einsum("pni,pnj,pn->pnij", weight, r, inverse2) - inverse3[..., None, None] * eye
        by_current = np.einsum("ijk,pnk->pnij", _LEVI_CIVITA, weight)
        field = np.einsum("pnij,enj->epi", by_moment, self.moment_A_m2)
        field += np.einsum("pnij,enj->epi", by_current, self.current_A_m)
        # The gradient of r/(4 pi r^3) is minus the dipole's tensor.
        current_slope = -np.einsum("ikl,pnlj,enk->epij", _LEVI_CIVITA, by_moment, self.current_A_m, optimize=True)
        fifth = 3.0 * inverse3 * inverse2
        along = np.einsum("pni,eni->epn", r, self.moment_A_m2)
        summed = np.einsum("eni,pnj,pn->epij", self.moment_A_m2, r, fifth, optimize=True)
        slope = summed + summed.swapaxes(-1, -2)
        slope += np.einsum("epn,pn->ep", along, fifth)[..., None, None] * eye
        slope -= 5.0 * np.einsum("epn,pni,pnj,pn->epij", along, r, r, fifth * inverse2, optimize=True)
        return field, slope + current_slope


_LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0
