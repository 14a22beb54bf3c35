"""Turns beliefs into poses with a status."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.locate.locator import WEAK_ATTITUDE_RAD, WEAK_POSITION
from goldfield.site import Site
from goldfield.track.estimate import Belief
from goldfield.track.motion import POSITION, TURN, State
from goldfield.types import FloatArray, Pose, Status


class Reporter:
    """Makes the poses of one site.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self._centres = FieldModel(site.beacons).centre_m

    def pose(
        self,
        epoch: int,
        time_s: float,
        belief: Belief,
        *,
        residual: float = float("nan"),
        status: Status = Status.OK,
        used: tuple[str, ...] = (),
        excluded: tuple[str, ...] = (),
        axes: int = 3,
    ) -> Pose:
        """Return a belief as a pose; ``ok`` becomes ``weak`` where `locate` would call it so.

        ``axes`` is the number of the sensor's axes: the turn about a single one is free and does not count.
        """
        covariance = belief.covariance
        position_cov, attitude_cov = covariance[POSITION, POSITION], covariance[TURN, TURN]
        if status is Status.OK:
            nearest = np.linalg.norm(belief.state.position_m - self._centres, axis=1).min()
            worst = np.sqrt(np.linalg.eigvalsh(position_cov)[-1])
            turn = np.sqrt(np.linalg.eigvalsh(attitude_cov)[1 if axes == 1 else 2])
            if worst > WEAK_POSITION * nearest or turn > WEAK_ATTITUDE_RAD:
                status = Status.WEAK
        return Pose(
            epoch=epoch,
            time_s=time_s,
            position_m=belief.state.position_m,
            orientation_xyzw=Rotation.from_matrix(belief.state.rotation, assume_valid=True).as_quat(canonical=True),
            position_cov_m2=position_cov,
            attitude_cov_rad2=attitude_cov,
            residual=residual,
            status=status,
            used=used,
            excluded=excluded,
        )

    def again(self, pose: Pose, state: State, covariance: FloatArray) -> Pose:
        """Return the same pose with another state and its covariance, shape (15, 15)."""
        return replace(
            pose,
            position_m=state.position_m,
            orientation_xyzw=Rotation.from_matrix(state.rotation, assume_valid=True).as_quat(canonical=True),
            position_cov_m2=covariance[POSITION, POSITION],
            attitude_cov_rad2=covariance[TURN, TURN],
        )
