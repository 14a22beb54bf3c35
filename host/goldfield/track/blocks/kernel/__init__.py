"""The bank of filters in C, if it has been built (``setup.py``): what runs on the sensor, in single precision.

`CBank` stands in for `goldfield.track.blocks.bank.Bank` where it serves: circular coils and dipoles without metal, at
most 32 of them, and a sensor whose axes have the same noise, independent of each other. A block of 8 beacons takes a
twentieth of the time. Poses differ by about a thousandth of their standard deviations.
"""

from __future__ import annotations

import math

import numpy as np

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.locate.rotations import quaternion_of
from goldfield.track.blocks.bank import Bank, Estimate, Start
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.kernel.library import ffi, filled, given, opened
from goldfield.track.blocks.state import SIZE, Motion
from goldfield.types import FloatArray

MOST_COILS = 32
"""BLOCK_BEACONS of block_gram.h."""

EQUAL = 1e-6
"""By how much, relative to the mean, the weights of the axes may differ."""


def serves(model: FieldModel) -> bool:
    """Return whether the library is built, and `CBank` can follow a sensor among these coils."""
    simple = not len(model.wire_points_m) and model.metal is None
    return simple and 0 < len(model) <= MOST_COILS and opened() is not None


def noise_of(form: NormalForm) -> float | None:
    """Return the standard deviation of a component of a sample, T; None if the axes do not have the same, alone."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = form.weight.tolist()
    mean = (xx + yy + zz) / 3.0
    apart = max(abs(xx - mean), abs(yy - mean), abs(zz - mean), abs(xy), abs(xz), abs(yz))
    return 1.0 / math.sqrt(mean) if mean > 0.0 and apart <= EQUAL * mean else None


class CBank:
    """The bank in C, with the methods and attributes of `goldfield.track.blocks.bank.Bank`.

    Parameters
    ----------
    model : FieldModel
        Coils that `serves` accepts.

    Raises
    ------
    UserError
        If it does not.
    """

    def __init__(self, model: FieldModel) -> None:
        library = opened()
        if library is None or not serves(model):
            raise UserError(
                f"The block filter in C follows a sensor among 1 to {MOST_COILS} circular coils without metal, if it "
                "has been built; this site is followed by the one in NumPy."
            )
        self._library = library
        self._model, self._count = model, len(model)
        self._memory = ffi.new("double[]", -(-self._library.gf_bank_size() // 8))  # doubles: aligned for all
        size = np.linalg.norm(model.moment_A_m2, axis=1)
        coils = np.column_stack([model.centre_m, model.moment_A_m2 / size[:, None], size, model.loop_radius_m])
        self._library.gf_bank_init(self._memory, self._count, given(coils))
        self.mismatch, self.refused = 0.0, 0

    def start(self, start: Start) -> None:
        """Begin a track; what was known before is forgotten."""
        self.resume(start.known)

    def resume(self, known: Estimate) -> None:
        """Begin a track with a motion that is known so well, at the middle of a block."""
        motion = known.motion
        quaternion = quaternion_of(motion.rotation)
        moving = motion.velocity_m_s, motion.rate_rad_s, motion.ambient_T, motion.offset_T
        state = np.concatenate([motion.position_m, quaternion, *moving])
        self._library.gf_bank_start(self._memory, given(state), given(known.covariance))
        self.mismatch, self.refused = 0.0, 0

    def update(self, form: NormalForm, seconds: float) -> bool:
        """Take a block; False if all filters refused it, or if its axes are not served: then it is predicted over."""
        noise_T = noise_of(form)
        if noise_T is None:
            self.predict(seconds)
            return False
        logarithm = ffi.new("double *")
        arrays = given(form.gram), given(form.moment), given(form.sums_T)
        taken = self._library.gf_bank_update(self._memory, *arrays, noise_T, seconds, logarithm)
        if taken:
            self.mismatch -= 2.0 * logarithm[0]
        self.refused = 0 if taken else self.refused + 1
        return bool(taken)

    def in_numpy(self) -> Bank:
        """Return a bank in NumPy that goes on with the track: for blocks that this one does not serve."""
        bank = Bank(self._model)
        bank.resume(self.output())
        bank.expect(self.agility)
        bank.mismatch, bank.refused = self.mismatch, self.refused
        return bank

    def predict(self, seconds: float) -> None:
        """Let time pass without a block."""
        self._library.gf_bank_predict(self._memory, seconds)

    def output(self, seconds: float = 0.0) -> Estimate:
        """Return what is believed of the moment so many seconds after the middle of the last block."""
        state, rotation, covariance, _ = self._output(seconds)
        motion = Motion(state[:3], rotation, state[7:10], state[10:13], state[13:16], state[16:])
        return Estimate(motion, covariance)

    @property
    def agility(self) -> FloatArray:
        """The agility that the sensor seems to have, shape (2,), in the units of `bank.AGILITIES`."""
        return self._output(0.0)[3]

    def _output(self, seconds: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        told: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
        told = np.empty(19), np.empty((3, 3)), np.empty((SIZE, SIZE)), np.empty(2)
        self._library.gf_bank_output(self._memory, seconds, *map(filled, told))
        return told
