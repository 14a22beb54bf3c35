"""A coil on its bridge, solved numerically: the same circuit as ``world/coil.h``, by another way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

FloatArray = NDArray[np.float64]


def integrate(
    changes: Sequence[tuple[float, float]],
    until_s: float,
    times_s: FloatArray,
    *,
    inductance_H: float,
    resistance_Ohm: float,
    supply_V: float,
    lag_s: float,
) -> FloatArray:
    """Integrate from rest: full supply toward the target, then held (event), from one change of the target to the next.

    Parameters
    ----------
    changes : sequence of (time, target)
        Seconds and ampere.
    times_s : ndarray, shape (n,)
        Where to look, at or before ``until_s``.

    Returns
    -------
    ndarray, shape (n, 2)
        Current, and current behind a low-pass of ``lag_s``.
    """
    state = np.zeros(2)
    result = np.zeros((len(times_s), 2))
    ends = [*(start for start, _ in changes[1:]), until_s]
    for (start, target), end in zip(changes, ends, strict=True):
        sign = np.sign(target - state[0])

        def slewing(_, y, sign=sign):
            return [(sign * supply_V - resistance_Ohm * y[0]) / inductance_H, (y[0] - y[1]) / lag_s]

        def held(_, y):
            return [0.0, (y[0] - y[1]) / lag_s]

        def arrived(_, y, target=target):
            return y[0] - target

        arrived.terminal = True
        pieces, time = [(slewing, [arrived])], start
        if sign == 0:
            pieces = []
        pieces.append((held, None))
        for slope, events in pieces:
            if time >= end:
                break
            solution = solve_ivp(
                slope, (time, end), state, events=events, dense_output=True, rtol=1e-10, atol=1e-12, max_step=1e-6
            )
            inside = (times_s >= time) & (times_s <= solution.t[-1])
            if np.any(inside):
                result[inside] = solution.sol(times_s[inside]).T
            time, state = solution.t[-1], solution.y[:, -1].copy()
    return result
