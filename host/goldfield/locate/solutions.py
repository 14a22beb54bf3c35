"""What a search found of each epoch: the best pose, and a rival that the measurements cannot tell from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.fit import Fit
from goldfield.types import FloatArray


@dataclass(frozen=True)
class Solutions:
    """Best pose of each of e epochs and the rival that the measurements cannot tell from it.

    Attributes
    ----------
    best, rival : Fit
    contested : ndarray of bool, shape (e,)
        True where there is a rival; else its row repeats the best pose.
    outside : ndarray of bool, shape (e,)
        True where even the best pose is on the wrong side of the half-space.
    bounded : ndarray of bool, shape (e,)
        True where the search came to the end of its evaluations: a better pose may exist, and a large cost proves
        nothing.
    covariance_widening : ndarray, shape (e, 6, 6)
        To be added to the covariance of the best pose (m, rad in the site's frame): what it lacks because the valley
        of the cost bends or has several minima close together.
    evaluations : ndarray of int, shape (e,)
        Evaluations of the field that the search took; 0 where none was needed.
    """

    best: Fit
    rival: Fit
    contested: NDArray[np.bool_]
    outside: NDArray[np.bool_]
    bounded: NDArray[np.bool_]
    covariance_widening: FloatArray
    evaluations: NDArray[np.intp]

    def put(self, rows: NDArray[np.intp], other: Solutions) -> None:
        """Replace some of the epochs, in place."""
        self.best.put(rows, other.best)
        self.rival.put(rows, other.rival)
        self.contested[rows], self.outside[rows], self.bounded[rows] = other.contested, other.outside, other.bounded
        self.covariance_widening[rows], self.evaluations[rows] = other.covariance_widening, other.evaluations

    def take(self, rows: NDArray[np.intp]) -> Solutions:
        """Return some of the epochs."""
        return Solutions(
            self.best.take(rows),
            self.rival.take(rows),
            self.contested[rows],
            self.outside[rows],
            self.bounded[rows],
            self.covariance_widening[rows],
            self.evaluations[rows],
        )


def nowhere(count: int) -> Fit:
    """Return poses that were not found: not finite, at an infinite cost."""
    return Fit(
        np.full((count, 3), np.nan),
        np.broadcast_to(np.eye(3), (count, 3, 3)).copy(),
        np.full(count, np.inf),
        np.zeros((count, 6, 6)),
        np.zeros(count, dtype=bool),
    )


def unsolved(best: Fit) -> Solutions:
    """Return fits as solutions that have no rivals yet."""
    count = len(best.cost)
    return Solutions(
        best=best,
        rival=best.take(np.arange(count)),
        contested=np.zeros(count, dtype=bool),
        outside=np.zeros(count, dtype=bool),
        bounded=~best.converged & np.isfinite(best.cost),
        covariance_widening=np.zeros((count, 6, 6)),
        evaluations=np.zeros(count, dtype=np.intp),
    )
