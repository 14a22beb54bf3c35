"""Whether the beacons' fields agree with the site now: tests of what a track leaves of the last few blocks.

A cycle is judged when it is over (`goldfield.track.blocks.judge`); metal that passes has drawn a pose by then. So with
every fourth block the fields that the track leaves are summed over the last 4, 8, 16 and 32 blocks, their common pose
taken out, and tested: sums with their sign see what bends the fields for a while long before the noise of single
blocks lets it show (docs/blocks.md, "Uneven field"). The ambient field has no part in it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from goldfield.locate.chances import chdtri
from goldfield.track.blocks.consider import BENDS, Considered
from goldfield.track.blocks.equations import NormalForm
from goldfield.track.blocks.kernel import double
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


_TAKEN: list[FloatArray] = [
    np.array([np.arange(count) >= count - window for window in WINDOWS if window <= count], dtype=np.float64)
    for count in range(max(WINDOWS) + 1)
]
"""Which groups each window takes, by how many there are: one row a window."""


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
        self._weight: FloatArray | None = None
        self._variance: FloatArray = np.empty((0, 0))
        self.forget()

    def forget(self) -> None:
        """Begin anew; what was said last holds until there are blocks to test."""
        self._groups: deque[FloatArray] = deque(maxlen=max(WINDOWS))
        self._within: list[FloatArray] = []
        self._out: tuple[int, ...] = ()

    def add(self, rest: NormalForm, blur: FloatArray, around: Reference, out: NDArray[np.intp]) -> None:
        """Add what the track has left of a block, in the sensor's frame; ``out`` are the rows that are left out."""
        if tuple(out) != self._out:
            self.forget()
            self._out = tuple(out)
        form = rest.without(out).beacons_alone
        self._within.append(np.concatenate([form.gram[:-1, :-1].ravel(), blur, form.sums_T[:-1].ravel()]))
        if len(self._within) == GROUP:
            self._groups.append(np.sum(self._within, axis=0))
            self._within = []
            self._test(form, around)

    def _test(self, form: NormalForm, around: Reference) -> None:
        """Test the blocks of each window."""
        heard, measured = np.flatnonzero(np.diag(form.gram)[:-1] > 0.0), np.flatnonzero(form.axes)
        if 3 * len(heard) <= POSE:
            self.alarm, self.share = False, 0.0
            return
        if form.weight is not self._weight:  # always the same while the sensor's axes are
            self._weight = form.weight
            self._variance = np.asarray(np.linalg.inv(form.weight[np.ix_(measured, measured)]), dtype=np.float64)
        errors = self._considered.effects(around.motion)
        # By a single axis the turn about it is free, and what a pose explains is not six numbers.
        tested = _in_c if double.ready() and len(measured) > 1 else found_in_numpy
        found = tested(_sums(self._groups), (heard, measured), around, errors, self._variance)
        self.alarm = any(one.alarm for one in found)
        self.share = max((one.share for one in found), default=0.0)


def _in_c(
    sums: FloatArray,
    taken: tuple[NDArray[np.intp], NDArray[np.intp]],
    around: Reference,
    errors: FloatArray | None,
    variance: FloatArray,
) -> list[Found]:
    """Compute what `found_in_numpy` returns."""
    fields = around.field_T, around.jacobian, around.motion.rotation
    size = len(taken[0]) * len(taken[1])
    costs = double.watch(sums, taken, fields, errors, variance, SHOWN).tolist()
    return [_judged(size, whole, part, int(freedom), bent) for told, whole, part, freedom, bent in costs if told]


def found_in_numpy(
    sums: FloatArray,
    taken: tuple[NDArray[np.intp], NDArray[np.intp]],
    around: Reference,
    errors: FloatArray | None,
    variance: FloatArray,
) -> list[Found]:
    """Test the sums of w windows, shape (w, n^2 + n + 3 n): the reference of the version in C.

    Parameters
    ----------
    sums : ndarray
        Gram matrix, blur and sums of n beacons, one row a window.
    taken : pair of ndarray of int
        Rows of the beacons that are heard, and axes that are measured.
    around : Reference
    errors : ndarray, shape (n + 1, 3, k), optional
        What each error of the site does to the fields.
    variance : ndarray, shape (c, c)
        That of a sample, along the axes that are measured.

    Returns
    -------
    list of Found
        Without windows that do not tell their signals apart.
    """
    heard, measured = taken
    to_sensor = around.motion.rotation.T
    bent = (around.field_T[:-1] @ around.motion.rotation @ BENDS).transpose(1, 2, 0)
    parts = [to_sensor @ around.jacobian[:-1, :, :POSE], bent]
    if errors is not None:
        parts.append(to_sensor @ errors[:-1])
    ways = np.concatenate(parts, axis=2)[heard][:, measured]
    windows = _windows(sums, len(around.field_T) - 1).of(heard, measured)
    try:
        return _found(windows, ways, variance)
    except np.linalg.LinAlgError:  # the blocks of some windows do not tell their signals apart
        return [one for window in windows.each() for one in _found_if_told_apart(window, ways, variance)]


def _sums(groups: Sequence[FloatArray]) -> FloatArray:
    """Sum the latest groups, as many as each window has; the latest group is the last."""
    return _TAKEN[len(groups)] @ np.array(groups)


@dataclass(frozen=True, eq=False)
class _Windows:
    """What blocks leave of their sums in w windows, with the Gram matrices and what the track's error adds to them.

    The shapes are (w, n, n), (w, n) and (w, n, c).
    """

    gram: FloatArray
    blur: FloatArray
    sums_T: FloatArray

    def of(self, heard: NDArray[np.intp], measured: NDArray[np.intp]) -> _Windows:
        """Return that of some beacons and axes."""
        gram = self.gram[:, heard][:, :, heard]
        return _Windows(gram, self.blur[:, heard], self.sums_T[:, heard][:, :, measured])

    def each(self) -> list[_Windows]:
        """Return each window by itself."""
        return [
            _Windows(*(part[None] for part in parts)) for parts in zip(self.gram, self.blur, self.sums_T, strict=True)
        ]


def _windows(sums: FloatArray, beacons: int) -> _Windows:
    """Take the sums of windows apart."""
    gram, blur, left = np.split(sums, [beacons**2, beacons**2 + beacons], axis=1)
    return _Windows(gram.reshape(-1, beacons, beacons), blur, left.reshape(-1, beacons, 3))


@dataclass(frozen=True)
class Found:
    """What a window tells: `Watch.alarm` and `Watch.share`."""

    alarm: bool
    share: float


def _found(windows: _Windows, ways: FloatArray, variance: FloatArray) -> list[Found]:
    """Test the sums of n beacons and c components in all windows at once.

    ``ways``, shape (n, c, k), is what the pose, distortions and errors of the site do to the fields; ``variance``,
    shape (c, c), that of a sample.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the blocks of a window do not tell its signals apart.
    """
    count, size, told = len(windows.gram), windows.sums_T[0].size, POSE + DISTORTED
    seen = (windows.gram @ ways.reshape(len(ways), -1)).reshape(count, size, -1)
    spread = windows.gram.copy()
    spread[:, range(len(ways)), range(len(ways))] += windows.blur
    noise = np.einsum("wij,kl->wikjl", spread, variance).reshape(count, size, size)
    noise += seen[..., told:] @ seen[..., told:].swapaxes(1, 2)
    signals = np.concatenate([seen[..., :told], windows.sums_T.reshape(count, size, 1)], axis=2)
    white = np.linalg.solve(np.linalg.cholesky(noise), signals)
    pose, _ = np.linalg.qr(white[..., :POSE])
    rest = white[..., POSE:] - pose @ (pose.swapaxes(1, 2) @ white[..., POSE:])
    along, values, _ = np.linalg.svd(rest[..., :-1], full_matrices=False)
    shown = values > SHOWN * np.linalg.norm(white[..., POSE:told], axis=(1, 2))[:, None]
    parts = np.where(shown, (along.swapaxes(1, 2) @ rest[..., -1:])[..., 0], 0.0)
    whole, part, freedom = np.square(rest[..., -1]).sum(axis=1), np.square(parts).sum(axis=1), shown.sum(axis=1)
    bent = np.square(np.where(shown, values, 0.0)).sum(axis=1)
    costs = zip(whole.tolist(), part.tolist(), freedom.tolist(), bent.tolist(), strict=True)
    return [_judged(size, *cost) for cost in costs]


def _found_if_told_apart(window: _Windows, ways: FloatArray, variance: FloatArray) -> list[Found]:
    """Return what one window tells, in a list that is empty if it tells nothing."""
    try:
        return _found(window, ways, variance)
    except np.linalg.LinAlgError:
        return []


def _judged(size: int, whole: float, part: float, freedom: int, bent: float) -> Found:
    """Judge a cost of so many numbers, and the part of it that distortions explain, which weigh ``bent``."""
    beyond = part - freedom - CHANCE * math.sqrt(2.0 * freedom)
    alarm = whole > _limit(size - POSE) or part > _limit(freedom)
    return Found(alarm, math.sqrt(beyond / bent) if beyond > 0.0 else 0.0)


@cache
def _limit(freedom: int) -> float:
    return float(chdtri(freedom, FALSE_ALARM)) if freedom > 0 else math.inf
