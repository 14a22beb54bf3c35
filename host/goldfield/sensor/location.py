"""From the fields of an epoch to its pose, by the method that was chosen; a defect costs the epoch, not the run."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from goldfield.errors import UserError, tell
from goldfield.link.reports import Report
from goldfield.locate import locate
from goldfield.sensor.confirmation import Confirmation
from goldfield.sensor.dialogue import Parameters
from goldfield.sensor.guard import guarded
from goldfield.sensor.on_sensor import on_sensor_parameters, on_sensor_pose
from goldfield.sensor.options import Method, Options
from goldfield.sensor.pose_rate import blocks_a_pose
from goldfield.sensor.stopping import Stopping
from goldfield.site import Site
from goldfield.track import EpochObserver, Tracker, Witness
from goldfield.track.continuity import Hemisphere, joined, time_break
from goldfield.track.estimate import Belief
from goldfield.track.faults import Judgement, judged
from goldfield.track.motion import RATE, standing
from goldfield.types import Fields, Finding, Pose, Status

UNKNOWN_MOTION = np.repeat([1.0, 1.0, 1.0, 1.0, 1e-4], 3)
"""Standard deviations of pose, velocity (m/s), turn rate (rad/s) and ambient field with which an epoch that is located
by itself is judged."""

Location = Callable[[Fields, Report | None], Pose]
"""Makes the pose of the next epoch of its fields and, if there is one, the sensor's report that they come from."""


class Succession:
    """Lets the poses of one source follow each other, however they are made.

    Quaternions keep their hemisphere (`goldfield.track.continuity.Hemisphere`). Time that goes back between two
    epochs is in the reason of the later pose, and the first time it is told on stderr; time that stands still is none
    of its business, since a table of poses that were taken one by one may have the same in each.
    """

    def __init__(self) -> None:
        self._hemisphere = Hemisphere()
        self._time_s = -math.inf
        self._told = False

    def follow(self, pose: Pose) -> Pose:
        """Return the next pose of the source as it follows those before."""
        broken = time_break(self._time_s, pose.time_s) if pose.time_s < self._time_s else None
        if math.isfinite(pose.time_s):
            self._time_s = pose.time_s
        if broken is not None:
            if not self._told:
                tell(f"epoch {pose.epoch}: {broken}: the epochs from here on are a new group")
                self._told = True
            if pose.reason is None:
                pose = replace(pose, reason=f"{broken}: a new group of epochs begins")
        return self._hemisphere.follow(pose)

    def nearest(self, pose: Pose) -> Pose:
        """Return a pose that is none of the source's with the sign that follows its latest one."""
        return self._hemisphere.nearest(pose)


def location(site: Site, method: Method, succession: Succession | None = None) -> Location:
    """Return what makes the poses of one sensor, each following the one before (`Succession`).

    Parameters
    ----------
    site : Site
    succession : Succession, optional
        That of a source which has other poses, too.
    method : Method
        With ``TRACK`` the epochs should come in the order of time, which else starts a new track; with ``ON_SENSOR``
        each must come with its report.
    """
    located, follows = _located(site, method), succession or Succession()
    return lambda fields, report: follows.follow(located(fields, report))


def _located(site: Site, method: Method) -> Location:
    if method is Method.ON_SENSOR:
        return lambda fields, report: _passed_on(site, fields, report)
    if method is Method.EACH:
        each = Each(site)
        return lambda fields, _: guarded(each.pose, fields)
    tracker, witness = Tracker(site), Witness(site)

    def tracked(fields: Fields) -> Pose:
        step = tracker.step(fields, witness.named)
        return with_finding(step.pose, witness.update(step.judgement))

    return lambda fields, _: guarded(tracked, fields)


class Each:
    """Locates every epoch by itself, but for a beacon that the history of the residuals names: it is left out.

    The cycle in which a coil goes off is told by the one before (`goldfield.sensor.stopping`).
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._witness = Witness(site)
        self._stopping = Stopping(site)
        self._confirmation = Confirmation()
        self._observer = EpochObserver(site)

    def pose(self, fields: Fields, ready: Pose | None = None) -> Pose:
        """Return the next pose; ``ready``, if given, is what `locate` makes of the epoch."""
        if self._site.sensor.lever_m is not None:
            # The history takes all axes to be at one point: it would blame beacons.
            return ready or locate(self._site, fields)
        named = self._witness.named
        heard = without(fields, named)
        pose = ready if ready is not None and not named else locate(self._site, heard)
        pose = self._confirmation.follow(self._stopping.follow(heard, pose))
        judgement = None
        if pose.status not in (Status.FAILED, Status.AMBIGUOUS) and all(finding.beacons for finding in pose.findings):
            pose = replace(pose, excluded=(*pose.excluded, *(name for name in named if name in fields.beacons)))
            judgement = self._judged(fields, pose)
        return with_finding(pose, self._witness.update(judgement))

    def _judged(self, fields: Fields, pose: Pose) -> Judgement | None:
        state = standing(pose.position_m, pose.orientation_xyzw)
        try:
            observation, _ = self._observer.observation(fields, UNKNOWN_MOTION[RATE].max())
        except UserError:  # codes that only another receiver can tell apart: a table of fields needs no such thing
            return None
        return judged(observation, state, Belief(state, np.diag(UNKNOWN_MOTION)))


def without(fields: Fields, beacons: Sequence[str]) -> Fields:
    """Return the fields of an epoch without some beacons."""
    if not beacons:
        return fields
    kept = [place for place, name in enumerate(fields.beacons) if name not in beacons]
    names = tuple(fields.beacons[place] for place in kept)
    return replace(fields, beacons=names, field_T=fields.field_T[kept], sigma_T=fields.sigma_T[kept])


def with_finding(pose: Pose, finding: Finding | None) -> Pose:
    """Return a pose with what the history knows; one that rests on the beacon that it names is inconsistent."""
    if finding is None or pose.status is Status.FAILED:
        return pose
    doubted = set(finding.beacons) & set(pose.used) and pose.status in (Status.OK, Status.UNVERIFIED, Status.WEAK)
    return replace(
        pose,
        status=Status.INCONSISTENT if doubted else pose.status,
        reason=joined(finding.text, pose.reason),
        findings=(finding, *pose.findings),
    )


def needed_parameters(site: Site, options: Options, *, blocks: Parameters) -> Parameters:
    """Return the parameters, by id, that a live sensor must have for what the options ask, beside the site's codes.

    Parameters
    ----------
    site : Site
    options : Options
    blocks : mapping of int to int
        What it must have to send blocks of chips on the link that is read; empty if none are read.
    """
    if options.method is Method.ON_SENSOR:
        if options.rate_hz is None:
            return on_sensor_parameters(site)
        return on_sensor_parameters(site, blocks_a_pose(site, options.rate_hz))
    return blocks


def _passed_on(site: Site, fields: Fields, report: Report | None) -> Pose:
    if report is None:
        raise ValueError("a pose of the sensor itself comes with a report")
    return on_sensor_pose(site, report, fields)
