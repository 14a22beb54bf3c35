"""The channels of the topics, on one context of the Foxglove SDK: a recording or a server gets what is logged there."""

from __future__ import annotations

from typing import Any

import foxglove
from foxglove import channels as typed

from goldfield.foxglove.topics import CAN, JSON_SCHEMAS
from goldfield.link.ros_frame import SCHEMA, SCHEMA_NAME, nanoseconds
from goldfield.view.records import json_line


class Channels:
    """Logs messages on their topics; each channel begins with its first message.

    Parameters
    ----------
    context : foxglove.Context
        Whatever is attached to it gets the messages: a file, a server.
    """

    def __init__(self, context: foxglove.Context) -> None:
        self._context = context
        self._channels: dict[str, Any] = {}

    def wanted(self, *topics: str) -> bool:
        """Tell whether anybody gets what is logged on one of some topics; one that has no channel yet is to get it."""
        return any(topic not in self._channels or self._channels[topic].has_sinks() for topic in topics)

    def log(self, topic: str, message: Any, arrived_s: float) -> None:
        """Log a message.

        Parameters
        ----------
        topic : str
            One of `goldfield.foxglove.topics`.
        message : message of Foxglove, dict or bytes
            A record for the topics in JSON, the CDR for that of CAN.
        arrived_s : float
            When it came, by the wall clock, s since 1970; not the time of the measurement, which it tells itself.
        """
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._made(topic, message)
        content = json_line(message).encode() if isinstance(message, dict) else message
        channel.log(content, log_time=nanoseconds(arrived_s))

    def _made(self, topic: str, message: Any) -> Any:
        if topic in JSON_SCHEMAS:
            return foxglove.Channel(topic, schema=JSON_SCHEMAS[topic], context=self._context)
        if topic == CAN:
            schema = foxglove.Schema(name=SCHEMA_NAME, encoding="ros2msg", data=SCHEMA)
            return foxglove.Channel(topic, message_encoding="cdr", schema=schema, context=self._context)
        return getattr(typed, f"{type(message).__name__}Channel")(topic, context=self._context)
