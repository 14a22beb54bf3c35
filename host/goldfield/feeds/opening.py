"""Opens the feeds that were asked for, and hands them every pose without waiting for any of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import import_module
from types import TracebackType
from typing import Self

from goldfield.errors import tell
from goldfield.feeds.address import Address
from goldfield.feeds.feed import Feed, Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.sensor.pipeline import Epoch, Fix
from goldfield.sensor.sinks import Branch
from goldfield.view.lines import Lines
from goldfield.view.unix_time import LiveUnixTime, UnixTime

MODULES = {
    "foxglove": "goldfield.feeds.foxglove",
    "ws": "goldfield.feeds.websocket",
    "udp": "goldfield.feeds.udp",
    "mqtt": "goldfield.feeds.mqtt",
    "mqtts": "goldfield.feeds.mqtt",
    "ros2": "goldfield.feeds.ros2",
    "tum": "goldfield.feeds.tum",
    "nmea": "goldfield.feeds.nmea",
    "nmea+udp": "goldfield.feeds.nmea",
}
"""Where the function ``open_feed`` of each scheme is."""
CAPACITY = 512
"""Poses that wait for a feed that is slow: 1.5 s at 330 a second."""
CLOSING_S = 3.0
"""How long a feed is waited for at the end, unless it is a file."""


def open_feeds(addresses: Iterable[Address], setting: Setting, *, live: bool) -> Feeds:
    """Return the feeds to some addresses, opened; a context manager that closes them.

    Parameters
    ----------
    addresses : iterable of Address
    setting : Setting
    live : bool
        Whether the poses are measured now. Of a recording, files get every pose.

    Raises
    ------
    UserError
        If one cannot be opened: those before it are closed again.
    """
    opened: list[tuple[str, Feed]] = []
    try:
        for address in addresses:
            opened.append((address.url, open_feed(address, setting)))
    except BaseException:
        for _, feed in opened:
            feed.close()
        raise
    return Feeds(opened, setting.site.cycle_s, live=live)


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return one feed, opened; `UserError` if it cannot be, or a package that it needs is not installed."""
    try:
        module = import_module(MODULES[address.scheme])
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        if package == "goldfield":
            raise
        raise address.wrong(f"needs the package {package}: pip install 'goldfield[feeds]'") from None
    feed: Feed = module.open_feed(address, setting)
    return feed


@dataclass
class _Outlet:
    """A feed, and the queue before it."""

    feed: Feed
    branch: Branch[StampedPose]
    told: bool = False


class Feeds:
    """Stamps each pose and hands it to every feed, each of which has a queue and a thread of its own.

    A feed that is too slow loses the oldest poses of its queue. A feed that fails is told of, and the others go on.

    Parameters
    ----------
    feeds : sequence of (str, Feed)
        Each with its name.
    cycle_s : float
        Length of a code cycle.
    live : bool
        As for `open_feeds`.
    capacity : int, optional
        Poses that wait for each.
    """

    def __init__(
        self, feeds: Sequence[tuple[str, Feed]], cycle_s: float, *, live: bool, capacity: int = CAPACITY
    ) -> None:
        self._live = live
        self._lines = Lines()
        self._time = LiveUnixTime(cycle_s) if live else UnixTime(cycle_s)
        self._outlets = [
            _Outlet(feed, Branch(feed, name, waits=feed.whole and not live, capacity=capacity, newest=True))
            for name, feed in feeds
        ]

    def write(self, item: Epoch | Fix, /) -> None:
        """Hand a pose to every feed; a cycle whose pose is none of those at a rate tells the time alone."""
        if not self._outlets:
            return
        unix_s = self._time.unix_s(item)
        line = self._lines.take(item)
        if line is None:
            return
        stamped = StampedPose(line, unix_s, self._live)
        for outlet in self._outlets:
            outlet.branch.write(stamped)
            if outlet.branch.dropped and not outlet.told:
                outlet.told = True
                tell(f"{outlet.branch.name}: is too slow and misses the oldest poses")

    def close(self) -> None:
        """Let each feed send what is left for it, for some seconds at most unless it is a file, and close it."""
        for outlet in self._outlets:
            outlet.branch.close(None if outlet.feed.whole else CLOSING_S)

    @property
    def failed(self) -> bool:
        """Whether a feed has failed: what it sent or wrote is not whole."""
        return any(outlet.branch.failed for outlet in self._outlets)

    @property
    def dropped(self) -> dict[str, int]:
        """How many poses each feed has missed, or its consumers have, by its name."""
        counts = {outlet.branch.name: outlet.branch.dropped + outlet.feed.dropped for outlet in self._outlets}
        return {name: count for name, count in counts.items() if count}

    def __enter__(self) -> Self:
        """Return the feeds themselves."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the feeds."""
        self.close()
