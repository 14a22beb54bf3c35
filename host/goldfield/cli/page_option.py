"""The option ``--view [ADDRESS:PORT]`` of a command that reads a sensor: the live page beside what it prints."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING

from goldfield.cli import options
from goldfield.errors import tell
from goldfield.site import Site

if TYPE_CHECKING:
    from goldfield.page.publishing import Publisher


def add_view(parser: argparse.ArgumentParser) -> None:
    """Add the option."""
    options.add(
        parser,
        "--view",
        metavar="ADDRESS:PORT",
        what="serve the live page meanwhile, at this address as goldfield view does with --bind, or without one at "
        "port 8420 of this machine alone; stderr tells where it is",
        alone="",
    )


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
    from goldfield.page.publishing import Publisher

    with served(site, name, live=live, bind=arguments.view) as page:
        tell(f"the live page is at {page.url}")
        yield Publisher(page.hub, site, name)
