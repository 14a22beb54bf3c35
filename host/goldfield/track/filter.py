"""Tracking: an iterated error-state Kalman filter on position, attitude and their velocities.

The sensor moves with white acceleration and white angular acceleration (Gietler, Ammari & Zangl: integrated random
walk). A track starts where `locate` puts the sensor, with wide uncertainty, and starts again after a gap or when
epochs keep contradicting it. Every time tag is the middle of a cycle; `Tracker.pose_at` gives the pose at any other
time, now too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Generic, overload

import numpy as np

from goldfield.site import Site
from goldfield.track.estimate import SEARCH_TOLERANCE, TOLERANCE, Belief, Estimate, estimate
from goldfield.track.motion import RATE, Agility
from goldfield.track.observe import EpochObserver, Observer, T
from goldfield.track.report import Reporter
from goldfield.types import Fields, FloatArray, Pose, Status

EVALUATIONS = 8
"""Bound of the field model's evaluations in an update: eight are enough where a plain filter fails (maths.md, 6)."""

GATE = 1e-5
"""An epoch less likely than this contradicts the track, or one of its beacons is at fault."""

GAP_S = 1.0
"""The track is given up after this time without an epoch that agrees."""

PATIENCE = 3
"""The track is given up at this many epochs in a row that contradict it."""

START = np.repeat([1.0, 1.0, 2.0, 2.0, 1e-4], 3)
"""Standard deviations of position (m), attitude, velocity, turn rate and ambient field around the located pose with
which the first epoch of a track is fitted."""

START_EVALUATIONS = 30
START_FACTOR = 2.0
"""The first pose's deviations are doubled: at ill-conditioned points Gauss-Newton is overconfident (maths.md, 3)."""


Fused = tuple[Estimate, tuple[str, ...], tuple[str, ...]]
"""An update, the beacons in it, and those left out."""


@dataclass(frozen=True, eq=False)
class Step:
    """What the filter did with one epoch.

    Attributes
    ----------
    pose : Pose
        The pose after the epoch.
    belief : Belief or None
        The belief after the epoch; None if there is no track.
    predicted : Belief or None
        The belief before the epoch's measurements; None where a track starts or there is none.
    transition : ndarray, shape (15, 15), or None
        Transition from the previous step's errors to those of ``predicted``.
    """

    pose: Pose
    belief: Belief | None
    predicted: Belief | None = None
    transition: FloatArray | None = None


class Tracker(Generic[T]):
    """Tracks one sensor: give it every epoch in the order of time, it returns a pose of that epoch and those before.

    Parameters
    ----------
    site : Site
    observer : Observer, optional
        Makes observations of the data: `EpochObserver`, the default, of `Fields`; `CycleObserver` of `CycleData`.
    agility : Agility, optional
        How the sensor may move; by default as a person or a robot does.

    Raises
    ------
    UserError
        If the beacons of the site cannot be told apart.

    Examples
    --------
    In ``docs/examples``:

    >>> import goldfield
    >>> site = goldfield.load_site("room.toml")
    >>> tracker = goldfield.Tracker(site)
    >>> poses = [tracker.update(fields) for fields in goldfield.read_fields(site, "fields.csv")]
    >>> poses[-1].status.value, poses[-1].position_m.round(1)
    ('ok', array([0.9, 1.2, 0.8]))
    """

    @overload
    def __init__(self: Tracker[Fields], site: Site, *, agility: Agility | None = None) -> None: ...

    @overload
    def __init__(self, site: Site, observer: Observer[T], agility: Agility | None = None) -> None: ...

    def __init__(self, site: Site, observer: Observer[Any] | None = None, agility: Agility | None = None) -> None:
        self._site = site
        self._observer: Observer[Any] = EpochObserver(site) if observer is None else observer
        self._agility = Agility() if agility is None else agility
        self._reporter = Reporter(site)
        self._belief: Belief | None = None
        self._time_s = self._agreed_s = -np.inf
        self._contradictions = 0
        self._axes = 3

    def update(self, data: T) -> Pose:
        """Take a cycle's data and return the pose at its middle.

        Where a track cannot be started the pose and status are those of `locate`. While there is one:

        - ``ok``: the data agree; ``excluded`` lists the beacon that had to be left out for that.
        - ``weak``: they agree, or there are none, but the standard deviation is as large as `locate` calls weak.
        - ``inconsistent``: they contradict the track; the pose is predicted and uses no beacon.
        """
        return self.step(data).pose

    def step(self, data: T) -> Step:
        """Do what `update` does and return all that a smoother needs."""
        seconds = data.time_s - self._time_s
        if self._belief is None or not seconds > 0.0 or not data.time_s - self._agreed_s <= GAP_S:
            return self._start(data)
        predicted = self._belief.after(seconds, self._agility)
        transition = self._belief.state.transition(seconds)
        self._time_s = data.time_s
        found = self._fuse(predicted, data)
        if found is None:
            self._contradictions += 1
            if self._contradictions >= PATIENCE:
                return self._start(data)
            self._belief = predicted
            pose = self._reporter.pose(
                data.epoch,
                data.time_s,
                predicted,
                status=Status.INCONSISTENT,
                excluded=data.beacons,
            )
            return Step(pose, predicted, predicted, transition)
        outcome, used, _ = found
        if used:
            self._contradictions = 0
            self._agreed_s = data.time_s
        self._belief = outcome.belief
        return Step(self._pose(data, outcome.belief, found), outcome.belief, predicted, transition)

    def pose_at(self, time_s: float) -> Pose | None:
        """Return the pose at any time, with the uncertainty that the motion adds; None without a track.

        Meant for the time between cycles and for now: the data of a cycle arrive half a cycle after its time tag or
        later. The pose carries epoch -1, uses no beacon, and its residual is NaN.
        """
        if self._belief is None:
            return None
        belief = self._belief.after(time_s - self._time_s, self._agility)
        return self._reporter.pose(-1, time_s, belief, axes=self._axes)

    def _start(self, data: T) -> Step:
        """Begin a track where `locate` puts the sensor; without one, pass on what `locate` says."""
        self._belief = None
        located, state = self._observer.start(data)
        if state is None or not np.isfinite(data.time_s):
            return Step(located, None)
        found = self._fuse(Belief(state, np.diag(START)), data, START_EVALUATIONS, SEARCH_TOLERANCE)
        if found is None:
            return Step(located, None)
        covariance = np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = located.position_cov_m2, located.attitude_cov_rad2
        self._belief = found[0].belief.widened(covariance, START_FACTOR)
        self._time_s = self._agreed_s = data.time_s
        self._contradictions = 0
        return Step(self._pose(data, self._belief, found), self._belief)

    def _fuse(
        self, prior: Belief, data: T, evaluations: int = EVALUATIONS, tolerance: float = TOLERANCE
    ) -> Fused | None:
        """Update with the data, or with all of them but one beacon's if only that agrees; None if nothing does."""
        rates = prior.root[RATE]
        rate = float(np.sqrt(prior.state.rate_rad_s @ prior.state.rate_rad_s + (rates * rates).sum()))
        observation, heard = self._observer.observation(data, rate)
        self._axes = int(observation.seen.any(axis=(1, 2)).sum())
        whole = estimate(prior, observation, evaluations, tolerance)
        if self._agrees(whole):
            return whole, heard, ()
        best: Fused | None = None
        for suspect in heard if len(heard) > 1 else ():
            part, rest = self._observer.observation(data, rate, without=(suspect,))
            trial = estimate(prior, part, evaluations, tolerance)
            if self._agrees(trial) and (best is None or trial.cost < best[0].cost):
                best = trial, rest, (suspect,)
        return best

    def _agrees(self, outcome: Estimate) -> bool:
        side = self._site.half_space
        inside = side is None or side.contains(outcome.belief.state.position_m)
        return inside and outcome.probable(GATE)

    def _pose(self, data: T, belief: Belief, found: Fused) -> Pose:
        outcome, used, excluded = found
        return self._reporter.pose(
            data.epoch,
            data.time_s,
            belief,
            residual=float(np.sqrt(outcome.cost / outcome.count)) if outcome.count else float("nan"),
            used=used,
            excluded=excluded,
            axes=self._axes,
        )
