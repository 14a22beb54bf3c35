"""Pose, velocity and turn rate from a single cycle of samples: no average over the motion, no prior."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from goldfield.site import Site
from goldfield.track.estimate import SEARCH_TOLERANCE, VAGUE, Belief, Estimate, estimate, second_order
from goldfield.track.faults import judged
from goldfield.track.motion import State
from goldfield.track.observe import CycleData, CycleObserver
from goldfield.track.report import Reporter
from goldfield.types import FloatArray, Pose, Status

EVALUATIONS = 80
IMPROBABLE = 1e-5


@dataclass(frozen=True, eq=False)
class MovingPose:
    """A sensor in motion at the middle of a cycle.

    Attributes
    ----------
    pose : Pose
    state : State or None
        The state with velocity, turn rate and ambient field; None if there is no pose.
    covariance : ndarray, shape (15, 15)
        Covariance of the state's error, in the order of `goldfield.track.motion`.
    """

    pose: Pose
    state: State | None
    covariance: FloatArray


class CycleLocator:
    """Locates moving sensors from whole cycles of samples.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self._observer = CycleObserver(site)
        self._reporter = Reporter(site)

    def locate(self, data: CycleData) -> MovingPose:
        """Locate with no prior; the statuses are those of `locate`."""
        pose, start = self._observer.start(data)
        if start is None:
            return MovingPose(pose, None, np.full((15, 15), np.nan))
        outcome = self.around(start, data)
        belief = outcome.belief
        observation, _ = self._observer.observation(data, 0.0)
        judgement = judged(observation, belief.state, Belief(belief.state, np.diag(VAGUE)))
        agrees = outcome.probable(IMPROBABLE) and not judgement.alarm
        final = self._reporter.pose(
            data.epoch,
            data.time_s,
            belief,
            residual=float(np.sqrt(outcome.cost / outcome.count)),
            status=Status.OK if agrees else Status.INCONSISTENT,
            used=data.beacons,
            axes=int(np.isfinite(data.data_T).any(axis=0).sum()),
            reason=None if agrees else "the fields do not agree with the site",
            protection_m=judgement.protection_m(belief.covariance[:3, :3]),
            residuals=judgement.residuals,
        )
        return MovingPose(final, belief.state, belief.covariance)

    def around(self, start: State, data: CycleData) -> Estimate:
        """Fit position, attitude, velocity, turn rate and ambient field at mid-cycle from a state near by."""
        observation, _ = self._observer.observation(data, 0.0)
        found = estimate(Belief(start, np.diag(VAGUE)), observation, EVALUATIONS, SEARCH_TOLERANCE)
        return replace(found, belief=second_order(found.belief, observation))
