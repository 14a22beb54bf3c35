"""Turns beliefs into poses with a status."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Protocol

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate.poses import WEAK_ATTITUDE_RAD, WEAK_POSITION
from goldfield.locate.rotations import quaternion_of
from goldfield.site import Site
from goldfield.track.continuity import joined
from goldfield.track.motion import POSITION, TURN
from goldfield.types import Finding, FloatArray, Pose, Status


class Placed(Protocol):
    """A sensor's place and attitude, whatever else is known of it."""

    @property
    def position_m(self) -> FloatArray:
        """Position, shape (3,)."""
        ...

    @property
    def rotation(self) -> FloatArray:
        """Attitude, shape (3, 3)."""
        ...


class Known(Protocol):
    """A state with the covariance of its error, position and a small rotation first."""

    @property
    def state(self) -> Placed:
        """The state."""
        ...

    @property
    def covariance(self) -> FloatArray:
        """Covariance, shape (m, m)."""
        ...


class Reporter:
    """Makes the poses of one site.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self._model = FieldModel(site.beacons)
        self._alert_limit_m = site.alert_limit_m

    def pose(
        self,
        epoch: int,
        time_s: float,
        belief: Known,
        *,
        residual: float = float("nan"),
        status: Status = Status.OK,
        used: tuple[str, ...] = (),
        excluded: tuple[str, ...] = (),
        axes: int = 3,
        reason: str | None = None,
        protection_m: float = math.inf,
        residuals: Mapping[str, float] | None = None,
        findings: tuple[Finding, ...] = (),
    ) -> Pose:
        """Return a belief as a pose; ``ok`` becomes ``weak`` or ``unverified`` where `locate` would call it so.

        ``axes`` is the number of the sensor's axes: the turn about a single one is free and does not count.
        """
        covariance = belief.covariance
        position_cov, attitude_cov = covariance[POSITION, POSITION], covariance[TURN, TURN]
        if status is Status.OK:
            nearest = self._model.nearest_m(belief.state.position_m[None])[0]
            # The worst axis is not worse than all together, which tells of nearly all poses that they are not weak
            worst, turn = (math.sqrt(part[0, 0] + part[1, 1] + part[2, 2]) for part in (position_cov, attitude_cov))
            if worst > WEAK_POSITION * nearest or turn > WEAK_ATTITUDE_RAD:
                shifts, turns = np.sqrt(np.linalg.eigvalsh(np.stack([position_cov, attitude_cov])))
                worst, turn = shifts[2], turns[1 if axes == 1 else 2]
            if worst > WEAK_POSITION * nearest or turn > WEAK_ATTITUDE_RAD:
                status = Status.WEAK
                reason = joined(
                    reason, f"the beacons fix the position to {worst:.2g} m and the attitude to {turn:.2g} rad only"
                )
            elif not protection_m <= self._alert_limit_m:
                status = Status.UNVERIFIED
                hidden = f"{protection_m:.2g} m" if math.isfinite(protection_m) else "any size"
                reason = joined(
                    reason,
                    f"a fault of one beacon could hide an error of {hidden} (the limit is {self._alert_limit_m:g} m)",
                )
        return Pose(
            epoch=epoch,
            time_s=time_s,
            position_m=belief.state.position_m,
            orientation_xyzw=quaternion_of(belief.state.rotation),
            position_cov_m2=position_cov,
            attitude_cov_rad2=attitude_cov,
            residual=residual,
            status=status,
            used=used,
            excluded=excluded,
            reason=reason,
            protection_m=protection_m,
            residuals=residuals or {},
            findings=findings,
        )

    def again(self, pose: Pose, state: Placed, covariance: FloatArray) -> Pose:
        """Return the same pose with another state and its covariance, shape (15, 15)."""
        return replace(
            pose,
            position_m=state.position_m,
            orientation_xyzw=quaternion_of(state.rotation),
            position_cov_m2=covariance[POSITION, POSITION],
            attitude_cov_rad2=covariance[TURN, TURN],
        )
