"""A server for Foxglove: poses with covariance, transforms, the site's scene, fields and health, live.

The topics are those of a recording in MCAP (`goldfield.foxglove.topics`), but for the messages of the link.
"""

from __future__ import annotations

import math
import threading

import foxglove
from foxglove.websocket import WebSocketServer

from goldfield.errors import tell
from goldfield.feeds.address import Address
from goldfield.feeds.feed import Feed, Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.files.inputs import reason_of
from goldfield.foxglove.channels import Channels
from goldfield.foxglove.telling import Telling
from goldfield.nodes.roster import Roster

BACKLOG = 512
"""Messages that wait for one consumer; the oldest goes if there is no room."""
LAST_S = 1.0
"""How long the end waits for the SDK: its server ends when all consumers have gone, or have said what they are."""


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
        self._context = foxglove.Context()
        self._channels = channels = Channels(self._context)
        self._telling = Telling(setting.site, address.url, Roster(), channels.log, channels.wanted)
        self._server = self._listening(address)
        self.port = self._server.port
        self._telling.begin(self._clock())

    def write(self, stamped: StampedPose, /) -> None:
        """Send a pose."""
        now_s = self._clock()
        if stamped.line.epoch is not None:
            self._telling.epoch(stamped.line.epoch, stamped.unix_s, now_s)
        self._telling.line(stamped.line, stamped.unix_s, now_s, now_s if stamped.live else math.nan)

    def close(self) -> None:
        """End the server; one that a connection which says nothing holds up goes on until the program ends."""
        stopping = threading.Thread(target=self._server.stop, daemon=True)
        stopping.start()
        stopping.join(LAST_S)

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
            raise address.wrong(
                f"this machine cannot listen there: {reason_of(error)}; give another port or address"
            ) from None
