"""What a run tells Foxglove, and how often: fields, health and scene of cycles, lines, poses and changes of status."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

from goldfield.foxglove.messages import log_message, pose_messages, times
from goldfield.foxglove.scene import pose_scene, scene
from goldfield.foxglove.topics import COVARIANCE, FIELDS, HEALTH, LINE, LOG, PARAMETERS, POSE, SCENE, TRANSFORMS
from goldfield.nodes.roster import Roster
from goldfield.sensor.pipeline import Epoch
from goldfield.site import Site
from goldfield.types import Pose
from goldfield.view.boards import parameters_record
from goldfield.view.lines import Line, line_record
from goldfield.view.monitor import Monitor
from goldfield.view.records import fields_record

HEALTH_EVERY_S = 1.0
"""Time from one message of health, and scene of the coils, to the next, by the measurements, s."""
ELLIPSOID_EVERY_S = 0.05
"""Time from one ellipsoid in the scene to the next, s: no eye follows 330 a second."""


class Log(Protocol):
    """Takes a message on a topic, as `Channels.log`."""

    def __call__(self, topic: str, message: Any, arrived_s: float, /) -> None:
        """Take it."""
        ...


class Telling:
    """Makes the messages of one run, in the order in which things happened, for a recording or a server.

    Parameters
    ----------
    site : Site
    name : str
        The link or the recording, as the health names it.
    roster : Roster
        The boards that were heard.
    log : callable
        Takes the messages.
    wanted : callable, optional
        Tells whether anybody gets what is logged on one of some topics; None: always.
    """

    def __init__(
        self, site: Site, name: str, roster: Roster, log: Log, wanted: Callable[..., bool] | None = None
    ) -> None:
        self._site, self._roster = site, roster
        self._log = log
        self._wanted = _always if wanted is None else wanted
        self._monitor = Monitor(site, name, roster)
        self._healthy_s = self._drawn_s = -math.inf
        self._said = ""

    def begin(self, now_s: float) -> None:
        """Tell where the coils are, before anything else."""
        self._log(SCENE, scene(self._site, now_s), now_s)

    def epoch(self, epoch: Epoch, unix_s: float, now_s: float) -> None:
        """Tell the fields of a cycle, and now and then the health of the boards.

        Parameters
        ----------
        epoch : Epoch
        unix_s : float
            When it was measured, by the wall clock; NaN if nothing tells it: its messages then have the time `now_s`.
        now_s : float
            When its messages are logged.
        """
        measured_s = unix_s if math.isfinite(unix_s) else now_s
        if self._wanted(FIELDS):
            self._log(FIELDS, fields_record(epoch.fields, unix_s), now_s)
        self._monitor.add(epoch)
        if abs(measured_s - self._healthy_s) < HEALTH_EVERY_S:  # a clock may be set back
            return
        self._healthy_s = measured_s
        health = self._monitor.record()
        self._log(HEALTH, health, now_s)
        if self._roster.nodes:
            self._log(PARAMETERS, parameters_record(self._roster), now_s)
        self._log(SCENE, scene(self._site, measured_s, health), now_s)

    def line(self, line: Line, unix_s: float, now_s: float, known_s: float) -> None:
        """Tell a pose, with the line of ``run --json`` that it is.

        Parameters
        ----------
        line : Line
        unix_s, now_s : float
            As for `epoch`.
        known_s : float
            When the pose was known, of which its latency is told; NaN if nobody can tell.
        """
        if self._wanted(LINE):
            self._log(LINE, line_record(line) | times(unix_s, known_s), now_s)
        measured_s = unix_s if math.isfinite(unix_s) else now_s
        if self._wanted(POSE, COVARIANCE, TRANSFORMS):
            for topic, message in pose_messages(line.pose, measured_s):
                self._log(topic, message, now_s)
        self._draw(line.pose, measured_s, now_s)
        said = f"{line.pose.status.value}: {line.pose.reason}"
        if said != self._said:
            self._said = said
            self._log(LOG, log_message(line.pose, measured_s), now_s)

    def _draw(self, pose: Pose, unix_s: float, now_s: float) -> None:
        if not self._wanted(SCENE) or abs(unix_s - self._drawn_s) < ELLIPSOID_EVERY_S:
            return
        drawn = pose_scene(pose, unix_s)
        if drawn is not None:
            self._drawn_s = unix_s
            self._log(SCENE, drawn, now_s)


def _always(*_topics: str) -> bool:
    return True
