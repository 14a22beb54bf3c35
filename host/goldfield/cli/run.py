"""``goldfield run``: live poses from a sensor, or from a recorded log."""

from __future__ import annotations

import argparse
import time
from typing import Any

from goldfield.cli import feed_options, link_options, options
from goldfield.cli.location_options import add_alert_limit, add_on_sensor, add_times, add_track, site_of
from goldfield.cli.page_option import add_view
from goldfield.errors import on_command_line
from goldfield.files.dated import DatedNames
from goldfield.files.outputs import check_outputs

RECORD = (
    "keep every message received: .mcap with the poses, for Foxglove; .log of candump; .asc and .blf for Vector's "
    "tools; {time} in the name becomes the time of the start"
)


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "run",
        help="live poses from a sensor",
        description="Poses from a sensor on a serial port or CAN, or from a recorded log: a line for every epoch, "
        "or at a rate.",
    )
    link_options.add(parser, log=True)
    options.add_site(parser)
    add_track(parser)
    add_times(parser)
    add_on_sensor(parser)
    link_options.add_strongest(parser)
    add_alert_limit(parser)
    options.add_json(parser)
    options.add(parser, "--record", metavar="FILE", what=RECORD)
    options.add(parser, "--fields", metavar="FILE", what="write the separated fields to a table for goldfield locate")
    options.add(parser, "--summary", metavar="FILE", what="write the summary as a JSON object, at the end")
    feed_options.add(parser)
    options.add_force(parser)
    options.add(parser, "--seconds", metavar="N", what="stop after so much time of the sensor", kind=options.seconds)
    options.add(parser, "--truth", metavar="FILE", what="the simulator's truth, to compare with")
    add_view(parser)
    link_options.add_reading(parser)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Print a line for every epoch, or at a rate, and a summary."""
    from goldfield.cli.live import print_poses  # heavy: only when a pose is wanted

    kind, where = link_options.chosen(arguments)
    site = options.required(arguments.site, "--site", "FILE")
    inputs = {"--site": site, "--log": where if kind == "log" else None, "--truth": arguments.truth}
    with DatedNames(time.time()) as dated:
        for name in ("record", "fields", "summary"):
            setattr(arguments, name, dated.of(getattr(arguments, name)))
        outputs = {"--record": arguments.record, "--fields": arguments.fields, "--summary": arguments.summary}
        feeds = feed_options.chosen(arguments, dated.of_url)
        check_outputs(outputs | feed_options.outputs(feeds), inputs, force=arguments.force)
        known = site_of(arguments)
        options.tell_assumed(known)
        return print_poses(arguments, kind, where, known, feeds)
