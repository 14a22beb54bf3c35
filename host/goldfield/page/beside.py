"""A page beside a command: served while the command runs, and told what its sensor yields."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from goldfield.errors import SystemFailure, UserError
from goldfield.page.application import application
from goldfield.page.expected_error import ExpectedError
from goldfield.page.greeting import hello
from goldfield.page.hub import Hub
from goldfield.page.serving import Listener, PageServer, built_assets, parse_address
from goldfield.site import Site

LAST_WORD_S = 1.0
"""Longest time for which a command that is at its end waits until the browsers have its last words, s."""
LOOK_S = 0.01


@dataclass(frozen=True, eq=False)
class Served:
    """A page that is served: the hub that feeds it, and the address at which a browser finds it."""

    hub: Hub
    url: str


@contextmanager
def served(site: Site, name: str, *, live: bool, bind: str | None, named: str = "bind") -> Iterator[Served]:
    """Serve a page about a site as long as the context lasts; at its end the browsers are told so, and why.

    Parameters
    ----------
    site : Site
    name : str
        The link's name, or the recording's.
    live : bool
        Whether it is a sensor on a link, not a recording.
    bind : str or None
        ``ADDRESS:PORT``, as for `parse_address`; None or empty: this machine only.
    named : str, optional
        The option that gives it, for error messages.

    Raises
    ------
    UserError
        If this machine cannot listen there.
    SystemFailure
        If the page is not built.
    """
    assets = built_assets()
    hub = Hub(hello(site, name, live=live), site.cycle_s, live=live)
    listener = Listener(parse_address(bind, named) if bind else None, named)
    page = application(hub, assets, ExpectedError(site), listener.token)
    with PageServer(page, listener):
        last = "goldfield has ended"
        try:
            yield Served(hub, listener.url)
        except (SystemFailure, UserError) as error:
            last = str(error)
            raise
        finally:
            hub.end(last)
            end_s = time.monotonic() + LAST_WORD_S
            while not hub.drained and time.monotonic() < end_s:
                time.sleep(LOOK_S)
