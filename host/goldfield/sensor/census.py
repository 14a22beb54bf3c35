"""Which sensors are on a link, and which of them is read: the only one, or the one that the user chose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import can

from goldfield.errors import UserError, option
from goldfield.link.heartbeat import ROLE_ANCHOR, ROLE_SENSOR, ROLES
from goldfield.sensor.receiver import TO_NODES, channel_of, other_protocol, used_message
from goldfield_protocol.messages import Message


@dataclass(frozen=True)
class Place:
    """A node on a channel; a channel of None is the only one that the source has."""

    channel: str | None
    node: int


def tells_of_motion(message: Message) -> bool:
    """Tell whether a message is one of those by which boards on a bus know with whom they share it (bus_share.h)."""
    return message.name == "BLOCK" or (message.name == "POSE_POSITION" and message.index > 0)


class Census:
    """Counts the sensors among the messages of a link.

    Parameters
    ----------
    node : int, optional
        The node that the user chose, which may be an anchor's.
    channel : str, optional
        The channel that the user chose.
    by_reports : bool, optional
        Whether a node that sends reports counts as a sensor though it has not told its role, as in a recording.
    live : bool, optional
        Whether the nodes are there, and can be flashed; else they are those of a recording.

    Attributes
    ----------
    node : int or None
        The node that the user chose.
    heard : set of str
        What else was heard, for an error message.
    refused : str or None
        What to do with a sensor that would count if it spoke this host's protocol.
    moving : set of int
        The nodes that tell of their motion: those that send blocks, or poses of them.
    """

    def __init__(
        self, node: int | None = None, channel: str | None = None, *, by_reports: bool = False, live: bool = True
    ) -> None:
        self.heard: set[str] = set()
        self.refused: str | None = None
        self.moving: set[int] = set()
        self.node = node
        self._channel = channel
        self._by_reports = by_reports
        self._live = live
        self._reporting: dict[Place, None] = {}
        self._roles: dict[Place, int] = {}
        self._strangers: set[Place] = set()

    def take(self, raw: can.Message) -> Message | None:
        """Take a message; return it decoded if it is one of ours."""
        message = used_message(raw)
        if message is None or message.name in TO_NODES:
            return None
        place = Place(channel_of(raw), message.node)
        if tells_of_motion(message):
            self.moving.add(message.node)
        if message.name == "EPOCH":
            self._reporting[place] = None
        if message.name == "HEARTBEAT":
            self._take_heartbeat(place, message)
        else:
            self.heard.add(f"{message.name} of node {message.node}")
        return message

    @property
    def found(self) -> tuple[Place, ...]:
        """The sensors that can be read, the one that was heard first before the others."""
        places = dict.fromkeys((*self._roles, *(self._reporting if self._by_reports else ())))
        return tuple(place for place in places if self._readable(place))

    @property
    def unchosen(self) -> str:
        """The nodes with reports that the user did not choose, with their channels, for an error message."""
        others = [p for p in self._reporting if not self._chosen(p) and p not in self._strangers]
        return ", ".join(f"node {p.node}" + (f" on {p.channel}" if p.channel else "") for p in others)

    def choose(self, name: str) -> Place | None:
        """Return the sensor that is read, None if none was found.

        Parameters
        ----------
        name : str
            The link's name.

        Raises
        ------
        UserError
            If there are several, or the only one speaks another protocol.
        """
        found = self.found
        if not found and self.refused is not None:
            raise UserError(f"{name}: {self.refused}")
        if len(found) > 1:
            raise UserError(f"{name}: there are several sensors: {', '.join(self._named(found))}: choose one")
        return found[0] if found else None

    def _named(self, places: tuple[Place, ...]) -> Iterator[str]:
        """Yield each sensor with the options that choose it and no other."""
        for place in sorted(places, key=lambda place: (place.channel or "", place.node)):
            what = f"{ROLES[self._roles.get(place, ROLE_SENSOR)]} {place.node}"
            options = []
            if sum(other.node == place.node for other in places) > 1 or len({p.channel for p in places}) > 1:
                what += f" on {place.channel}"
                options.append(option("channel", place.channel or ""))
            if sum(other.channel == place.channel for other in places) > 1:
                options.append(option("node", place.node))
            yield f"{what} ({' '.join(options)})"

    def _take_heartbeat(self, place: Place, heartbeat: Message) -> None:
        role = int(heartbeat.signals["role"])
        fault = other_protocol(heartbeat, live=self._live)
        if fault is not None:
            self._strangers.add(place)
            if self._chosen(place) and (role == ROLE_SENSOR or self.node is not None):
                self.refused = fault
            self.heard.add(f"node {place.node}, which speaks another protocol")
            return
        self._strangers.discard(place)
        self._roles[place] = role
        if role == ROLE_ANCHOR and self.node is None:
            self.heard.add(f"anchor {place.node} (to read it, give {option('node', place.node)})")
        else:
            self.heard.add(f"{ROLES[role]} {place.node}")

    def _chosen(self, place: Place) -> bool:
        return self.node in (None, place.node) and self._channel in (None, place.channel)

    def _readable(self, place: Place) -> bool:
        return self._chosen(place) and self._senses(place) and place not in self._strangers

    def _senses(self, place: Place) -> bool:
        role = self._roles.get(place)
        if role is None:
            return self._by_reports and place in self._reporting
        return role == ROLE_SENSOR or (role == ROLE_ANCHOR and self.node is not None)
