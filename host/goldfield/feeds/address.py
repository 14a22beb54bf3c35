"""Where a feed goes, as ``--feed`` says it: ``ws://127.0.0.1:8421``, ``mqtt://broker/hall/pose``, ``tum:walk.txt``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from urllib.parse import parse_qsl, urlsplit

from goldfield.errors import UserError, option

LOOPBACK = "127.0.0.1"

EXAMPLES = {
    "foxglove": "foxglove://127.0.0.1:8765",
    "ws": "ws://127.0.0.1:8421",
    "udp": "udp://127.0.0.1:9000",
    "mqtt": "mqtt://broker/hall/pose",
    "mqtts": "mqtts://ann@broker/hall/pose",
    "ros2": "ros2:goldfield",
    "tum": "tum:walk.txt",
    "nmea": "nmea:walk.nmea",
    "nmea+udp": "nmea+udp://127.0.0.1:10110",
}
"""Each scheme, with an example."""
PORTS = {"foxglove": 8765, "ws": 8421, "mqtt": 1883, "mqtts": 8883}
"""The port that a scheme has if none is given; the others need one."""
SERVERS = ("foxglove", "ws")
"""Schemes that listen: without an address only this machine reaches them, and port 0 is any that is free."""
SENDERS = ("udp", "mqtt", "mqtts", "nmea+udp")
"""Schemes that send to a host."""
FILES = ("tum", "nmea")
"""Schemes that write a file."""
OPTIONS: Mapping[str, tuple[str, ...]] = {
    "ws": ("origin",),
    "mqtt": ("password_file",),
    "mqtts": ("ca", "cert", "key", "password_file"),
    "ros2": ("map", "sensor", "tf"),
}
"""What may stand behind a ``?``, by scheme."""
ORIGIN = re.compile(r"null|[a-z][a-z0-9+.-]*://[^/?#@\s]+")
"""What a browser calls the place that a page is from: ``null`` is a file's."""
ROS_NAME = re.compile(r"[A-Za-z_]\w*(/[A-Za-z_]\w*)*", re.ASCII)


@dataclass(frozen=True)
class Address:
    """A feed's address, read from a URL.

    Attributes
    ----------
    url : str
        As it was given.
    scheme : str
        One of `EXAMPLES`.
    host : str
        For a server the address at which it listens.
    port : int
    path : str
        The file, or the topic, without a slash at its ends.
    user : str or None
    options : mapping of str to str
        What stood behind the ``?``.
    """

    url: str
    scheme: str
    host: str = ""
    port: int = 0
    path: str = ""
    user: str | None = None
    options: Mapping[str, str] = field(default_factory=dict)

    def place(self, port: int) -> str:
        """Return ``HOST:PORT`` with the port that a server really has."""
        return f"[{self.host}]:{port}" if ":" in self.host else f"{self.host}:{port}"

    def wrong(self, what: str) -> UserError:
        """Return the error that says what is wrong with this feed."""
        return wrong(self.url, what)


def parse_address(url: str) -> Address:
    """Return the address that a URL says.

    Raises
    ------
    UserError
        If it is no feed, or a part of it is missing or has no meaning.

    Examples
    --------
    >>> parse_address("mqtt://ann@broker:1884/hall/pose").path
    'hall/pose'
    >>> parse_address("ws://:9001").host
    '127.0.0.1'
    >>> parse_address("tcp://broker")
    Traceback (most recent call last):
    goldfield.errors.UserError: feed=tcp://broker: is no feed: give one as foxglove://127.0.0.1:8765, \
ws://127.0.0.1:8421, udp://127.0.0.1:9000, mqtt://broker/hall/pose, mqtts://ann@broker/hall/pose, ros2:goldfield, \
tum:walk.txt, nmea:walk.nmea, nmea+udp://127.0.0.1:10110
    """
    scheme, colon, rest = url.partition(":")
    if not colon or scheme not in EXAMPLES:
        raise wrong(url, f"is no feed: give one as {', '.join(EXAMPLES.values())}")
    if scheme in FILES:
        if not rest or rest.startswith("//"):
            raise wrong(url, f"needs a file, as {EXAMPLES[scheme]}")
        return Address(url, scheme, path=rest)
    return _split(url, scheme)


def _split(url: str, scheme: str) -> Address:
    try:
        parts = urlsplit(url)
        host, port = parts.hostname or "", parts.port
    except ValueError as error:  # a port that is none, a bracket that does not close
        raise wrong(url, f"is no address ({error}): give one as {EXAMPLES[scheme]}") from None
    query = parts.query.replace("+", "%2B")  # a plus is one, in names of files
    options = dict(parse_qsl(query, keep_blank_values=True))
    address = Address(url, scheme, host, port or 0, parts.path.strip("/"), parts.username, options)
    if parts.password is not None:
        raise wrong(url.replace(f":{parts.password}@", ":...@"), "other users of this machine would see the password")
    try:
        host.encode("idna")
    except UnicodeError as error:
        raise address.wrong(f"'{host}' is no name of a host ({error})") from None
    if "#" in url:  # also with nothing behind it, as in the pattern of topics "hall/#"
        raise address.wrong(f"'#{parts.fragment}' has no meaning here")
    for name in options:
        if name not in OPTIONS.get(scheme, ()):
            raise address.wrong(f"'{name}' is none of its options ({', '.join(OPTIONS.get(scheme, ())) or 'none'})")
    for origin in filter(None, options.get("origin", "").split(",")):
        if not ORIGIN.fullmatch(origin):  # no browser would ever name it, and nothing would tell why pages are refused
            raise address.wrong(f"'{origin}' is no origin: give it as http://localhost:3000, with nothing behind")
    return _completed(address, given_port=port)


def _completed(address: Address, given_port: int | None) -> Address:
    """Return an address with the defaults of its scheme; `UserError` if something is missing or too much."""
    scheme, example = address.scheme, EXAMPLES[address.scheme]
    if scheme == "ros2":
        if address.host or given_port is not None or not ROS_NAME.fullmatch(address.path):
            raise address.wrong(f"needs the beginning of its topics, of letters, digits, _ and /, as {example}")
        return address
    host = address.host or (LOOPBACK if scheme in SERVERS else "")
    port = PORTS.get(scheme) if given_port is None else given_port
    if not host:
        raise address.wrong(f"needs a host, as {example}")
    if port is None or (port == 0 and scheme in SENDERS):
        raise address.wrong(f"needs a port, as {example}")
    if scheme in ("mqtt", "mqtts"):
        if not address.path or any(sign in address.path for sign in "+#\0"):
            raise address.wrong(f"needs a topic without + and #, as {example}")
    elif address.path or address.user is not None:
        raise address.wrong(f"has more than address and port: give it as {example}")
    return Address(address.url, scheme, host, port, address.path, address.user, address.options)


def wrong(url: str, what: str) -> UserError:
    """Return the error that says what is wrong with a feed."""
    return UserError(f"{option('feed', url)}: {what}")
