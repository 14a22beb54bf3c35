"""How well coils are spread, as seen from somewhere: near a line or a point their fields tell less.

Coils on a line have nearly the same fields at other places around it, and coils around a point at the place across it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.types import FloatArray

SPREAD = 0.25
"""Second largest extent of coils that are spread well, over the largest and over their distance, at the least."""


class Spread:
    """The spread of some coils or of all.

    Parameters
    ----------
    centre_m : ndarray, shape (n, 3)
    """

    def __init__(self, centre_m: FloatArray) -> None:
        self._centre_m = centre_m
        self._all = self._extent(np.ones((1, len(centre_m)), dtype=np.bool_))

    def good(self, some: NDArray[np.bool_], position_m: FloatArray) -> NDArray[np.bool_]:
        """Tell where some of the coils, shape (e, n), are spread well as seen from positions, shape (e, 3).

        A row of all coils, the usual one, costs little: their extent is known.
        """
        every, result = some.all(axis=1), np.zeros(len(some), dtype=np.bool_)
        if every.any():
            result[every] = _seen(*self._all, position_m[every])
        if not every.all():
            result[~every] = _seen(*self._extent(some[~every]), position_m[~every])
        return result

    def _extent(self, some: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Return the middles of some of the coils and the squares of their three extents, ascending, shape (e, 3)."""
        share = some / some.sum(axis=1, keepdims=True)
        middle = share @ self._centre_m
        offset = self._centre_m - middle[:, None]
        return middle, np.linalg.eigvalsh(np.einsum("en,eni,enj->eij", share, offset, offset))


def _seen(middle: FloatArray, extent2: FloatArray, position_m: FloatArray) -> NDArray[np.bool_]:
    away2 = ((position_m - middle) ** 2).sum(axis=1)
    return np.asarray(extent2[:, 1] >= SPREAD**2 * np.maximum(extent2[:, 2], away2))
