"""Tracking: an iterated error-state Kalman filter on position, attitude and their velocities.

The sensor moves with white acceleration and white angular acceleration (Gietler, Ammari & Zangl: integrated random
walk). A track starts where `locate` puts the sensor, with wide uncertainty, and starts again after a gap or when
epochs keep contradicting it. Every time tag is the middle of a cycle; `Tracker.pose_at` gives the pose at any other
time, now too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Generic, overload

import numpy as np

from goldfield.locate.chances import chdtri, gammaincc
from goldfield.site import Site
from goldfield.track.continuity import Hemisphere, joined, time_break
from goldfield.track.estimate import SEARCH_TOLERANCE, TOLERANCE, Belief, Estimate, estimate
from goldfield.track.faults import Judgement, judged
from goldfield.track.motion import RATE, Agility, Observation, standing
from goldfield.track.observe import EpochObserver, Observer, T, check_levers
from goldfield.track.report import Reporter
from goldfield.types import Explanation, Fields, Finding, FloatArray, Pose, Status

EVALUATIONS = 8
"""Bound of the field model's evaluations in an update: eight are enough where a plain filter fails (maths.md, 6)."""

GATE = 1e-5
"""An epoch less likely than this contradicts the track, or one of its beacons is at fault."""

BLAME = 1e-6
"""A beacon is left out only if a cost as large as it takes away is less likely than this."""

CLEAR = 25.0
"""The pose without it is ``ok`` only if leaving out any other beacon costs more by this."""

SILENCE = 1e-5
"""Fields that noise alone exceeds with this probability say nothing: no beacon was heard."""

GAP_S = 1.0
"""The track is given up after this time without an epoch that agrees."""

PATIENCE = 3
"""The track is given up at this many epochs in a row that contradict it; at the first after a gap."""

START = np.repeat([1.0, 1.0, 2.0, 2.0, 1e-4], 3)
"""Standard deviations of position (m), attitude, velocity, turn rate and ambient field around the located pose with
which the first epoch of a track is fitted."""

START_EVALUATIONS = 30
START_FACTOR = 2.0
"""The first pose's deviations are doubled: at ill-conditioned points Gauss-Newton is overconfident (maths.md, 3)."""


@dataclass(frozen=True, eq=False)
class Fused:
    """An update of the track with an epoch, and whether the epoch agrees with the site.

    Attributes
    ----------
    outcome : Estimate
    used, excluded : tuple of str
        The beacons in it, and those left out.
    judgement : Judgement
        What the epoch says of the beacons that are in it.
    whole : Judgement
        What it says of all its beacons, at the same state.
    doubt : str or None
        Why the epoch does not agree with the site all the same.
    findings : tuple of Finding
    """

    outcome: Estimate
    used: tuple[str, ...]
    excluded: tuple[str, ...]
    judgement: Judgement
    whole: Judgement
    doubt: str | None = None
    findings: tuple[Finding, ...] = ()


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
    judgement : Judgement or None
        What the epoch says of each beacon at the pose; None if it was not used.
    """

    pose: Pose
    belief: Belief | None
    predicted: Belief | None = None
    transition: FloatArray | None = None
    judgement: Judgement | None = None


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
        If the beacons of the site cannot be told apart, or the sensor's axes are not at one point.

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
        check_levers(site)
        self._site = site
        self._observer: Observer[Any] = EpochObserver(site) if observer is None else observer
        self._agility = Agility() if agility is None else agility
        self._reporter = Reporter(site)
        self._hemisphere = Hemisphere()
        self._belief: Belief | None = None
        self._last: Fused | None = None
        self._time_s = self._agreed_s = self._heard_s = -math.inf
        self._contradictions = 0
        self._axes = 3

    def update(self, data: T, without: tuple[str, ...] = ()) -> Pose:
        """Take a cycle's data and return the pose at its middle.

        Where a track cannot be started the pose and status are those of `locate`. While there is one:

        - ``ok``: the data agree with the track and the site; ``excluded`` lists the beacon that had to be left out.
        - ``unverified``: they agree, but a fault of one beacon could hide an error above the site's alert limit.
        - ``weak``: the standard deviation is as large as `locate` calls weak, or no beacon has been heard for a while:
          the pose is then predicted, and after `GAP_S` the status is ``failed``.
        - ``inconsistent``: the data contradict the track (the pose is predicted and uses no beacon) or the site.

        Time that goes back, or stands still, starts a new track, which the pose's ``reason`` tells. An epoch without a
        time is located by itself and leaves the track as it is. ``without`` lists beacons that are left out.
        """
        return self.step(data, without).pose

    def step(self, data: T, without: tuple[str, ...] = ()) -> Step:
        """Do what `update` does and return all that a smoother needs."""
        if math.isfinite(data.time_s):
            broken = time_break(self._time_s, data.time_s)
            if broken is not None:
                self._belief, self._heard_s = None, -math.inf
                broken += ": a new track begins"
            known = self._belief is not None and data.time_s - self._agreed_s <= GAP_S
            step = self._go_on(data, without) if known else self._start(data, without)
            self._time_s = data.time_s
        else:
            step = Step(self._observer.start(data)[0], None)
            broken = "the time of the epoch is not known: it is no part of the track"
        pose = self._hemisphere.follow(step.pose)
        if broken is not None:
            pose = replace(pose, reason=joined(pose.reason, broken))
        return step if pose is step.pose else replace(step, pose=pose)

    def pose_at(self, time_s: float) -> Pose | None:
        """Return the pose at any time, with the uncertainty that the motion adds; None without a track.

        Meant for the time between cycles and for now: the data of a cycle arrive half a cycle after its time tag or
        later. The pose carries epoch -1, uses no beacon, and its residual is NaN. It is worth no more than that of the
        last cycle.
        """
        if self._belief is None:
            return None
        belief = self._belief.after(time_s - self._time_s, self._agility)
        last = self._last
        pose = self._reporter.pose(
            -1,
            time_s,
            belief,
            status=Status.OK if last is not None and last.doubt is None else Status.INCONSISTENT,
            axes=self._axes,
            reason="the last epoch contradicts the track" if last is None else last.doubt,
            protection_m=math.inf if last is None else last.judgement.protection_m(belief.covariance[:3, :3]),
        )
        return self._hemisphere.nearest(pose)

    def _go_on(self, data: T, without: tuple[str, ...]) -> Step:
        """Follow the track to the next epoch."""
        assert self._belief is not None
        seconds = data.time_s - self._time_s
        bridged = self._time_s > self._agreed_s and not self._contradictions
        transition = self._belief.state.transition(seconds)
        predicted = self._belief.after(seconds, self._agility, transition)
        told = self._observation(data, predicted)
        if self._silent(told[0]):
            return self._without_fields(data, predicted, transition, Status.WEAK, self._silence(data.time_s))
        self._heard_s = data.time_s
        found = self._fuse(predicted, data, told, without)
        self._last = found
        if found is None:
            self._contradictions += 1
            if bridged or self._contradictions >= PATIENCE:
                return self._start(data, without)
            reason = "the fields contradict the track: the pose is predicted from the epochs before"
            return self._without_fields(data, predicted, transition, Status.INCONSISTENT, reason)
        self._contradictions = 0
        self._agreed_s = data.time_s
        self._belief = found.outcome.belief
        return Step(self._pose(data, self._belief, found), self._belief, predicted, transition, found.whole)

    def _without_fields(self, data: T, predicted: Belief, transition: FloatArray, status: Status, reason: str) -> Step:
        """Go on with what was predicted: nothing of this epoch's fields is used."""
        self._belief = predicted
        pose = self._reporter.pose(
            data.epoch, data.time_s, predicted, status=status, excluded=data.beacons, reason=reason
        )
        return Step(pose, predicted, predicted, transition)

    def _start(self, data: T, without: tuple[str, ...]) -> Step:
        """Begin a track where `locate` puts the sensor; without one, pass on what `locate` says."""
        self._belief = None
        vague = Belief(standing(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])), np.diag(START))
        if self._silent(self._observation(data, vague)[0]):
            nothing = Fields(data.epoch, data.time_s, (), np.empty((0, 3)), np.empty(0))
            return Step(Pose.failed(nothing, excluded=data.beacons, reason=self._silence(data.time_s)), None)
        self._heard_s = data.time_s
        located, state = self._observer.start(data)
        if state is None:
            return Step(located, None)
        prior = Belief(state, np.diag(START))
        told = self._observation(data, prior)
        found = self._fuse(prior, data, told, without, START_EVALUATIONS, SEARCH_TOLERANCE)
        if found is None:
            return Step(located, None)
        covariance = np.zeros((6, 6))
        covariance[:3, :3], covariance[3:, 3:] = located.position_cov_m2, located.attitude_cov_rad2
        self._belief = found.outcome.belief.widened(covariance, START_FACTOR)
        self._last = found
        self._agreed_s = data.time_s
        self._contradictions = 0
        return Step(self._pose(data, self._belief, found), self._belief, judgement=found.whole)

    def _observation(
        self, data: T, prior: Belief, without: tuple[str, ...] = ()
    ) -> tuple[Observation, tuple[str, ...]]:
        rates = prior.root[RATE]
        rate = float(np.sqrt(prior.state.rate_rad_s @ prior.state.rate_rad_s + (rates * rates).sum()))
        return self._observer.observation(data, rate, without)

    def _silent(self, observation: Observation) -> bool:
        """Tell whether an epoch holds nothing but noise."""
        return not observation.count or observation.strength() <= float(chdtri(observation.count, SILENCE))

    def _silence(self, time_s: float) -> str:
        if not math.isfinite(self._heard_s):
            return "no beacon has been heard"
        return f"no beacon has been heard for {time_s - self._heard_s:.1f} s"

    def _fuse(
        self,
        prior: Belief,
        data: T,
        told: tuple[Observation, tuple[str, ...]],
        without: tuple[str, ...],
        evaluations: int = EVALUATIONS,
        tolerance: float = TOLERANCE,
    ) -> Fused | None:
        """Update with the data, or with all of them but one beacon's if only that agrees; None if nothing does.

        ``told`` is what all of the data tell, and the beacons in it.
        """
        everything, heard = told
        everything = everything.around(prior.state)
        observation = everything
        if without:
            observation, heard = self._observation(data, prior, without)
        self._axes = int(observation.seen.any(axis=(1, 2)).sum())
        whole = estimate(prior, observation, evaluations, tolerance)
        agrees = self._agrees(whole)
        if agrees:
            judgement = judged(observation, whole.belief.state, prior)
            history = judged(everything, whole.belief.state, prior) if without else judgement
            plain = Fused(whole, heard, without, judgement, history)
            if not judgement.alarm:
                return plain
        costs: list[float] = []
        best: Fused | None = None
        for suspect in heard if len(heard) > 1 else ():
            part, rest = self._observation(data, prior, (*without, suspect))
            trial = estimate(prior, part, evaluations, tolerance)
            if self._agrees(trial) and (best is None or trial.cost < best.outcome.cost):
                state = trial.belief.state
                left_out = (*without, suspect)
                best = Fused(trial, rest, left_out, judged(part, state, prior), judged(everything, state, prior))
            costs.append(trial.cost)
        if best is not None and len(heard) * gammaincc(1.5, (whole.cost - best.outcome.cost) / 2.0) <= BLAME:
            clear = sum(cost < best.outcome.cost + CLEAR for cost in costs) == 1
            return best if clear and not best.judgement.alarm else _doubted(best)
        return _doubted(plain) if agrees else None

    def _agrees(self, outcome: Estimate) -> bool:
        side = self._site.half_space
        inside = side is None or side.contains(outcome.belief.state.position_m)
        return inside and outcome.probable(GATE)

    def _pose(self, data: T, belief: Belief, found: Fused) -> Pose:
        outcome, left_out = found.outcome, found.excluded
        whole = found.whole.residuals if left_out else {}
        residuals = {name: whole[name] for name in left_out if name in whole}
        return self._reporter.pose(
            data.epoch,
            data.time_s,
            belief,
            residual=float(np.sqrt(outcome.cost / outcome.count)) if outcome.count else float("nan"),
            status=Status.OK if found.doubt is None else Status.INCONSISTENT,
            used=found.used,
            excluded=left_out,
            axes=self._axes,
            reason=joined(f"{', '.join(left_out)} left out, not as the site says" if left_out else None, found.doubt),
            protection_m=found.judgement.protection_m(belief.covariance[:3, :3]),
            residuals=found.judgement.residuals | residuals,
            findings=found.findings,
        )


def _doubted(found: Fused) -> Fused:
    """Return an update whose epoch does not agree with the site, with what may be said of that."""
    judgement = found.judgement
    scale, factor = judgement.strength
    if scale > 0.5 * judgement.cost and scale > judgement.drop.max():
        text = f"all fields are {factor:.3g} times as large as the site says: check the sensor and the currents"
        return replace(found, doubt=text, findings=(Finding(Explanation.STRENGTH, (), text, factor=factor),))
    worst = judgement.beacons[int(np.argmax(judgement.drop))]
    return replace(found, doubt=f"the fields do not agree with the site, those of {worst} least")
