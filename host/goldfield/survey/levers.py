"""What the data tell of the sensor's levers, in words.

A lever that all axes have in common is a shift of the reference point: fields alone do not tell it, since the poses
shift with it. Known points do, if the sensor is turned at them. The levers of the axes against each other show in the
gradient of the fields, near the coils.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from goldfield.survey.outcome import Solution
from goldfield.survey.parameters import BEACON, LEVER, UNKNOWN_LEVER_M

UNTOLD = 0.5
"""A lever is not told by the data if more than this part of the deviation of before is left."""


def untold_levers(solution: Solution) -> Iterator[str]:
    """Say which levers were to be found and are not told by the data."""
    first = BEACON * len(solution.state.axis)
    if not solution.problem.prior.free[first:][LEVER].any():
        return
    covariance = solution.covariance[first:, first:][LEVER, LEVER]
    common = np.kron(np.full((1, 3), 1.0 / 3.0), np.eye(3))
    deviation = np.sqrt(np.diag(common @ covariance @ common.T).max())
    if deviation > UNTOLD * UNKNOWN_LEVER_M / np.sqrt(3.0):
        yield (
            f"where the sensor has its reference point is not told, to {1e3 * deviation:.2g} mm, and stays as the site "
            "file has it: give known points of it with the sensor turned in different ways"
        )
    for k, axis in enumerate("xyz"):
        apart = np.kron(np.eye(3)[k], np.eye(3)).reshape(3, 9) - common
        deviation = np.sqrt(np.diag(apart @ covariance @ apart.T).max())
        if deviation > UNTOLD * UNKNOWN_LEVER_M * np.sqrt(2.0 / 3.0):
            yield (
                f"where the sensor's {axis} axis reads beside the others is not told, to {1e3 * deviation:.2g} mm: "
                "walk nearer to the coils, turning the sensor in all ways"
            )
