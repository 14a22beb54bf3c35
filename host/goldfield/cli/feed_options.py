"""The option ``--feed``, which may be given several times."""

from __future__ import annotations

import argparse
import os

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


def chosen(arguments: argparse.Namespace) -> list[Address]:
    """Return the addresses of the feeds that were asked for; `UserError` if one of them is none, or there twice."""
    urls = arguments.feed or os.environ.get(VARIABLE, "").split()
    feeds = [parse_address(url) for url in urls]
    for number, feed in enumerate(feeds):
        if feed.url in urls[:number]:
            raise feed.wrong("is given twice: leave one out")
    return feeds


def outputs(feeds: list[Address]) -> dict[str, str | None]:
    """Return the files that feeds write, by the option that names them, for `check_outputs`."""
    return {f"--feed {feed.url}": feed.path for feed in feeds if feed.scheme in FILES}
