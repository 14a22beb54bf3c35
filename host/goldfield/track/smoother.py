"""Fixed-lag smoothing: what later epochs say of an earlier one.

The filter's steps of the last epochs are kept. When a new one comes, Rauch, Tung and Striebel's recursion runs back
over them, on the errors of the predicted states, and the oldest goes out with all that the lag could add.

What errors of the site do to the states goes back with the same gains, exactly. Beside it the covariance with which the
filter weights counts them once more, as noise: the smoothed covariance is an upper bound, a tenth too large or so.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Generic

import numpy as np

from goldfield.site import Site
from goldfield.track.continuity import Hemisphere
from goldfield.track.estimate import Belief
from goldfield.track.filter import Step, Tracker
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
        later: tuple[Belief, FloatArray, FloatArray, FloatArray] | None = None
        moved: FloatArray | None = None
        for step in reversed(self._steps):
            if step.belief is None:
                return [step.pose]
            state, covariance = step.belief.state, step.belief.root @ step.belief.root.T
            fixed = None if step.belief.fixed is None else step.belief.fixed.sensitivity
            reported = step.belief.covariance
            if later is not None:
                predicted, transition, error, change = later
                gain = _divided(covariance @ transition.T, predicted.root @ predicted.root.T)
                state = state.moved(gain @ error)
                covariance = reported = covariance + gain @ change @ gain.T
                if fixed is not None and moved is not None:
                    fixed = fixed + gain @ moved
                    reported = covariance + fixed @ fixed.T
            poses.append(self._reporter.again(step.pose, state, reported))
            if step.predicted is not None and step.transition is not None:
                change = covariance - step.predicted.root @ step.predicted.root.T
                later = step.predicted, step.transition, state.minus(step.predicted.state), change
                moved = None
                if fixed is not None and step.predicted.fixed is not None:
                    moved = fixed - step.predicted.fixed.sensitivity
        return poses[::-1]


def _divided(left: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return left times the inverse of a covariance whose rows have different units."""
    scale = 1.0 / np.sqrt(np.diag(covariance))
    inverse = np.linalg.inv(covariance * np.outer(scale, scale))
    return np.asarray((left * scale) @ inverse * scale)
