"""What a run makes, recorded as MCAP: messages as they came, poses, fields, scene and health; docs/recordings.md."""

from __future__ import annotations

import math
import time
from pathlib import Path

import can

from goldfield.foxglove.messages import log_message, pose_messages, times
from goldfield.foxglove.scene import pose_scene, scene
from goldfield.foxglove.topics import CAN, FIELDS, HEALTH, LINE, LOG, PARAMETERS, SCENE
from goldfield.link.ros_frame import packed
from goldfield.nodes.roster import Roster
from goldfield.recording.about import ABOUT, SITE_FILE, About
from goldfield.recording.mcap_file import McapFile
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.types import Pose
from goldfield.view.boards import parameters_record
from goldfield.view.lines import Line, Lines, line_record
from goldfield.view.monitor import Monitor
from goldfield.view.records import fields_record
from goldfield.view.unix_time import UnixTime
from goldfield_protocol.messages import Identifier, database

HEALTH_EVERY_S = 1.0
"""Time of the sensor from one message of health to the next, s."""
ELLIPSOID_EVERY_S = 0.05
"""Time from one ellipsoid in the scene to the next, s: no eye follows 330 a second."""

MEASUREMENTS = ("EPOCH", "EPOCH_OFFSET", "FIELD", "BLOCK", "BLOCK_SUM", "CHIP")
"""Messages, thousands a second, that say nothing of the boards."""
_MEASURED = {Identifier.unpack(database().get_message_by_name(name).frame_id).type for name in MEASUREMENTS}


class McapRecording:
    """A sink of messages, as they come, and of what they make, in the order in which it happened.

    Parameters
    ----------
    path, force
        As for `McapFile`, with its errors.
    about : About
    """

    def __init__(self, path: str | Path, about: About, *, force: bool = False) -> None:
        self._file = McapFile(path, force=force)
        self._about = about
        self._site_file = about.site_bytes()
        self._begun = False
        self._clock = UnixTime(about.site.cycle_s)
        self._lines = Lines()
        self._roster = Roster()
        self._monitor = Monitor(about.site, about.source, self._roster)
        self._arrived_s = 0.0
        self._healthy_s = self._drawn_s = -math.inf
        self._said = ""

    @property
    def failed(self) -> bool:
        """Whether the recording is not whole."""
        return self._file.failed

    def write(self, item: can.Message | Epoch | Fix) -> None:
        """Append a message, or what the messages before it made; `BrokenPipeError` if nobody reads stdout any more."""
        if isinstance(item, can.Message):
            self._begin(item.timestamp)
            self._file.log(CAN, packed(item), item.timestamp)
            self._arrived_s = item.timestamp
            if Identifier.unpack(item.arbitration_id).type not in _MEASURED:
                self._roster.take(item, item.timestamp)
            return
        self._begin(self._arrived_s)
        if math.isfinite(item.arrived_s):
            self._arrived_s = item.arrived_s
        unix_s = self._clock.unix_s(item)
        unix_s = unix_s if math.isfinite(unix_s) else self._arrived_s
        if isinstance(item, Epoch):
            self._write_epoch(item, unix_s)
        line = self._lines.take(item)
        if line is not None:
            self._write_line(line, unix_s)

    def close(self) -> None:
        """End the recording."""
        self._file.close()

    def _begin(self, now_s: float) -> None:
        """Tell of the run and the site, before the first message."""
        if self._begun:
            return
        self._begun = True
        self._file.metadata(ABOUT, self._about.metadata(self._site_file))
        if self._site_file is not None:
            self._file.attach(SITE_FILE, "application/toml", self._site_file, now_s)
        self._file.log(SCENE, scene(self._about.site, now_s), now_s)

    def _write_epoch(self, epoch: Epoch, unix_s: float) -> None:
        self._file.log(FIELDS, fields_record(epoch.fields, unix_s), self._arrived_s)
        self._monitor.add(epoch)
        if 0.0 <= epoch.pose.time_s - self._healthy_s < HEALTH_EVERY_S:
            return
        self._healthy_s = epoch.pose.time_s
        health = self._monitor.record()
        self._file.log(HEALTH, health, self._arrived_s)
        self._file.log(PARAMETERS, parameters_record(self._roster), self._arrived_s)
        self._file.log(SCENE, scene(self._about.site, self._arrived_s, health), self._arrived_s)

    def _write_line(self, line: Line, unix_s: float) -> None:
        now_s = time.time() if self._about.live else self._arrived_s
        self._file.log(LINE, line_record(line) | times(unix_s, now_s), self._arrived_s)
        for topic, message in pose_messages(line.pose, unix_s):
            self._file.log(topic, message, self._arrived_s)
        self._draw(line.pose, unix_s)
        said = f"{line.pose.status.value}: {line.pose.reason}"
        if said != self._said:
            self._said = said
            self._file.log(LOG, log_message(line.pose, unix_s), self._arrived_s)

    def _draw(self, pose: Pose, unix_s: float) -> None:
        if 0.0 <= unix_s - self._drawn_s < ELLIPSOID_EVERY_S:
            return
        drawn = pose_scene(pose, unix_s)
        if drawn is not None:
            self._drawn_s = unix_s
            self._file.log(SCENE, drawn, self._arrived_s)
