"""Poses of a sensor that walks: the tracker of whole cycles beside SciPy's optimiser.

SciPy fits each epoch by itself, from the pose before: the same fields, but nothing of the motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.track import Tracker
from goldfield.types import Fields
from tests.bench import locate_trials as trials
from tests.bench.locate_speed import walk
from tests.bench.peers.bench import Bench, named
from tests.bench.peers.row import Row

SUBJECT = "tracking"
EPOCHS = 40
FAR_M = 0.03


def fitted(model: FieldModel, epochs: list[Fields], position: Any, rotation: Any) -> list[Any]:
    """Return the position of each epoch, each fitted from the pose before."""
    found = []
    for epoch in epochs:
        sigma = epoch.sigma_T[:, None]

        def residual(x: Any, epoch: Fields = epoch, sigma: Any = sigma, at: Any = (position, rotation)) -> Any:
            turned = Rotation.from_rotvec(x[3:]).as_matrix() @ at[1]
            return ((epoch.field_T - model.field(at[0] + x[:3]) @ turned) / sigma).ravel()

        x = least_squares(residual, np.zeros(6), x_scale="jac").x
        position, rotation = position + x[:3], Rotation.from_rotvec(x[3:]).as_matrix() @ rotation
        found.append(position)
    return found


def rows(bench: Bench) -> list[Row]:
    """Return the rows of the subject; both must follow the walk."""
    site, rng = trials.prigge_cube(), np.random.default_rng(106)
    path, model = walk(site, rng, EPOCHS), FieldModel(site.beacons)

    def ours() -> list[Any]:
        tracker = Tracker(site)
        return [tracker.update(epoch).position_m for epoch in path]

    first = Tracker(site).update(path[0])
    turn = Rotation.from_quat(first.orientation_xyzw).as_matrix()

    def theirs() -> list[Any]:
        return fitted(model, path, first.position_m, turn)

    apart = np.linalg.norm(np.array(ours()) - np.array(theirs()), axis=1)
    assert apart.max() < FAR_M, apart
    what = "an update by a cycle of 8 beacons"
    return [bench.pair(SUBJECT, what, ours, f"{named('scipy')}, least_squares", theirs, work=EPOCHS)]
