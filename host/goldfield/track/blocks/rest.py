"""What a motion leaves of a block, and how far off several such blocks are: what the integrity begins with.

`left_by` and `cost_of` are computed in C where the library is built (`goldfield.track.blocks.kernel.double`); what
follows them here in NumPy is the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate import kernel as coils
from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.equations import SEPARABLE, NormalForm, separated
from goldfield.track.blocks.kernel import double
from goldfield.track.blocks.update import MOTION, MOVING, Reference, reference
from goldfield.types import FloatArray


@dataclass(frozen=True, eq=False)
class Rest:
    """What a motion leaves of a block.

    Attributes
    ----------
    around : Reference
        The fields at the motion.
    form : NormalForm
        The block with the sums that are left, in the sensor's frame.
    blur : ndarray, shape (n,)
        What the motion's error adds to the variance of the beacons' sums, over a sample's.
    ambient_T : ndarray, shape (3,)
        The ambient field, in the sensor's frame.
    """

    around: Reference
    form: NormalForm
    blur: FloatArray
    ambient_T: FloatArray


def left_by(model: FieldModel, form: NormalForm, known: Estimate, noise_T: float) -> Rest:
    """Return what a motion leaves of a block; ``noise_T`` is the deviation of a sample's component."""
    if not double.ready():
        around = reference(model, known.motion)
        left, blur = around.residual(form) @ known.motion.rotation, blur_of(form, around, known.covariance)
    else:
        evaluated = coils.evaluate(model, known.motion.position_m)
        block = form.gram, form.moment, form.sums_T
        field, slope, jacobian, left, blur = double.rest(known.motion, known.covariance, evaluated, block)
        around = Reference(known.motion, field, slope, jacobian)
    ambient_T = around.field_T[-1] @ known.motion.rotation + left[-1] / form.gram[-1, -1]
    return Rest(around, form.with_sums(left), blur / noise_T**2, ambient_T)


def blur_of(form: NormalForm, around: Reference, covariance: FloatArray) -> FloatArray:
    """Return what the track's error adds to the variance of a block's sums, T^2, shape (n,).

    An error that stays is a pose, which is free anyway; one that changes from block to block leaks from field to field,
    since the codes are not orthogonal within a block.
    """
    pose = around.jacobian[..., :MOVING]
    still, moving = (
        ((pose @ covariance[part, part]) * pose).sum(axis=(1, 2)) / 3.0 for part in (slice(0, MOVING), MOTION)
    )
    leaks = form.beside_ambient(form.gram)
    leaks.flat[:: leaks.shape[1] + 1] = 0.0
    slopes = form.beside_ambient(form.moment)
    return np.asarray((leaks * leaks) @ still + (slopes * slopes) @ moving)


def cost_of(rests: Sequence[NormalForm], blurs: Sequence[FloatArray]) -> tuple[float, int]:
    """Return chi-square of what is left of the fields, and about its mean."""
    blur = np.sum(blurs, axis=0)
    if double.ready():
        gram, sums = np.array([rest.gram for rest in rests]), np.array([rest.sums_T for rest in rests])
        found = double.cost(gram, sums, blur, rests[-1].weight, SEPARABLE)
        if found is not None:
            return found
    return cost_where_told_apart(rests, blur)


def cost_where_told_apart(rests: Sequence[NormalForm], blur: FloatArray) -> tuple[float, int]:
    """Return the same of those fields alone that the blocks tell apart."""
    found, weight = separated(rests, blur), rests[-1].weight
    heard = np.isfinite(found.deviation)
    field = found.field_T[heard] / found.deviation[heard, None]
    return float(((field @ weight) * field).sum()), 3 * int(heard.sum())
