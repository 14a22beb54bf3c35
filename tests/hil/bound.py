"""Errors of poses beside the least that any estimate can have, the Cramer-Rao bound of the site's noise."""

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.locate.uncertainty import cramer_rao_bound

WITHIN = 0.3
"""How far from the bound the errors of 20 poses and more may be, as part of it. They scatter by 9 % at the bound."""


def errors(pose, truth):
    """Return the error of a position, m, and of an attitude as a rotation vector, rad: shape (2, 3)."""
    turn = Rotation.from_quat(pose.orientation_xyzw) * Rotation.from_quat(truth.orientation_xyzw).inv()
    return np.array([pose.position_m - truth.position_m, turn.as_rotvec()])


def over_bound(site, poses, truth):
    """Return the rms error of position and of attitude, each over its bound in its direction: shape (2,).

    Parameters
    ----------
    site : Site
    poses : sequence of Pose
    truth : mapping
        True poses by epoch.
    """
    true = [truth[pose.epoch] for pose in poses]
    bounds = cramer_rao_bound(site, np.array([one.position_m for one in true]))
    error = np.array([errors(*pair) for pair in zip(poses, true, strict=True)])
    least = np.stack([bounds[:, :3, :3], bounds[:, 3:, 3:]], axis=1)
    squares = np.einsum("eki,eki->ek", error, np.linalg.solve(least, error[..., None])[..., 0]) / 3.0
    return np.sqrt(squares.mean(axis=0))


def check_at_the_bound(site, poses, truth, within=WITHIN):
    """Fail if the errors are further from their bounds than so large a part of them; print how far they are."""
    ratios = over_bound(site, poses, truth)
    print(f"error over bound: {ratios[0]:.3f} (position), {ratios[1]:.3f} (attitude), {len(poses)} poses")
    assert np.abs(ratios - 1.0).max() < within
