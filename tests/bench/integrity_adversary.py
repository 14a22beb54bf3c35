"""Faults placed by an adversary: of the beacon, in the direction and of the size that move the position most unseen.

Around a true pose the model is linear. With the whitened rows T_i of a beacon and the covariance P of the pose, a fault
f of the beacon moves the pose by P T_i' f and adds f' (1 - T_i P T_i') f to the cost. The adversary knows the pose and
takes, of all faults that add as much, the one that moves the position most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from goldfield.field import FieldModel
from goldfield.locate.fit import whitened_jacobian
from goldfield.locate.whitening import Independent
from goldfield.site import Site
from tests.bench.locate_trials import Trials

FloatArray = NDArray[np.float64]

LEAST_GAIN = 1e-6
"""Part of a fault that must show in the residuals: where less does the level is infinite or the fault enormous."""


def worst_faults(site: Site, trials: Trials) -> FloatArray:
    """Return the worst fault that adds 1 to the cost of each epoch, shape (e, n, 3), T, in the sensor's frame."""
    count, beacons = trials.sigma_T.shape
    weight = np.broadcast_to(1.0 / trials.sigma_T[:, None], (count, 3, beacons))
    jacobian = whitened_jacobian(FieldModel(site.beacons), trials.position_m, trials.rotation, Independent(weight))
    scale = np.sqrt(np.einsum("ekm,ekm->ek", jacobian, jacobian))
    covariance = np.linalg.inv(jacobian @ jacobian.swapaxes(1, 2) / (scale[:, :, None] * scale[:, None]))
    covariance /= scale[:, :, None] * scale[:, None]
    rows = jacobian.reshape(count, 6, 3, beacons).transpose(0, 3, 2, 1)  # (e, n, c, 6)
    influence = rows @ covariance[:, None]
    gain, vector = np.linalg.eigh(np.eye(3) - influence @ rows.swapaxes(2, 3))
    root = vector / np.sqrt(np.maximum(gain, LEAST_GAIN))[..., None, :]
    _, size, direction = np.linalg.svd(influence[..., :3].swapaxes(2, 3) @ root)
    epoch, worst = np.arange(count), size[..., 0].argmax(axis=1)
    faults = np.zeros((count, beacons, 3))
    chosen = root[epoch, worst] @ direction[epoch, worst, 0][..., None]
    faults[epoch, worst] = trials.sigma_T[epoch, worst, None] * chosen[..., 0]
    return faults
