"""Fixed-lag smoothing: what later epochs say of an earlier one.

The filter's steps of the last epochs are kept. When a new one comes, Rauch, Tung and Striebel's recursion runs back
over them, on the errors of the predicted states, and the oldest goes out with all that the lag could add.

The gains are those of the covariances with which the filter weights. With errors of the site the covariance that is
reported has the filter's two parts (`goldfield.track.estimate.Fixed`), each carried back with these gains: what the
errors do to the states exactly, noise and motion but for a correlation, which is none if the gains are the best ones.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Generic

import numpy as np

from goldfield.site import Site
from goldfield.track.continuity import Hemisphere
from goldfield.track.estimate import Belief
from goldfield.track.filter import Step, Tracker
from goldfield.track.motion import State
from goldfield.track.observe import T
from goldfield.track.report import Reporter
from goldfield.types import FloatArray, Pose


class FixedLagSmoother(Generic[T]):
    """Smooths what a tracker believes.

    Parameters
    ----------
    site : Site
    tracker : Tracker
    lag : int
        Epochs by which the poses are late; 5 to 10 give nearly all that there is to gain.

    Raises
    ------
    ValueError
        If the lag is below 1.
    """

    def __init__(self, site: Site, tracker: Tracker[T], lag: int) -> None:
        if lag < 1:
            raise ValueError(f"the lag is {lag} epochs; it must be at least 1")
        self._reporter = Reporter(site)
        self._tracker, self._lag = tracker, lag
        self._steps: deque[Step] = deque()
        self._hemisphere = Hemisphere()

    def update(self, data: T) -> list[Pose]:
        """Take a cycle's data; return the poses that are now ready, oldest first: mostly one, several after a break.

        Every epoch comes out once, in order, with the status, beacons and residual that the tracker gave it.
        """
        step = self._tracker.step(data)
        ready: list[Pose] = []
        if step.predicted is None:  # nothing is carried over: what is kept can gain no more
            ready = self.finish()
        self._steps.append(step)
        if step.belief is None:
            return ready + self.finish()
        if len(self._steps) > self._lag:
            ready.append(self._hemisphere.follow(self._smoothed()[0]))
            self._steps.popleft()
        return ready

    def finish(self) -> list[Pose]:
        """Return the poses of all epochs that are kept; the smoother is then empty."""
        ready = [self._hemisphere.follow(pose) for pose in self._smoothed()]
        self._steps.clear()
        return ready

    def poses(self, epochs: Iterable[T]) -> Iterator[Pose]:
        """Yield the smoothed pose of every epoch."""
        for data in epochs:
            yield from self.update(data)
        yield from self.finish()

    def _smoothed(self) -> list[Pose]:
        poses: list[Pose] = []
        back: _Back | None = None
        later: Step | None = None
        for step in reversed(self._steps):
            if step.belief is None:
                return [step.pose]
            back = _Back.told(step.belief, later, back)
            poses.append(self._reporter.again(step.pose, back.state, back.reported))
            later = step
        return poses[::-1]


@dataclass(frozen=True, eq=False)
class _Back:
    """What is believed of a step after all steps that follow; ``fixed`` is None if the site is exact."""

    state: State
    covariance: FloatArray
    fixed: tuple[FloatArray, FloatArray] | None
    """Covariance by noise and motion, and sensitivity to the errors of the site."""

    @property
    def reported(self) -> FloatArray:
        if self.fixed is None:
            return self.covariance
        noise, sensitivity = self.fixed
        return noise + sensitivity @ sensitivity.T

    @staticmethod
    def told(belief: Belief, later: Step | None, back: _Back | None) -> _Back:
        """Return what is believed of a step by what is now believed of the next."""
        covariance = belief.root @ belief.root.T
        fixed = None if belief.fixed is None else (belief.fixed.noise @ belief.fixed.noise.T, belief.fixed.sensitivity)
        if later is None or back is None or later.predicted is None or later.transition is None:
            return _Back(belief.state, covariance, fixed)
        predicted, onward = later.predicted, later.transition
        before = predicted.root @ predicted.root.T
        gain = _divided(covariance @ onward.T, before)
        state = belief.state.moved(gain @ back.state.minus(predicted.state))
        covariance = covariance + gain @ (back.covariance - before) @ gain.T
        if fixed is None or back.fixed is None or predicted.fixed is None:
            return _Back(state, covariance, None)
        noise, sensitivity = fixed
        kept = gain @ onward @ noise
        moved = predicted.fixed.noise @ predicted.fixed.noise.T + back.fixed[0]
        noise = noise - kept - kept.T + gain @ moved @ gain.T
        sensitivity = sensitivity + gain @ (back.fixed[1] - predicted.fixed.sensitivity)
        return _Back(state, covariance, (noise, sensitivity))


def _divided(left: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return left times the inverse of a covariance whose rows have different units."""
    scale = 1.0 / np.sqrt(np.diag(covariance))
    inverse = np.linalg.inv(covariance * np.outer(scale, scale))
    return np.asarray((left * scale) @ inverse * scale)
