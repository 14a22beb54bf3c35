"""Faults placed by an adversary: of the beacon, in the direction and of the size that move the position most unseen.

Around a true pose the model is linear. With the whitened rows T_i of a beacon and the covariance P of the pose, a fault
f of the beacon moves the pose by P T_i' f and adds f' (1 - T_i P T_i') f to the cost. The adversary knows the pose and
takes, of all faults that add as much, the one that moves the position most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from goldfield.field import FieldModel
from goldfield.locate.fit import whitened_jacobian
from goldfield.locate.protection import MISSED_DETECTION
from goldfield.locate.whitening import Independent
from goldfield.site import Site
from tests.bench.locate_trials import Trials

FloatArray = NDArray[np.float64]

LEAST_GAIN = 1e-6
"""Part of a fault that must show in the residuals: where less does the level is infinite or the fault enormous."""


TWO_SIDED = float(-ndtri(0.5 * MISSED_DETECTION))
"""Standard deviations that a normal number exceeds, of either sign, as often as a fault may be missed."""


def worst_faults(site: Site, trials: Trials) -> tuple[FloatArray, FloatArray]:
    """Return the worst faults, and what no protection level can be below.

    Returns
    -------
    fault_T : ndarray, shape (e, n, 3)
        The worst fault that adds 1 to the cost of each epoch, T, in the sensor's frame.
    floor_m : ndarray, shape (e,)
        `TWO_SIDED` times the largest standard deviation of the position without one beacon: a pose whose residuals are
        none at all may be as far off as this by a fault.
    """
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
    move = influence[..., :3].swapaxes(2, 3) @ root
    _, size, direction = np.linalg.svd(move)
    epoch, worst = np.arange(count), size[..., 0].argmax(axis=1)
    fault = np.zeros((count, beacons, 3))
    chosen = root[epoch, worst] @ direction[epoch, worst, 0][..., None]
    fault[epoch, worst] = trials.sigma_T[epoch, worst, None] * chosen[..., 0]
    without = covariance[:, None, :3, :3] + move @ move.swapaxes(2, 3)
    return fault, TWO_SIDED * np.sqrt(np.linalg.eigvalsh(without)[..., -1].max(axis=1))
