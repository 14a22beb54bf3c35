"""What a run makes, recorded as MCAP: messages as they came, poses, fields, scene and health; docs/recordings.md."""

from __future__ import annotations

import math
import time
from pathlib import Path

import can

from goldfield.foxglove.telling import Telling
from goldfield.foxglove.topics import CAN
from goldfield.link.ros_frame import packed
from goldfield.nodes.roster import Roster
from goldfield.recording.about import ABOUT, SITE_FILE, About
from goldfield.recording.mcap_file import McapFile
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.view.lines import Lines
from goldfield.view.unix_time import LiveUnixTime, UnixTime
from goldfield_protocol.messages import Identifier, database

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
        self._clock = (LiveUnixTime if about.live else UnixTime)(about.site.cycle_s)
        self._lines = Lines()
        self._roster = Roster()
        self._telling = Telling(about.site, about.source, self._roster, self._file.log)
        self._arrived_s = 0.0

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
        if isinstance(item, Epoch):
            self._telling.epoch(item, unix_s, self._arrived_s)
        line = self._lines.take(item)
        if line is not None:
            known_s = time.time() if self._about.live else self._arrived_s
            self._telling.line(line, unix_s, self._arrived_s, known_s)

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
        self._telling.begin(now_s)
