"""The live page beside what a command prints, if its option ``--view`` asks for one."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator

from goldfield.errors import tell
from goldfield.page.publishing import Publisher
from goldfield.site import Site


@contextlib.contextmanager
def shown(arguments: argparse.Namespace, site: Site, name: str, *, live: bool) -> Iterator[Publisher | None]:
    """Serve the page as long as the context lasts, and yield what feeds it; None if nobody asked for a page.

    Parameters
    ----------
    arguments : argparse.Namespace
        The command line, with what `add_view` adds.
    site : Site
    name : str
        The link's name, or the recording's.
    live : bool
        Whether it is a sensor on a link, not a recording.
    """
    if arguments.view is None:
        yield None
        return
    from goldfield.page.beside import served  # heavy: only when a page is served

    with served(site, name, live=live, bind=arguments.view, named="view") as page:
        tell(f"the live page is at {page.url}")
        yield Publisher(page.hub, site, name)
