"""Ambiguity: whether the image of a pose in the beacons that matter fits the fields as well as the pose itself.

Second poses that fit come from arrangements that nearly have a symmetry (`goldfield.locate.mirror`): coils near a
plane, whose image is the reflection in it, and coils near a point, whose image is on the other side of it. The
criterion tries both: the plane and the point are those of the beacons weighted by their parts in the position, and the
image is fitted to the fields of the true pose without noise in a few steps. The pose is ambiguous if the image's cost
stays below `goldfield.locate.constellation.RIVAL_COST` and the half-space does not decide between them. The criterion
is cheap, not complete: three or four beacons may leave other second poses, which only a search finds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.constellation import RIVAL_COST
from goldfield.locate.mirror import FLAT
from goldfield.locate.rotations import turned
from goldfield.locate.site_errors import SiteErrors
from goldfield.planning.information import (
    covariance_of_beacons,
    distortion_columns,
    distortion_covariance,
    gram,
    joint_covariance,
    pose_columns,
    whitened,
)
from goldfield.site import HalfSpace
from goldfield.types import FloatArray

STEPS = 4
"""Evaluations of an image: its own place, and three Gauss-Newton steps from there."""

APART, APART_TURN = 0.05, 0.2
"""An image that the fit has brought nearer to the pose itself than this part of the distance to the nearest beacon, and
whose attitude has no component that differs by more than the second, is no other pose, as in the locator's search."""

FARTHEST_STEP = 0.5
"""Longest step of the fit over the distance to the nearest beacon: beyond it the linear model means nothing."""


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The beacons that are computed at a tile, and the errors of what is known of them and of the sensor.

    Attributes
    ----------
    model : FieldModel
    sigma_T : ndarray, shape (n,)
    errors : SiteErrors or None
    distortion : ndarray, shape (6, 6), or None
        T of the first orientation (`information.turned_distortions`); None for an exact sensor.
    half_space : HalfSpace or None
    """

    model: FieldModel
    sigma_T: FloatArray
    errors: SiteErrors | None
    distortion: FloatArray | None
    half_space: HalfSpace | None

    def columns(self, point_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return fields (3, e, n), whitened columns (e, n, 3, k) and covariances (3, 3, e, n) at points (e, 3)."""
        field, gradient = self.model.evaluate(point_m.T)
        offset = point_m.T[:, :, None] - self.model.centre_m.T[:, None]
        covariance = covariance_of_beacons(self.errors, self.sigma_T, offset, field, gradient)
        column = pose_columns(field, gradient)
        if self.distortion is not None:
            column = np.concatenate([column, distortion_columns(field)])
        return field, whitened(covariance, column), covariance

    def inside(self, point_m: FloatArray) -> NDArray[np.bool_]:
        """Tell which points are on the side where the sensor is; all if no side is known."""
        if self.half_space is None:
            return np.ones(len(point_m), dtype=bool)
        return np.asarray((point_m - self.half_space.point_m) @ self.half_space.normal >= 0.0)


def ambiguous(near: Neighbourhood, point_m: FloatArray, field_T: FloatArray, weight: FloatArray) -> NDArray[np.bool_]:
    """Tell at which points, shape (e, 3), an image fits as well.

    Parameters
    ----------
    field_T : ndarray, shape (3, e, n)
        Fields at the points.
    weight : ndarray, shape (e, n)
        Each beacon's part in the position.
    """
    share = weight / weight.sum(axis=1, keepdims=True)
    share = np.where(np.isfinite(share), share, 1.0 / len(near.model))
    middle = share @ near.model.centre_m
    offset = near.model.centre_m - middle[:, None]
    extent, axis = np.linalg.eigh(np.einsum("en,eni,enj->eij", share, offset, offset))
    extent = np.sqrt(np.maximum(extent, 0.0))
    away = point_m - middle
    normal = axis[:, :, 0]
    across = 2.0 * normal[:, :, None] * normal[:, None, :] - np.eye(3)
    found = np.zeros(len(point_m), dtype=bool)
    candidates = (
        (extent[:, 0] <= FLAT * extent[:, 2], -across, across),
        (extent[:, 2] <= FLAT * np.linalg.norm(away, axis=1), np.tile(-np.eye(3), (len(away), 1, 1)), None),
    )
    for likely, reflection, turn in candidates:
        image = middle + (reflection @ away[:, :, None])[:, :, 0]
        open_question = near.inside(image) | ~near.inside(point_m)
        rows = np.flatnonzero(likely & open_question & ~found)
        if len(rows):
            turned_frame = np.tile(np.eye(3), (len(rows), 1, 1)) if turn is None else turn[rows]
            found[rows] = _fits(near, field_T[:, rows], image[rows], turned_frame, point_m[rows])
    return found


def _fits(
    near: Neighbourhood, field_T: FloatArray, image_m: FloatArray, turn: FloatArray, point_m: FloatArray
) -> NDArray[np.bool_]:
    """Tell which images, with attitudes that differ from the true ones by ``turn``, can be fitted to the fields."""
    position, fits = image_m.copy(), np.zeros(len(image_m), dtype=bool)
    for _ in range(STEPS):
        modelled, column, covariance = near.columns(position)
        measured = np.einsum("eij,jen->ien", turn, field_T)
        residual = whitened(covariance, (measured - modelled)[None])[..., 0].reshape(len(position), -1)
        information = gram(column)
        joint = joint_covariance(information, near.distortion).covariance
        slope = np.einsum("emk,em->ek", column.reshape(*residual.shape, -1), residual)
        step = (joint @ slope[:, :, None])[:, :6, 0]
        cost = np.einsum("em,em->e", residual, residual)
        if near.distortion is not None:  # what the sensor's errors explain of the residuals costs only their prior
            known = distortion_covariance(information[:, 6:, 6:], near.distortion)
            cost = cost - np.einsum("ek,ekl,el->e", slope[:, 6:], known, slope[:, 6:])
        range_m = np.linalg.norm(position[:, None] - near.model.centre_m, axis=2).min(axis=1)
        apart = np.linalg.norm(position - point_m, axis=1) > APART * range_m
        apart |= np.abs(turn - np.eye(3)).max(axis=(1, 2)) > APART_TURN
        fits |= (cost < RIVAL_COST) & apart & (near.inside(position) | ~near.inside(point_m))
        length = np.linalg.norm(step[:, :3], axis=1)
        factor = np.minimum(1.0, FARTHEST_STEP * range_m / np.maximum(length, 1e-300))[:, None]
        step = np.where(np.isfinite(step), factor * step, 0.0)
        position, turn = position + step[:, :3], turned(turn, step[:, 3:])
    return fits
