"""Which beacons are computed at a tile, and how much those that are left out could have told.

Far coils tell little. If E is the information of all that are left out and H that of the others, with E <= e H, then no
standard deviation is by more than a factor of sqrt(1 + e) too large, and none is too small. A coil that is left out is
a dipole of moment m at a distance d, with c the cosine of the angle from its axis and k = mu0 m/(4 pi), and has

    |B|^2 = (k/d^3)^2 (1 + 3 c^2),      |dB/dp|^2 <= 12 (k/d^4)^2 (1 + 2 c^2)

(the second is two thirds of the square of the Frobenius norm, which the spectral norm reaches on the axis); d is
measured to the nearest point of a sphere around its wire. With the sums of these over the variance of the noise, for
place, attitude and, three times the second, distortion, and t_j the products of these sums with the traces of the
blocks of the inverse of H, e <= (sum_j sqrt(t_j))^2. Errors of the survey make such coils tell even less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.field.constants import MU0_OVER_4PI
from goldfield.types import FloatArray

FEWEST = 16
"""Beacons with which the choice begins; no fewer are computed, where there are so many."""

COARSE = 6
"""Beacons beyond so many times those that are computed count with what they could tell anywhere in the box."""


@dataclass(frozen=True, eq=False)
class Ranking:
    """The beacons of a site in the order of the field over the noise that they can have in a box, strongest first.

    Attributes
    ----------
    order : ndarray of int, shape (n,)
    field_T : ndarray, shape (n,)
        Upper bounds on their fields anywhere in the box; like the others in that order.
    far_m : ndarray, shape (n,)
        Distances of the wires' spheres from the box.
    centre_m, moment_A_m2 : ndarray, shape (n, 3)
    reach_m, sigma_T : ndarray, shape (n,)
    """

    order: NDArray[np.intp]
    field_T: FloatArray
    far_m: FloatArray
    centre_m: FloatArray
    moment_A_m2: FloatArray
    reach_m: FloatArray
    sigma_T: FloatArray

    def __len__(self) -> int:
        """Return the number of beacons."""
        return len(self.order)

    def error(self, point_m: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return the truncation error at points, shape (e, 3), with the first k beacons, for k = 1 to n.

        Parameters
        ----------
        covariance : ndarray, shape (e, j, j)
            Joint covariance of pose and distortion there with some of the beacons; it counts for k at least as many.

        Returns
        -------
        error : ndarray, shape (e, n)
        """
        told = np.cumsum(self._told(point_m, slice(0, None))[:, :, ::-1], axis=2)[:, :, ::-1]
        left_out = np.concatenate([told[:, :, 1:], np.zeros((3, len(point_m), 1))], axis=2)
        return _error(left_out, covariance)

    def error_with(self, count: int, point_m: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return the same for the first ``count`` beacons alone, shape (e,); a little larger, for speed."""
        far = COARSE * count
        left_out = self._told(point_m, slice(count, far)).sum(axis=2)[:, :, None]
        return _error(left_out + self._told_anywhere(far).sum(axis=1)[:, None, None], covariance)[:, 0]

    def _told(self, point_m: FloatArray, rows: slice) -> FloatArray:
        """Return upper bounds on the information of some beacons on place, attitude, distortion: shape (3, e, m)."""
        offset = point_m.T[:, :, None] - self.centre_m[rows].T[:, None]
        range2 = (offset * offset).sum(axis=0)
        moment = self.moment_A_m2[rows]
        strength2 = (moment * moment).sum(axis=1)
        cosine2 = np.einsum("ien,ni->en", offset, moment) ** 2 / (range2 * strength2)
        distance = np.sqrt(range2) - self.reach_m[rows]
        return _information(np.sqrt(strength2) / self.sigma_T[rows], distance, cosine2)

    def _told_anywhere(self, first: int) -> FloatArray:
        """Return the same of the beacons from ``first`` on for all points of the box, shape (3, m)."""
        strength = np.linalg.norm(self.moment_A_m2[first:], axis=1) / self.sigma_T[first:]
        return _information(strength, self.far_m[first:], np.ones(len(strength)))


def _information(moment_over_noise: FloatArray, distance_m: FloatArray, cosine2: FloatArray) -> FloatArray:
    inverse2 = np.where(distance_m > 0.0, 1.0 / np.square(distance_m), np.inf)
    scale = (MU0_OVER_4PI * moment_over_noise) ** 2 * inverse2**3
    field = scale * (1.0 + 3.0 * cosine2)
    return np.stack([12.0 * scale * inverse2 * (1.0 + 2.0 * cosine2), field, 3.0 * field])


def _error(left_out: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return truncation errors, shape (e, k), from what is left out, shape (3, e, k), and covariances, (e, j, j)."""
    variance = np.einsum("ejj->ej", covariance)
    blocks = [variance[:, :3].sum(axis=1), variance[:, 3:6].sum(axis=1), variance[:, 6:].sum(axis=1)]
    root = sum(np.sqrt(block[:, None] * told) for block, told in zip(blocks, left_out, strict=True))
    return np.asarray(np.sqrt(1.0 + np.square(root)) - 1.0)


def ranked(model: FieldModel, sigma_T: FloatArray, low_m: FloatArray, high_m: FloatArray) -> Ranking:
    """Rank a site's beacons for the points of a box.

    Parameters
    ----------
    model : FieldModel
    sigma_T : ndarray, shape (n,)
        Standard deviation of a component by noise.
    low_m, high_m : ndarray, shape (3,)
        Corners of the box.
    """
    gap = np.maximum(np.maximum(low_m - model.centre_m, model.centre_m - high_m), 0.0)
    distance = np.linalg.norm(gap, axis=1) - model.reach_m
    strength = MU0_OVER_4PI * np.linalg.norm(model.moment_A_m2, axis=1)
    field = np.where(distance > 0.0, 2.0 * strength / np.maximum(distance, 1e-30) ** 3, np.inf)
    middle = np.linalg.norm(model.centre_m - 0.5 * (low_m + high_m), axis=1)
    order = np.lexsort((middle, -field / sigma_T))  # among those that reach into the box the nearest to its middle
    return Ranking(
        order,
        field[order],
        distance[order],
        model.centre_m[order],
        model.moment_A_m2[order],
        model.reach_m[order],
        sigma_T[order],
    )
