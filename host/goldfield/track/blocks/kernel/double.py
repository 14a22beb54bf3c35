"""What the host computes of each block beside the bank, in C and in double precision: rest.h, watch.h, apart.h, even.h.

Each function does what a NumPy function does that its module names, which stays as its reference; where the library
is not built, `ready` is false and the NumPy functions serve. SI units; n beacons.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from goldfield.track.blocks.kernel.library import ffi, filled, given, numbers, opened
from goldfield.track.blocks.state import SIZE, Motion
from goldfield.types import FloatArray

SEEN, MOVED, TOLD = 9, 12, 5
USUAL = 21
"""Numbers of rest.h, apart.h, watch.h and even.h."""

_MOVING, _BLOCK_SUMS, _WATCHED, _ESTIMATE, _EVEN_LIMITS, _ATTITUDE = (
    ffi.typeof(f"{name} *")
    for name in ("gf_moving_t", "gf_block_sums_t", "gf_watched_t", "gf_estimate_t", "gf_even_limits_t", "gf_attitude_t")
)
_DOUBLE = ffi.typeof("double *")
"""Types are parsed here: the first block need not wait for it."""


def ready() -> bool:
    """Return whether the library is built."""
    return opened() is not None


def rest(
    motion: Motion,
    covariance: FloatArray,
    evaluated: tuple[FloatArray, FloatArray],
    block: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what a motion leaves of a block (`goldfield.track.blocks.rest`).

    Parameters
    ----------
    motion : Motion
    covariance : ndarray, shape (18, 18)
    evaluated : pair of ndarray, shapes (3, n) and (3, 3, n)
        Fields and gradients at its position.
    block : triple of ndarray, shapes (n + 1, n + 1) twice and (n + 1, 3)
        Gram matrix, moment and sums.

    Returns
    -------
    tuple
        Fields, slopes and jacobian as `goldfield.track.blocks.update.Reference` has them; what is left, shape
        (n + 1, 3), in the sensor's frame; the blur, shape (n,), T^2.
    """
    count = evaluated[0].shape[-1]
    turning = motion.velocity_m_s, motion.rate_rad_s, motion.ambient_T, motion.offset_T
    arrays = [given(array) for array in (*evaluated, motion.rotation, *turning, covariance)]
    told = (
        np.empty((count + 1, 3)),
        np.empty((count + 1, 3)),
        np.empty((count + 1, 3, SEEN)),
        np.empty((count + 1, 3)),
        np.empty(count),
    )
    sums = [given(array) for array in block]
    _library().gf_rest(
        ffi.new(_MOVING, [count, *arrays]),
        ffi.new(_BLOCK_SUMS, sums),
        filled(np.empty(2 * (count + 1))),
        *map(filled, told),
    )
    return told


def cost(
    gram: FloatArray, sums_T: FloatArray, blur: FloatArray, weight: FloatArray, separable: float
) -> tuple[float, int] | None:
    """Return chi-square of what b blocks leave and about its mean (`goldfield.track.blocks.rest.cost_of`).

    ``gram``, shape (b, n + 1, n + 1), ``sums_T``, shape (b, n + 1, 3), ``blur``, shape (n,). None if the blocks do not
    tell all beacons apart that are heard.
    """
    library, count, told = _library(), len(blur), np.empty(2)
    memory = np.empty(library.gf_cost_memory(count))
    arrays = [given(array) for array in (gram, sums_T, blur, weight)]
    if not library.gf_cost(len(gram), count, *arrays, separable, filled(memory), filled(told)):
        return None
    return float(told[0]), int(told[1])


def watch(
    sums: FloatArray,
    taken: tuple[NDArray[np.intp], NDArray[np.intp]],
    around: tuple[FloatArray, FloatArray, FloatArray],
    effects: FloatArray | None,
    variance: FloatArray,
    shown: float,
) -> FloatArray:
    """Test the sums of windows (`goldfield.track.blocks.watch`).

    Parameters
    ----------
    sums : ndarray, shape (w, n^2 + n + 3 n)
        Gram matrix, blur and what is left of the sums, in each window.
    taken : pair of ndarray of int
        Rows of the beacons and axes of the sensor that take part.
    around : triple of ndarray, shapes (n + 1, 3), (n + 1, 3, 9) and (3, 3)
        Fields, jacobian and attitude.
    effects : ndarray, shape (n + 1, 3, k), optional
        What each error of the site does to the fields.
    variance : ndarray, shape (c, c)
        That of a sample's components that take part.
    shown : float
        Distortions of which less than this part shows are not told.

    Returns
    -------
    ndarray, shape (w, 5)
        1 if the window tells its signals apart, else 0; the whole cost, the part that a distortion explains, how many
        of its numbers show, and what they weigh.
    """
    library, count = _library(), len(around[0]) - 1
    rows, axes = taken
    kinds = 0 if effects is None else effects.shape[-1]
    memory = np.empty(library.gf_watch_memory(len(rows), len(axes), kinds))
    arrays = [given(array) for array in (*around, variance)]
    which = numbers(rows), numbers(axes)
    errors = ffi.NULL if effects is None else given(effects)
    what = ffi.new(
        _WATCHED,
        [count, len(rows), which[0], len(axes), which[1], *arrays[:3], kinds, errors, arrays[3]],
    )
    told = np.empty((len(sums), TOLD))
    library.gf_watch(what, len(sums), given(sums), shown, filled(memory), filled(told))
    return told


def apart(
    seeing: Motion, seeing_cov: FloatArray, alone: Motion, alone_cov: FloatArray, least_share: float
) -> tuple[FloatArray, float] | None:
    """Return by how much two estimates are apart, shape (18,), and the squared distance (`pair._apart`).

    None if the covariance of the second pose is not positive definite.
    """
    error, distance2 = np.zeros(SIZE), ffi.new(_DOUBLE)
    first, second = _estimate(seeing, seeing_cov), _estimate(alone, alone_cov)
    if not _library().gf_apart(first[0], second[0], least_share, filled(error), distance2):
        return None
    return error, float(distance2[0])


def between(
    seeing: Motion, seeing_cov: FloatArray, alone: Motion, alone_cov: FloatArray, error: FloatArray, weight: float
) -> tuple[Motion, FloatArray]:
    """Return what two estimates say together, motion and covariance (`goldfield.track.blocks.pair._between`)."""
    motion, covariance = np.empty(SIZE), np.empty((SIZE, SIZE))
    first, second = _estimate(seeing, seeing_cov), _estimate(alone, alone_cov)
    _library().gf_between(first[0], second[0], given(error), weight, filled(motion), filled(covariance))
    rotation = motion[3:12].reshape(3, 3)
    moved = Motion(motion[:3], rotation, motion[12:15], motion[15:], seeing.ambient_T, seeing.offset_T)
    return moved, covariance


def even(
    limits: Sequence[float],
    motion: Motion,
    covariance: FloatArray,
    seen_T: FloatArray,
    seconds: float,
    usual: FloatArray,
) -> tuple[float, float] | None:
    """Hold the ambient field against what is usual, as `goldfield.track.blocks.evenness.even_in_numpy` does."""
    arrays = [given(array) for array in (motion.rotation, motion.velocity_m_s, motion.offset_T, covariance)]
    told = np.full(2, np.nan)
    _library().gf_even(
        ffi.new(_EVEN_LIMITS, limits),
        ffi.new(_ATTITUDE, arrays),
        given(seen_T),
        seconds,
        filled(usual),
        filled(told),
    )
    change_T, share = told.tolist()
    return None if math.isnan(change_T) else (change_T, share)


def _library() -> Any:
    library = opened()
    assert library is not None, "see `ready`"
    return library


def _estimate(motion: Motion, covariance: FloatArray) -> tuple[Any, list[Any]]:
    """Return an estimate of apart.h, and its arrays, which must live as long."""
    parts = motion.position_m, motion.rotation, motion.velocity_m_s, motion.rate_rad_s, covariance
    arrays = [given(array) for array in parts]
    return ffi.new(_ESTIMATE, arrays), arrays
