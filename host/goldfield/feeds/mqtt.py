"""Poses to an MQTT broker: each a message of one line of JSON.

They have QoS 0, since a pose that comes late is worth nothing. ``TOPIC/online`` tells, retained, whether this program
is there: ``true``, and ``false`` once it ends or dies. `goldfield.feeds.mqtt_access` has passwords and TLS.
"""

from __future__ import annotations

import sys
import threading
from contextlib import suppress
from typing import Any

from paho.mqtt.client import Client, ConnectFlags, DisconnectFlags
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from goldfield.errors import tell
from goldfield.feeds.address import Address
from goldfield.feeds.feed import Feed, Setting
from goldfield.feeds.mqtt_access import password_of, tls_of, why_not_reached, why_turned_away
from goldfield.feeds.stamped import StampedPose

KEEPALIVE_S = 10
"""A broker that says nothing for one and a half times as long is taken to be gone."""
LONGEST_RETRY_S = 10
"""Longest wait from one attempt to reach the broker to the next; the first is 1 s."""
LOOK_S = 0.5
"""How often a message that the network does not take is looked at again."""
LAST_S = 1.0
"""How long the farewell may take."""


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return the feed to a broker, which may be absent still; `UserError` for a file that is not what it should be."""
    client = Client(CallbackAPIVersion.VERSION2)
    client.reconnect_delay_set(1, LONGEST_RETRY_S)
    password = password_of(address)
    if address.user is not None:
        client.username_pw_set(address.user, password)
    if address.scheme == "mqtts":
        client.tls_set_context(tls_of(address))
    return MqttFeed(address, setting, client)


class MqttFeed:
    """Publishes each pose while the broker is there, and waits for it without end while it is not.

    Parameters
    ----------
    address : Address
    setting : Setting
    client : paho.mqtt.client.Client
        Not connected yet.

    Attributes
    ----------
    dropped : int
        Poses that came while the broker was gone.
    """

    whole = False

    def __init__(self, address: Address, setting: Setting, client: Client) -> None:
        self.dropped = 0
        self._address = address
        self._topic, self._online = address.path, f"{address.path}/online"
        self._clock = setting.clock
        self._connection = 0
        """Number of the latest connection; 0: there is none."""
        self._connections = 0
        self._refused = False
        self._told = ""
        self._client = client
        self._closing = threading.Event()
        client.on_connect = self._on_connect
        client.on_connect_fail = self._on_connect_fail
        client.on_disconnect = self._on_disconnect
        client.will_set(self._online, "false", retain=True)
        client.connect_async(address.host, address.port, keepalive=KEEPALIVE_S)
        client.loop_start()

    def write(self, stamped: StampedPose, /) -> None:
        """Publish a pose, and wait until it is on its way, so that nothing piles up before a network that is slow."""
        connection = self._connection
        if not connection:
            self.dropped += 1
            return
        message = self._client.publish(self._topic, stamped.json(self._clock()))
        try:
            while not message.is_published():
                if self._connection != connection:
                    self.dropped += 1
                    return
                message.wait_for_publish(LOOK_S)
        except (RuntimeError, ValueError):  # paho's: the connection ended before or while it was waited for
            self.dropped += 1

    def close(self) -> None:
        """Say that this program goes, and go."""
        if self._connection:
            with suppress(RuntimeError, ValueError):
                self._client.publish(self._online, "false", retain=True).wait_for_publish(LAST_S)
        self._closing.set()
        self._client.disconnect()
        self._client.loop_stop()

    def _on_connect(
        self, client: Client, userdata: Any, flags: ConnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        self._refused = reason.is_failure
        if reason.is_failure:
            self._tell(f"the broker refuses: {reason}; trying again")
            return
        client.publish(self._online, "true", retain=True)
        self._connections += 1
        self._connection = self._connections
        if self._told:
            self._tell("the broker is there again" if self._connections > 1 else "the broker is there")
        self._told = ""

    def _on_connect_fail(self, client: Client, userdata: Any) -> None:
        error = sys.exception()  # paho calls this while it handles it
        self._tell(f"{why_not_reached(self._address, error)}; trying again")

    def _on_disconnect(
        self, client: Client, userdata: Any, flags: DisconnectFlags, reason: ReasonCode, properties: Properties | None
    ) -> None:
        was_there, self._connection = self._connection, 0
        refused, self._refused = self._refused, False
        if self._closing.is_set() or refused:
            return
        self._tell(f"{'the broker is gone' if was_there else why_turned_away(self._address)}; trying again")

    def _tell(self, text: str) -> None:
        """Tell something of the broker, once in a row."""
        if text != self._told:
            self._told = text
            tell(f"{self._address.url}: {text}")
