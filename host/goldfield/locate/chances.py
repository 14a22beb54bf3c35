"""Chi-square and normal distributions as far as location needs them: whole degrees of freedom, few numbers at a time.

`gammaincc`, `chdtri` and `ndtri` have the names and the meaning of those in ``scipy.special``, whose import takes a
quarter of the processor time up to the first pose. The tail of chi-square is a sum of half as many terms as it has
degrees of freedom (Abramowitz and Stegun, Handbook of Mathematical Functions, 26.4.4 and 26.4.5).
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from goldfield.types import FloatArray

MANY = 100
"""From so many numbers on SciPy is worth its import: it takes a hundredth of the time for each."""

STEPS = 100
"""Most steps to a quantile: a dozen are needed, and more only to those near 0, which halving leads to."""
LAST = 1e-9
"""A step that is no larger than this part of the quantile is the last: the one after it goes with its square."""


def gammaincc(shape: ArrayLike, value: ArrayLike) -> FloatArray:
    """Return the probability that chi-square with 2 ``shape`` degrees of freedom exceeds 2 ``value``.

    Parameters
    ----------
    shape : array_like
        Half the degrees of freedom, which are whole and at least 1.
    value : array_like
        0 or more, and infinity; NaN gives NaN.

    Raises
    ------
    ValueError
        If the degrees of freedom are not whole, or fewer than 1.

    Examples
    --------
    >>> float(gammaincc(1.0, 2.0)) == math.exp(-2.0)
    True
    """
    if isinstance(shape, float) and isinstance(value, float):
        return np.array(_tail(_whole(2.0 * shape), value))
    shape, value = np.broadcast_arrays(shape, value)
    if shape.size >= MANY:
        return _many(shape, value)
    halves = zip(shape.ravel().tolist(), value.ravel().tolist(), strict=True)
    return np.array([_tail(_whole(2.0 * one), half) for one, half in halves]).reshape(shape.shape)


def probability(cost: FloatArray, freedom: NDArray[np.intp]) -> FloatArray:
    """Return the probability of a cost at least as large if model and noise are right (chi-square).

    It is 1 where there is no redundancy.

    Parameters
    ----------
    cost : ndarray, shape (e,)
    freedom : ndarray of int, shape (e,)
        Components minus unknowns.
    """
    if len(cost) == 1:  # as often as not: one epoch takes all ways
        one, degrees = float(cost[0]), float(freedom[0])
        known = math.isfinite(one)
        if degrees > 0.0:
            return gammaincc(degrees / 2.0, one / 2.0 if known else math.inf).reshape(1)
        return np.array([float(known)])
    finite = np.where(np.isfinite(cost), cost, np.inf)
    return np.where(freedom > 0, gammaincc(np.maximum(freedom, 1) / 2.0, finite / 2.0), np.isfinite(cost))


def chdtri(freedom: ArrayLike, probability: ArrayLike) -> FloatArray:
    """Return what chi-square with so many degrees of freedom exceeds with a probability; `gammaincc` tells the error.

    Examples
    --------
    >>> round(float(chdtri(3, 0.05)), 3)
    7.815
    """
    if isinstance(freedom, float) and isinstance(probability, float):
        return np.array(_quantile(_whole(freedom), probability))
    freedom, probability = np.broadcast_arrays(freedom, probability)
    chances = zip(freedom.ravel().tolist(), probability.ravel().tolist(), strict=True)
    return np.array([_quantile(_whole(one), chance) for one, chance in chances]).reshape(freedom.shape)


def ndtri(probability: ArrayLike) -> FloatArray:
    """Return the value below which a normal variable is with a probability.

    Examples
    --------
    >>> round(float(ndtri(0.025)), 3)
    -1.96
    """
    probability = np.asarray(probability, dtype=np.float64)
    square = chdtri(1, 2.0 * np.minimum(probability, 1.0 - probability))
    return np.asarray(np.copysign(np.sqrt(square), probability - 0.5))


def _many(shape: FloatArray, value: FloatArray) -> FloatArray:
    """Return what `gammaincc` returns, by SciPy."""
    from scipy import special  # heavy: not before there is much to compute

    for freedom in np.unique(2.0 * shape).tolist():
        _whole(freedom)
    return np.asarray(special.gammaincc(shape, value))


def _whole(freedom: float) -> int:
    if not (freedom >= 1.0 and freedom == math.floor(freedom)):
        raise ValueError(f"{freedom} degrees of freedom: they are whole and at least 1")
    return int(freedom)


def _tail(freedom: int, half: float) -> float:
    """Return the probability of more than twice ``half``."""
    if not 0.0 < half < math.inf:
        return math.nan if math.isnan(half) else float(half <= 0.0)
    logarithm, odd = math.log(half), freedom % 2
    begin = math.erfc(math.sqrt(half)) if odd else 0.0
    return begin + sum([math.exp(power * logarithm - half - lower) for power, lower in _powers(freedom)])


@lru_cache(maxsize=256)
def _powers(freedom: int) -> tuple[tuple[float, float], ...]:
    """Return the powers of the terms of a tail and the logarithms of what divides them."""
    powers = [0.5 * twice for twice in range(freedom % 2, freedom - 1, 2)]
    return tuple((power, math.lgamma(power + 1.0)) for power in powers)


@lru_cache(maxsize=4096)
def _quantile(freedom: int, probability: float) -> float:
    """Return where the logarithm of the tail is that of the probability: Newton's steps, kept between bounds."""
    if not 0.0 < probability < 1.0:
        return {0.0: math.inf, 1.0: 0.0}.get(probability, math.nan)
    low, high, value = 0.0, math.inf, float(freedom)
    scale = math.lgamma(0.5 * freedom) + 0.5 * freedom * math.log(2.0)
    for _ in range(STEPS):
        tail = _tail(freedom, 0.5 * value)
        low, high = (value, high) if tail > probability else (low, value)
        density = (0.5 * freedom - 1.0) * math.log(value) - 0.5 * value - scale  # its logarithm
        step = math.log(tail / probability) * math.exp(math.log(tail) - density) if tail > 0.0 else -math.inf
        ahead = value + step
        if abs(step) <= LAST * value:
            return ahead
        value = ahead if low < ahead < high else 0.5 * (low + high)  # only beyond the quantile, where both are known
    return value
