"""Whether the beacons' fields agree with the site now: tests of what a track leaves of the last few blocks.

A cycle is judged when it is over (`goldfield.track.blocks.judge`); metal that passes has drawn a pose by then. So with
every fourth block the fields that the track leaves are summed over the last 4, 8, 16 and 32 blocks, their common pose
taken out, and tested: sums with their sign see what bends the fields for a while long before the noise of single
blocks lets it show (docs/blocks.md, "Uneven field"). The ambient field has no part in it.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.chances import chdtri
from goldfield.track.blocks.consider import DISTORTIONS, Considered
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.update import Reference
from goldfield.types import FloatArray

GROUP = 4
"""Blocks that are summed before they are tested."""

WINDOWS = (1, 2, 4, 8)
"""Groups that are tested together."""

FALSE_ALARM = 1e-6
"""Rate of false alarms of each test."""

CHANCE = 2.0
"""A distortion widens the covariance as far as its part of the cost is above its mean by so many of its deviations."""

POSE, DISTORTED = 6, 6
"""Numbers of a pose, and of a symmetric distortion."""

SHOWN = 1e-6
"""Distortions of which less than this part shows beside the pose are not told."""


class Watch:
    """Watches the blocks of one track.

    Parameters
    ----------
    considered : Considered
        The errors that the site declares.

    Attributes
    ----------
    alarm : bool
        The last blocks contradict the site.
    share : float
        By which part of themselves the fields may be bent, as far as the last blocks do not tell it from chance.
    """

    def __init__(self, considered: Considered) -> None:
        self._considered = considered
        self.alarm, self.share = False, 0.0
        self.forget()

    def forget(self) -> None:
        """Begin anew; what was said last holds until there are blocks to test."""
        self._groups: deque[_Sums] = deque(maxlen=max(WINDOWS))
        self._within: list[_Sums] = []
        self._out: tuple[int, ...] = ()

    def add(self, rest: NormalForm, blur: FloatArray, around: Reference, out: NDArray[np.intp]) -> None:
        """Add what the track has left of a block, in the sensor's frame; ``out`` are the rows that are left out."""
        if tuple(out) != self._out:
            self.forget()
            self._out = tuple(out)
        form = rest.without(out).beacons_alone
        self._within.append(_Sums(form.gram[:-1, :-1], blur, form.sums_T[:-1]))
        if len(self._within) == GROUP:
            self._groups.append(_added(self._within))
            self._within = []
            self._test(form, around)

    def _test(self, form: NormalForm, around: Reference) -> None:
        """Test the blocks of each window."""
        heard, measured = np.flatnonzero(np.diag(form.gram)[:-1] > 0.0), np.flatnonzero(form.axes)
        to_sensor = around.motion.rotation.T
        bent = (around.field_T[:-1] @ around.motion.rotation @ DISTORTIONS).transpose(1, 2, 0)
        parts = [to_sensor @ around.jacobian[:-1, :, :POSE], bent]
        errors = self._considered.effects(around.motion)
        if errors is not None:
            parts.append(to_sensor @ errors[:-1])
        ways = np.concatenate(parts, axis=2)[heard][:, measured]
        variance: FloatArray = np.asarray(np.linalg.inv(form.weight[np.ix_(measured, measured)]), dtype=np.float64)
        groups, found = list(self._groups), []
        if 3 * len(heard) > POSE:
            for count in (count for count in WINDOWS if count <= len(groups)):
                found.append(_found(_added(groups[-count:]).of(heard, measured), ways, variance))
        self.alarm = any(one.alarm for one in found)
        self.share = max((one.share for one in found), default=0.0)


@dataclass(frozen=True, eq=False)
class _Sums:
    """What blocks leave of their sums, with the Gram matrix and what the track's error adds to it."""

    gram: FloatArray
    blur: FloatArray
    sums_T: FloatArray

    def of(self, heard: NDArray[np.intp], measured: NDArray[np.intp]) -> _Sums:
        """Return that of some beacons and axes."""
        return _Sums(self.gram[np.ix_(heard, heard)], self.blur[heard], self.sums_T[np.ix_(heard, measured)])


def _added(several: list[_Sums]) -> _Sums:
    return _Sums(*(np.sum([getattr(one, name) for one in several], axis=0) for name in _Sums.__dataclass_fields__))


@dataclass(frozen=True)
class _Found:
    """What a window tells: `Watch.alarm` and `Watch.share`."""

    alarm: bool
    share: float


def _found(sums: _Sums, ways: FloatArray, variance: FloatArray) -> _Found:
    """Test sums of n beacons and c components.

    ``ways``, shape (n, c, k), is what the pose, distortions and errors of the site do to the fields; ``variance``,
    shape (c, c), that of a sample.
    """
    size, told = sums.sums_T.size, POSE + DISTORTED
    seen = np.einsum("ij,jck->ick", sums.gram, ways).reshape(size, -1)
    spread = sums.gram + np.diag(sums.blur)
    noise = np.multiply.outer(spread, variance).swapaxes(1, 2).reshape(size, size) + seen[:, told:] @ seen[:, told:].T
    try:
        white = np.linalg.solve(np.linalg.cholesky(noise), np.column_stack([seen[:, :told], sums.sums_T.ravel()]))
    except np.linalg.LinAlgError:  # the signals are not told apart
        return _Found(False, 0.0)
    pose, _ = np.linalg.qr(white[:, :POSE])
    rest = white[:, POSE:] - pose @ (pose.T @ white[:, POSE:])
    left = rest[:, -1]
    along, values, _ = np.linalg.svd(rest[:, :-1], full_matrices=False)
    shown = values > SHOWN * float(np.linalg.norm(white[:, POSE:told]))
    part, freedom = float(np.square(along[:, shown].T @ left).sum()), int(shown.sum())
    alarm = float(left @ left) > _limit(size - POSE) or part > _limit(freedom)
    beyond = part - freedom - CHANCE * math.sqrt(2.0 * freedom)
    return _Found(alarm, math.sqrt(beyond / float(np.square(values[shown]).sum())) if beyond > 0.0 else 0.0)


@cache
def _limit(freedom: int) -> float:
    return float(chdtri(freedom, FALSE_ALARM)) if freedom > 0 else math.inf
