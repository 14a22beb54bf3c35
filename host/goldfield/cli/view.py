"""``goldfield view``: live poses and the health of the beacons as a page in the browser."""

from __future__ import annotations

import argparse
import contextlib
import time
from typing import Any

from goldfield.cli import feed_options, link_options, options
from goldfield.cli.location_options import add_alert_limit, add_on_sensor, add_times, add_track, site_of
from goldfield.errors import UserError, on_command_line
from goldfield.files.dated import DatedNames
from goldfield.files.outputs import check_outputs
from goldfield.sensor.options import chosen_method


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "view",
        help="live page: poses and beacons in the browser",
        description="Serve a page that shows the site, the sensor's poses, and how each beacon does, live or from a "
        "recording. The first line on stdout is the page's address. Only browsers of this machine reach it, unless "
        "--bind says otherwise; the address then holds a token, without which nothing is answered.",
    )
    link_options.add(parser, log=True)
    options.add_site(parser)
    options.add(
        parser,
        "--bind",
        metavar="ADDRESS:PORT",
        what="where to listen, as 0.0.0.0:8000 for every network of this machine (default: port 8420 of this machine "
        "alone, or any that is free)",
    )
    options.add(
        parser,
        "--pace",
        metavar="X",
        what="play a recording X times as fast as it was made; 0: as fast as it can be computed (default: 1)",
        kind=_pace,
    )
    feed_options.add(parser)
    add_track(parser)
    add_times(parser)
    add_on_sensor(parser)
    link_options.add_strongest(parser)
    add_alert_limit(parser)
    link_options.add_reading(parser, reconnect=False)
    parser.set_defaults(run=run)


def _pace(text: str) -> float:
    """Parse a pace, for argparse."""
    value = options.finite(text)
    if value < 0.0:
        raise argparse.ArgumentTypeError(f"{text} is no pace: give 0, or a number above it")
    return value


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Print the address and serve the page until Ctrl-C, which is the usual end."""
    kind, where = link_options.chosen(arguments)
    dated = DatedNames(time.time())
    addresses = feed_options.chosen(arguments, dated.of_url)
    files = feed_options.outputs(addresses)
    check_outputs(files, {"--site": arguments.site, "--log": where if kind == "log" else None})
    site = site_of(arguments)
    method = chosen_method(arguments.track, arguments.on_sensor, arguments.rate, arguments.lag)
    choices = link_options.reading(arguments, method)
    choices.check(site)

    from goldfield.sensor.sources import open_source  # heavy: only when a sensor is read

    with contextlib.ExitStack() as stack:
        stack.enter_context(dated)
        source = None
        if kind == "port":
            with contextlib.suppress(UserError):  # which the feed raises again, once the page is there
                source = open_source(kind, where, choices)
                stack.callback(source.close)

        # Heavy: only when a page is served. What the sensor says meanwhile waits in the port.
        from goldfield.cli.viewing import Wanted, show

        wanted = Wanted(kind, where, site, choices, 1.0 if arguments.pace is None else arguments.pace)
        return show(wanted, addresses, arguments.bind, source)
