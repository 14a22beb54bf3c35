"""What is known of beacons beside their fields, as rows of the equations that all epochs have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from goldfield.survey.data import Current, Direction, Distance, Known, Place
from goldfield.survey.parameters import BEACON, State, across, turn_between
from goldfield.types import FloatArray

UNFIT = 5.0
"""Something known does not fit if it is so many of its standard deviations off."""


class Constraints:
    """Known distances, places, directions and currents.

    Parameters
    ----------
    known : sequence of Known
    row : mapping of str to int
        Row of each beacon.
    current_A : ndarray, shape (n,)
        Currents of the site, around which the parameters are.
    size : int
        Number of parameters.
    """

    def __init__(self, known: Sequence[Known], row: Mapping[str, int], current_A: FloatArray, size: int) -> None:
        self._known, self._row, self._current_A, self._size = tuple(known), row, current_A, size

    def rows(self, state: State) -> tuple[FloatArray, FloatArray]:
        """Return known less modelled over the standard deviation, shape (k,), and derivatives, shape (k, g)."""
        pairs = [self.one(known, state) for known in self._known]
        residual = np.concatenate([np.empty(0), *(residual for residual, _ in pairs)])
        return residual, np.concatenate([np.empty((0, self._size)), *(jacobian for _, jacobian in pairs)])

    def unfit(self, state: State) -> list[tuple[Known, float]]:
        """Return what is known and does not fit, with the standard deviations by which it is off."""
        sizes = [(known, float(np.abs(self.one(known, state)[0]).max(initial=0.0))) for known in self._known]
        return [(known, size) for known, size in sizes if size > UNFIT]

    def one(self, known: Known, state: State) -> tuple[FloatArray, FloatArray]:
        """Return the same of one known thing."""
        if isinstance(known, Distance):
            i, j = (self._row[name] for name in known.beacons)
            between = state.position_m[i] - state.position_m[j]
            length = max(float(np.linalg.norm(between)), 1e-9)
            jacobian = np.zeros((1, self._size))
            jacobian[0, BEACON * i : BEACON * i + 3] = between / length
            jacobian[0, BEACON * j : BEACON * j + 3] = -between / length
            return np.array([known.distance_m - length]) / known.sd_m, jacobian / known.sd_m
        place = BEACON * self._row[known.beacon]
        if isinstance(known, Place):
            measured = np.flatnonzero(np.isfinite(known.position_m))
            jacobian = np.zeros((len(measured), self._size))
            jacobian[np.arange(len(measured)), place + measured] = 1.0
            deviation = known.position_m - state.position_m[self._row[known.beacon]]
            return deviation[measured] / known.sd_m, jacobian / known.sd_m
        if isinstance(known, Direction):
            axis = state.axis[self._row[known.beacon]][None]
            turn = across(axis)[0] @ turn_between(axis, known.axis[None])[0]
            jacobian = np.zeros((2, self._size))
            jacobian[[0, 1], [place + 3, place + 4]] = 1.0
            return turn / known.sd_rad, jacobian / known.sd_rad
        assert isinstance(known, Current)
        ratio = known.current_A / self._current_A[self._row[known.beacon]]
        jacobian = np.zeros((1, self._size))
        jacobian[0, place + 5] = 1.0
        logarithm = np.log(ratio) - state.log_current[self._row[known.beacon]]
        return np.array([logarithm]) / known.sd, jacobian / known.sd


def name_of_known(known: Known) -> str:
    """Return what a known thing is called in sentences."""
    if isinstance(known, Distance):
        return f"the distance from {known.beacons[0]} to {known.beacons[1]}"
    if isinstance(known, Place):
        return f"the measured place of {known.beacon}"
    if isinstance(known, Direction):
        return f"the measured direction of {known.beacon}"
    assert isinstance(known, Current)
    return f"the current of {known.beacon}"
