"""From the fields of an epoch to its pose, by the method that was chosen; a defect costs the epoch, not the run."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from goldfield.errors import tell
from goldfield.link.reports import Report
from goldfield.locate import locate
from goldfield.sensor.dialogue import Parameters
from goldfield.sensor.guard import guarded
from goldfield.sensor.on_sensor import on_sensor_parameters, on_sensor_pose
from goldfield.sensor.options import Method
from goldfield.site import Site
from goldfield.track import PartsObserver, Tracker, cycle_of_parts
from goldfield.track.continuity import Hemisphere, time_break
from goldfield.track.parts import PARTS, sensor_sends_parts
from goldfield.types import Fields, Pose
from goldfield_protocol.parameters import PARAMETERS

Location = Callable[[Fields, Report | None], Pose]
"""Makes the pose of the next epoch of its fields and, if there is one, the sensor's report that they come from."""


class Succession:
    """Lets the poses of one source follow each other, however they are made.

    Quaternions keep their hemisphere (`goldfield.track.continuity.Hemisphere`). Time that goes back or stands still
    between two epochs is in the reason of the later pose, and the first time it is told on stderr.
    """

    def __init__(self) -> None:
        self._hemisphere = Hemisphere()
        self._time_s = -math.inf
        self._told = False

    def follow(self, pose: Pose) -> Pose:
        """Return the next pose of the source as it follows those before."""
        broken = time_break(self._time_s, pose.time_s)
        if math.isfinite(pose.time_s):
            self._time_s = pose.time_s
        if broken is not None:
            if not self._told:
                tell(f"epoch {pose.epoch}: {broken}: the epochs from here on are a new group")
                self._told = True
            if pose.reason is None:
                pose = replace(pose, reason=f"{broken}: a new group of epochs begins")
        return self._hemisphere.follow(pose)


def location(site: Site, method: Method) -> Location:
    """Return what makes the poses of one sensor, each following the one before (`Succession`).

    Parameters
    ----------
    site : Site
    method : Method
        With ``TRACK`` the epochs should come in the order of time, which else starts a new track; with ``ON_SENSOR``
        each must come with its report.
    """
    located, succession = _located(site, method), Succession()
    return lambda fields, report: succession.follow(located(fields, report))


def _located(site: Site, method: Method) -> Location:
    if method is Method.ON_SENSOR:
        return lambda fields, report: _passed_on(site, fields, report)
    if method is Method.EACH:
        return lambda fields, _: guarded(lambda epoch: locate(site, epoch), fields)
    tracker = Tracker(site, PartsObserver(site))

    def track(fields: Fields, report: Report | None) -> Pose:
        parts = None if report is None else cycle_of_parts(site, report, fields.time_s)
        return guarded(lambda _: tracker.update(fields if parts is None else parts), fields)

    return track


def needed_parameters(site: Site, method: Method) -> Parameters:
    """Return the parameters, by id, that a live sensor must have for a method, beside the codes of the site."""
    if method is Method.ON_SENSOR:
        return on_sensor_parameters(site)
    return {PARAMETERS["parts"].first: PARTS} if method is Method.TRACK and sensor_sends_parts(site) else {}


def _passed_on(site: Site, fields: Fields, report: Report | None) -> Pose:
    if report is None:
        raise ValueError("a pose of the sensor itself comes with a report")
    return on_sensor_pose(site, report, fields)
