"""What ``goldfield view`` does: browsers are answered first, then what makes poses is loaded, and feeds the page."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass

from goldfield.cli import options
from goldfield.errors import EXIT_FAILED, counted, tell
from goldfield.feeds.address import Address
from goldfield.link.buses import Source
from goldfield.page.beside import served
from goldfield.page.hub import Hub
from goldfield.sensor.options import Options
from goldfield.site import Site


@dataclass(frozen=True)
class Wanted:
    """What is shown: a source, as for `open_sensor`, and how many times faster than it was made a log is played."""

    kind: str
    where: str
    site: Site
    choices: Options
    pace: float

    @property
    def live(self) -> bool:
        """Whether it is a sensor on a link, not a recording."""
        return self.kind != "log"


def show(wanted: Wanted, addresses: Sequence[Address], bind: str | None, source: Source | None) -> int:
    """Print the page's address and serve it until Ctrl-C.

    Parameters
    ----------
    wanted : Wanted
    addresses : sequence of Address
        Where the poses go besides.
    bind : str or None
        ``ADDRESS:PORT``, as for `goldfield.page.serving.parse_address`; None: this machine only.
    source : Source or None
        The source, if it is open already.

    Returns
    -------
    int
        The exit code: 0, or 3 if a feed failed.
    """
    code = 0
    with contextlib.suppress(KeyboardInterrupt), served(wanted.site, wanted.where, live=wanted.live, bind=bind) as page:
        print(page.url, flush=True)
        options.tell_assumed(wanted.site)
        code = _feed(page.hub, wanted, addresses, source)
    return code


def _feed(hub: Hub, wanted: Wanted, addresses: Sequence[Address], source: Source | None) -> int:
    """Feed the page, and whatever else was asked for; return the exit code."""
    # Heavy: what makes poses of fields. A browser loads the page meanwhile.
    from goldfield.feeds.feed import Setting
    from goldfield.feeds.opening import open_feeds
    from goldfield.page.feeding import Feed

    with open_feeds(addresses, Setting(wanted.site), live=wanted.live) as feeds:
        feed = Feed(hub, wanted.kind, wanted.where, wanted.site, wanted.choices, wanted.pace, feeds.write, source)
        with contextlib.suppress(KeyboardInterrupt):
            feed.run()
            feed.stopped.wait()  # a recording is at its end, and still looked at
    for name, count in feeds.dropped.items():
        tell(f"{name}: {counted(count, 'poses were left out')}, because it was too slow or not there")
    return EXIT_FAILED if feeds.failed else 0
