"""The option ``--feed``, which may be given several times."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable

from goldfield.cli.options import environment_name
from goldfield.feeds.address import EXAMPLES, FILES, Address, parse_address

VARIABLE = environment_name("--feed")


def add(parser: argparse.ArgumentParser) -> None:
    """Add ``--feed``."""
    parser.add_argument(
        "--feed",
        metavar="URL",
        action="append",
        help="send the poses to other programs, too; may be given several times: "
        f"{', '.join(EXAMPLES.values())} (environment: {VARIABLE}, with spaces between)",
    )


def chosen(arguments: argparse.Namespace, dated: Callable[[str], str] = str) -> list[Address]:
    """Return the addresses of the feeds that were asked for; `UserError` if one of them is none, or there twice.

    Parameters
    ----------
    arguments : argparse.Namespace
    dated : callable
        Returns a URL with the time in place of what stands for it.
    """
    urls = [dated(url) for url in arguments.feed or os.environ.get(VARIABLE, "").split()]
    feeds = [parse_address(url) for url in urls]
    for number, feed in enumerate(feeds):
        if feed.url in urls[:number]:
            raise feed.wrong("is given twice: leave one out")
    return feeds


def outputs(feeds: list[Address]) -> dict[str, str | None]:
    """Return the files that feeds write, by the option that names them, for `check_outputs`."""
    return {f"--feed {feed.url}": feed.path for feed in feeds if feed.scheme in FILES}
