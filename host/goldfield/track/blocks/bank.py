"""A bank of filters of different agility that take the same blocks (docs/blocks.md): gates, likelihood, copies.

The seam to the C version: `goldfield.track.blocks.kernel` has a class ``CBank`` with the constructor, the methods and
the attributes of `Bank`, everything in SI units and NumPy arrays, and raises UserError in its constructor for coils
that it does not serve (``serves(model)`` tells). `BlockFilter` takes either:

    bank = Bank(model)                      # a FieldModel: n beacons
    bank.start(start)                       # a Start: the pose at the middle of a block, and its covariance
    bank.update(form, seconds)              # a NormalForm; seconds since the middle of the last block or the start;
                                            # False: refused by all filters, the block is predicted over
    bank.predict(seconds)                   # nothing came: the middle goes on by so many seconds
    bank.output(seconds)                    # an Estimate, so many seconds after the middle; 0: at the middle
    bank.mismatch                           # discounted -2 log likelihood of the filter that is output: lower is better
    bank.refused                            # blocks in a row that all filters have refused
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from goldfield.field import FieldModel
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.state import Motion
from goldfield.types import FloatArray

AGILITIES: FloatArray = np.array([[0.05, 0.1], [0.5, 1.0], [2.0, 4.0], [8.0, 15.0]])
"""Agilities of acceleration and turn, m/s^2 and rad/s^2 per root hertz, one row a filter."""


@dataclass(frozen=True, eq=False)
class Start:
    """What a track begins with, at the middle of a block.

    Attributes
    ----------
    position_m : ndarray, shape (3,)
    rotation : ndarray, shape (3, 3)
    pose_cov : ndarray, shape (6, 6)
        Covariance of position (m) and a small rotation (rad) in the site's frame.
    ambient_T : ndarray, shape (3,)
        In the site's frame.
    ambient_cov_T2 : ndarray, shape (3, 3)
    """

    position_m: FloatArray
    rotation: FloatArray
    pose_cov: FloatArray
    ambient_T: FloatArray
    ambient_cov_T2: FloatArray


@dataclass(frozen=True, eq=False)
class Estimate:
    """A motion with its uncertainty.

    Attributes
    ----------
    motion : Motion
    covariance : ndarray, shape (18, 18)
        Of the errors in the order of `goldfield.track.blocks.state`.
    """

    motion: Motion
    covariance: FloatArray


class Bank:
    """Filters of different agility; the one that explains the recent blocks best is output.

    Parameters
    ----------
    model : FieldModel
    agilities : ndarray, shape (k, 2)

    Attributes
    ----------
    mismatch : float
        Discounted -2 log likelihood of the filter that is output.
    refused : int
        Blocks in a row that all filters have refused.
    """

    def __init__(self, model: FieldModel, agilities: FloatArray = AGILITIES) -> None:
        self._model, self._agilities = model, agilities
        self.mismatch, self.refused = 0.0, 0

    def start(self, start: Start) -> None:
        """Begin a track; what was known before is forgotten."""
        raise NotImplementedError

    def update(self, form: NormalForm, seconds: float) -> bool:
        """Go on by some seconds to the middle of a block and take it; False if all filters refuse it."""
        raise NotImplementedError

    def predict(self, seconds: float) -> None:
        """Go on by some seconds without a block."""
        raise NotImplementedError

    def output(self, seconds: float = 0.0) -> Estimate:
        """Return what the best filter believes of the moment so many seconds after the middle of the last block."""
        raise NotImplementedError
