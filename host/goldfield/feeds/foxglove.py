"""A server for Foxglove: poses with covariance, transforms, the site's scene, fields and health, live.

The topics are those of a recording in MCAP (`goldfield.foxglove.topics`), but for the messages of the link.
"""

from __future__ import annotations

import math

import foxglove
from foxglove.websocket import WebSocketServer

from goldfield.errors import tell
from goldfield.feeds.address import Address
from goldfield.feeds.feed import Feed, Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.files.inputs import reason_of
from goldfield.foxglove.channels import Channels
from goldfield.foxglove.messages import log_message, pose_messages, times
from goldfield.foxglove.scene import pose_scene, scene
from goldfield.foxglove.topics import COVARIANCE, FIELDS, HEALTH, LINE, LOG, POSE, SCENE, TRANSFORMS
from goldfield.nodes.roster import Roster
from goldfield.sensor.pipeline import Epoch
from goldfield.view.lines import line_record
from goldfield.view.monitor import Monitor
from goldfield.view.records import fields_record

BACKLOG = 512
"""Messages that wait for one consumer; the oldest goes if there is no room."""
HEALTH_EVERY_S = 1.0
"""Time from one message of health, and scene of the coils, to the next, by the stamps, s."""
ELLIPSOID_EVERY_S = 0.05
"""Time from one ellipsoid in the scene to the next, s: no eye follows 330 a second."""


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return a server that listens, and tell where; `UserError` if it cannot."""
    feed = FoxgloveFeed(address, setting)
    tell(f"{address.url}: serves Foxglove at ws://{address.place(feed.port)}")
    return feed


class FoxgloveFeed:
    """Serves poses by the SDK's own threads.

    Parameters
    ----------
    address : Address
        Where it listens.
    setting : Setting

    Attributes
    ----------
    port : int
        The port that it has.

    Raises
    ------
    UserError
        If this machine cannot listen there.
    """

    whole = False
    dropped = 0  # the SDK does not tell what its consumers miss

    def __init__(self, address: Address, setting: Setting) -> None:
        self._site = setting.site
        self._clock = setting.clock
        self._monitor = Monitor(setting.site, address.url, Roster())
        self._healthy_s = self._drawn_s = -math.inf
        self._said = ""
        self._context = foxglove.Context()
        self._channels = Channels(self._context)
        self._server = self._listening(address)
        self.port = self._server.port
        self._channels.log(SCENE, scene(self._site, self._clock()), self._clock())

    def write(self, stamped: StampedPose, /) -> None:
        """Send a pose; what has no time by the wall clock is stamped with that of now."""
        now_s = self._clock()
        unix_s = stamped.unix_s if math.isfinite(stamped.unix_s) else now_s
        if stamped.line.epoch is not None:
            self._write_epoch(stamped.line.epoch, unix_s, now_s)
        if self._channels.wanted(LINE):
            told = times(stamped.unix_s, now_s if stamped.live else math.nan)
            self._channels.log(LINE, line_record(stamped.line) | told, now_s)
        if self._channels.wanted(POSE, COVARIANCE, TRANSFORMS):
            for topic, message in pose_messages(stamped.pose, unix_s):
                self._channels.log(topic, message, now_s)
        self._write_scene(stamped, unix_s, now_s)
        said = f"{stamped.pose.status.value}: {stamped.pose.reason}"
        if said != self._said:
            self._said = said
            self._channels.log(LOG, log_message(stamped.pose, unix_s), now_s)

    def close(self) -> None:
        """End the server."""
        self._server.stop()

    def _write_epoch(self, epoch: Epoch, unix_s: float, now_s: float) -> None:
        if self._channels.wanted(FIELDS):
            self._channels.log(FIELDS, fields_record(epoch.fields, unix_s), now_s)
        self._monitor.add(epoch)
        if abs(unix_s - self._healthy_s) >= HEALTH_EVERY_S:  # a clock may be set back
            self._healthy_s = unix_s
            health = self._monitor.record()
            self._channels.log(HEALTH, health, now_s)
            self._channels.log(SCENE, scene(self._site, unix_s, health), now_s)

    def _write_scene(self, stamped: StampedPose, unix_s: float, now_s: float) -> None:
        if self._channels.wanted(SCENE) and abs(unix_s - self._drawn_s) >= ELLIPSOID_EVERY_S:
            drawn = pose_scene(stamped.pose, unix_s)
            if drawn is not None:
                self._drawn_s = unix_s
                self._channels.log(SCENE, drawn, now_s)

    def _listening(self, address: Address) -> WebSocketServer:
        try:
            return foxglove.start_server(
                name=f"goldfield: {self._site.name}",
                host=address.host,
                port=address.port,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except Exception as error:  # the SDK raises a RuntimeError of its own, and says not what it may raise
            raise address.wrong(f"this machine cannot listen there: {reason_of(error)}") from None
