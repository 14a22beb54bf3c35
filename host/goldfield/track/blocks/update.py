"""What a block says of the twelve observed numbers, and how filters take it (docs/blocks.md, "Update").

The numbers z are position, a small rotation, the ambient field as the sensor sees it, a = e + R b, and how fast that
changes as the sensor turns, its sweep; all in the site's frame. `observed` turns a block into their information around
a reference; `taken_by` updates any number of filters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate import kernel
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.state import AMBIENT, OFFSET, SIZE, TURN, Motion, crosses
from goldfield.types import FloatArray

OBSERVED, SEEN, MOVING = 12, 9, 6
"""Observed numbers, those of them that the fields depend on, and numbers of the motion, velocity and turn rate."""

SWEEP = slice(SEEN, OBSERVED)
"""The sweep of the ambient field among the observed numbers."""

UNEVEN_T_S = 5e-6
"""Standard deviation of how fast the ambient field changes within a block by itself: by its slopes near iron."""

MOTION = slice(6, 12)
"""Velocity and turn rate among the errors of the state."""

SMALL_PIVOTS: FloatArray = np.repeat([1e-6, 1e-2], [SEEN, OBSERVED - SEEN])
"""A pivot below this part of its own diagonal says nothing that others do not say; those of the sweep are larger."""


@dataclass(frozen=True, eq=False)
class Reference:
    """The fields at a motion, in the site's frame.

    Attributes
    ----------
    motion : Motion
        The motion at one moment, the middle of a block.
    field_T : ndarray, shape (n + 1, 3)
        Fields of the beacons, and last what the sensor sees of ambient field and offset, a = e + R b.
    slope_T_s : ndarray, shape (n + 1, 3)
        How they change in the sensor's frame, turned into the site's.
    jacobian : ndarray, shape (n + 1, 3, 9)
        Derivatives of the fields by position, rotation and ambient field.
    """

    motion: Motion
    field_T: FloatArray
    slope_T_s: FloatArray
    jacobian: FloatArray

    def residual(self, form: NormalForm) -> FloatArray:
        """Return what the motion leaves of a block's sums, in the site's frame, shape (n + 1, 3)."""
        expected = form.gram @ self.field_T + form.moment @ self.slope_T_s
        return np.asarray(form.sums_T @ self.motion.rotation.T - expected)

    def weight(self, form: NormalForm) -> FloatArray:
        """Return the inverse covariance of a sample's components in the site's frame, shape (3, 3)."""
        return np.asarray(self.motion.rotation @ form.weight @ self.motion.rotation.T)


def reference(model: FieldModel, motion: Motion) -> Reference:
    """Compute the fields at a motion."""
    field, gradient = kernel.evaluate(model, motion.position_m)
    count = len(model)
    fields = np.empty((count + 1, 3))
    fields[:count], fields[count] = field.T, motion.ambient_T
    jacobian = np.zeros((count + 1, 3, SEEN))
    jacobian[:count, :, :3] = gradient.transpose(2, 0, 1)
    jacobian[:, :, 3:6] = crosses(fields)
    jacobian[count, :, 6:] = np.eye(3)
    # - w x B = [B]x w
    slope = jacobian[:, :, :3] @ motion.velocity_m_s + jacobian[:, :, 3:6] @ motion.rate_rad_s
    fields[count] += motion.rotation @ motion.offset_T
    return Reference(motion, fields, slope, jacobian)


@dataclass(frozen=True, eq=False)
class Observed:
    """What a block says of the errors of the state, as independent numbers of unit variance, at most twelve.

    Attributes
    ----------
    motion : Motion
        The reference.
    seen : ndarray, shape (18, 12)
        A': how the numbers change with the errors; columns of zeros where nothing is said.
    score : ndarray, shape (12,)
        The numbers, U^-1 g, of the reference.
    rank : int
        How many there are.
    """

    motion: Motion
    seen: FloatArray
    score: FloatArray
    rank: int


def observed(form: NormalForm, around: Reference) -> Observed:
    """Turn a block into what it says around a reference."""
    motion = around.motion
    told = _told(form, around)
    root, rest, rank = _root(told[:, :OBSERVED], told[:, OBSERVED:])
    seen = np.zeros((SIZE, OBSERVED))
    seen[:6, :SEEN], seen[MOTION] = root[:6, :SEEN], rest[:, :-1].T
    seen[AMBIENT, :SEEN], seen[OFFSET, :SEEN] = root[6:SEEN, :SEEN], motion.rotation.T @ root[6:SEEN, :SEEN]
    # The sweep e x w changes with the turn rate, which is done, with the field, and turns with the sensor.
    sweep = root[SWEEP, SWEEP]
    seen[TURN, SWEEP] = -crosses(around.slope_T_s[-1]) @ sweep
    seen[AMBIENT, SWEEP] = crosses(motion.rate_rad_s) @ sweep
    even = 1.0 / math.sqrt(1.0 + UNEVEN_T_S**2 * float(form.moment[:, -1] @ form.ramp * np.diag(form.weight).max()))
    seen[:, SWEEP] *= even
    score = rest[:, -1]
    score[SWEEP] *= even
    return Observed(motion, seen, score, rank)


def _told(form: NormalForm, around: Reference) -> FloatArray:
    """Return information, what the motion adds to the gradient, and the gradient: [L K g], shape (12, 19)."""
    count = len(around.field_T)
    weight = around.weight(form)
    left = np.empty((count, 3, OBSERVED))
    left[..., :SEEN], left[..., SWEEP] = weight @ around.jacobian, form.ramp[:, None, None] * weight
    through = np.empty((count, 3, OBSERVED + MOVING + 1))
    through[..., :SEEN] = (form.gram @ around.jacobian.reshape(count, -1)).reshape(-1, 3, SEEN)
    through[..., SWEEP] = form.moment[:, -1, None, None] * np.eye(3)
    moving = np.ascontiguousarray(around.jacobian[..., :MOVING]).reshape(count, -1)
    through[..., OBSERVED:-1] = (form.moment @ moving).reshape(-1, 3, MOVING)
    through[..., -1] = around.residual(form)
    return np.asarray(left.reshape(-1, OBSERVED).T @ through.reshape(3 * count, -1))


def _root(information: FloatArray, right: FloatArray) -> tuple[FloatArray, FloatArray, int]:
    """Return U and U^-1 times the right side with L = U U', small pivots left out, and how many are left."""
    diagonal = np.diag(information)
    try:
        root = np.linalg.cholesky(information)
        if (np.square(np.diag(root)) > SMALL_PIVOTS * diagonal).all():
            return np.asarray(root, dtype=np.float64), np.asarray(np.linalg.solve(root, right)), OBSERVED
    except np.linalg.LinAlgError:
        pass
    partial, done, rank = np.zeros_like(information), np.zeros_like(right), 0
    left, rest = information.copy(), right.copy()
    for column in range(OBSERVED):
        pivot = left[column, column]
        if not pivot > SMALL_PIVOTS[column] * diagonal[column]:
            continue
        partial[column:, column] = left[column:, column] / np.sqrt(pivot)
        done[column] = rest[column] / partial[column, column]
        left -= np.outer(partial[:, column], partial[:, column])
        rest -= np.outer(partial[:, column], done[column])
        rank += 1
    return partial, done, rank


@dataclass(frozen=True, eq=False)
class Update:
    """Updates of k filters by one block.

    Attributes
    ----------
    change : ndarray, shape (k, 18)
        By which the states move.
    gain : ndarray, shape (k, 18, 12)
        The covariances lose ``gain @ gain'``.
    surprise : ndarray, shape (k,)
        Chi-square with the block's rank as degrees of freedom if all is as described.
    log_spread : ndarray, shape (k,)
        Logarithm of the determinant of the scores' covariance.
    """

    change: FloatArray
    gain: FloatArray
    surprise: FloatArray
    log_spread: FloatArray


def taken_by(motion: Motion, covariance: FloatArray, block: Observed) -> Update:
    """Compute the updates of k filters, given by their motions and covariances, shape (k, 18, 18)."""
    whitened = covariance @ block.seen  # P A'
    spread = block.seen.T @ whitened
    spread += np.eye(OBSERVED)
    factor = np.linalg.cholesky(spread)
    inverse = np.linalg.inv(factor)
    score = block.score - motion.minus(block.motion) @ block.seen
    normal = (inverse @ score[..., None])[..., 0]
    gain = whitened @ inverse.swapaxes(1, 2)
    return Update(
        (gain @ normal[..., None])[..., 0],
        gain,
        (normal * normal).sum(axis=1),
        2.0 * np.log(factor[:, range(OBSERVED), range(OBSERVED)]).sum(axis=1),
    )
