"""The least error that any locator can reach at each point of a room, beside SciPy's derivatives at each point.

A plan tells more of each point: the protection level, a second pose that fits, the beacons that matter.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.planning import Grid, Request, Settings, plan
from tests.bench import locate_trials as trials
from tests.bench.integrity_sites import EXACT, told
from tests.bench.peers.bench import Bench, named
from tests.bench.peers.row import Row

SUBJECT = "plan"
LOW_M, HIGH_M, STEP_M = np.array([0.3, 0.3, 0.3]), np.array([1.8, 1.8, 1.5]), 0.1
EVERY = 40
"""SciPy gets each so-manieth point."""


def rows(bench: Bench) -> list[Row]:
    """Return the rows of the subject; both must find the same errors."""
    site = told(trials.prigge_cube(), EXACT)
    grid = Grid.of_box(LOW_M, HIGH_M, STEP_M)
    request = Request(site, grid, Settings(truncation=0.0))
    model, sigma = FieldModel(site.beacons), site.sensor.noise_T / np.sqrt(site.chips)
    points = np.stack(np.meshgrid(grid.x_m, grid.y_m, grid.z_m, indexing="ij"), axis=-1).reshape(-1, 3)[::EVERY]

    def ours() -> Any:
        return plan(request).figures.position_sd_m

    def bound(point: Any) -> float:
        seen = model.field(point)

        def residual(x: Any) -> Any:
            turned = Rotation.from_rotvec(x[3:]).as_matrix()
            return ((seen - model.field(point + x[:3]) @ turned) / sigma).ravel()

        derivatives = least_squares(residual, np.zeros(6), max_nfev=1).jac
        return float(np.sqrt(np.trace(np.linalg.inv(derivatives.T @ derivatives)[:3, :3])))

    def theirs() -> list[float]:
        return [bound(point) for point in points]

    assert np.allclose(ours().ravel()[::EVERY], theirs(), rtol=0.02)
    what = f"the bound at a point among 8 beacons, {len(grid):,} in a plan"
    peer = f"{named('scipy')}, least_squares, one by one"
    return [bench.pair(SUBJECT, what, ours, peer, theirs, work=len(grid), their_work=len(points))]
