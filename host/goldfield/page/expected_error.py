"""The error that is to be expected at each place of a plane through the site, as `goldfield.planning` predicts it."""

from __future__ import annotations

import math
import threading
from functools import lru_cache
from typing import Any

import numpy as np

from goldfield.errors import UserError
from goldfield.site import Site
from goldfield.view.coil_wires import site_box

POINTS = 28
"""Points of the map along the longer side of the site."""
HEIGHT_STEP_M = 0.1
"""Heights are rounded to this step, so that a sensor that moves does not ask for a map of its own at every epoch."""


class ExpectedError:
    """Computes maps when they are asked for, one at a time, and keeps the latest of them.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._lock = threading.Lock()
        self._map = lru_cache(maxsize=16)(self._compute)

    def __call__(self, height_m: float) -> dict[str, Any]:
        """Return the map at a height as JSON.

        Returns
        -------
        dict
            ``x_m``, ``y_m``: the places along both axes, lists; ``z_m``: the height, rounded to `HEIGHT_STEP_M`;
            ``position_sd_m``: a row for each y, the expected error at each x, None where there is no bound.

        Raises
        ------
        UserError
            If the height is far from the site, or the site's beacons are none that a plan knows.
        """
        low, high = site_box(self._site)
        size = float((high - low).max())
        if not low[2] - size <= height_m <= high[2] + size:
            raise UserError(f"z={height_m:g}: is far from the beacons, which are at {low[2]:.1f} to {high[2]:.1f} m")
        with self._lock:
            return self._map(round(height_m / HEIGHT_STEP_M))

    def _compute(self, steps: int) -> dict[str, Any]:
        from goldfield.planning import Grid, Request, Settings, plan  # heavy: only when a map is wanted

        low, high = site_box(self._site)
        height_m = steps * HEIGHT_STEP_M
        step_m = float((high - low)[:2].max()) / (POINTS - 1)
        grid = Grid.of_box(np.array([*low[:2], height_m]), np.array([*high[:2], height_m]), step_m)
        settings = Settings(best=min(8, len(self._site.beacons)))
        error_m = plan(Request(self._site, grid, settings), workers=1).figures.position_sd_m[:, :, 0]
        return {
            "x_m": np.round(grid.x_m, 4).tolist(),
            "y_m": np.round(grid.y_m, 4).tolist(),
            "z_m": round(height_m, 3),
            "position_sd_m": [[value if math.isfinite(value) else None for value in row] for row in error_m.T.tolist()],
        }
