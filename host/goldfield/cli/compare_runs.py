"""``goldfield compare-runs``: the poses of two runs, or those of a recording and today's."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any

from goldfield.cli import options
from goldfield.errors import EXIT_FAILED, UserError, on_command_line
from goldfield.files.outputs import check_outputs

MOST_LINES = 20
"""Differences that are shown one by one, unless all are asked for."""
HEADER = "   epoch       time s     distance mm    attitude deg  deviations  status"


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "compare-runs",
        help="recorded poses beside today's, or two runs",
        description="Compare the poses of a recording with those that today's estimator makes of its messages, or with "
        "those of a second run. Poses of one epoch and time are compared; those that differ are listed.",
    )
    parser.add_argument("first", metavar="FILE", help="recording in MCAP, or lines of goldfield run --json")
    parser.add_argument(
        "second", metavar="SECOND", nargs="?", help="a second one; without it the first is computed again"
    )
    options.add(parser, "--site", metavar="FILE", what="site file in place of the recorded one, for the second run")
    options.add_json(parser)
    parser.add_argument("--all", action="store_true", help=f"list all that differs, not the first {MOST_LINES}")
    options.add(parser, "--summary", metavar="FILE", what="write the summary as a JSON object, at the end")
    parser.add_argument("--exact", action="store_true", help="exit with 3 unless the runs are bit-identical")
    options.add_force(parser)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Print the differences and a summary."""
    from goldfield.cli.output import json_line  # heavy: only when runs are compared
    from goldfield.files.outputs import write_file
    from goldfield.recording.comparison import Comparison, differences
    from goldfield.recording.runs import EstimatedRun, open_run

    inputs = {"FILE": arguments.first, "SECOND": arguments.second, "--site": arguments.site}
    check_outputs({"--summary": arguments.summary}, inputs, force=arguments.force)
    again = arguments.second is None
    second = open_run(arguments.first if again else arguments.second, arguments.site, again=again)
    first = open_run(arguments.first, arguments.site)
    if again and isinstance(first, EstimatedRun):
        raise UserError(f"{first.name}: holds messages and no poses to compare with today's: give a second run")
    comparison = Comparison((first.name, "today's" if again else second.name))
    shown = 0
    for difference in differences(first, second, comparison):
        if arguments.json:
            print(json_line(difference.record()))
        elif not difference.identical:
            shown += 1
            if shown == 1:
                print(HEADER)
            if arguments.all or shown <= MOST_LINES:
                print(_line(difference))
    if shown > MOST_LINES and not arguments.all:
        print(f"... and {shown - MOST_LINES} more: --all lists them")
    print(comparison.text(), file=sys.stderr if arguments.json else sys.stdout)
    if arguments.summary:
        write_file(
            arguments.summary, f"{json_line(comparison.record())}\n".encode(), "the summary", force=arguments.force
        )
    return EXIT_FAILED if arguments.exact and not comparison.same else 0


def _line(difference: Any) -> str:
    """Return a line of the table."""
    before, after = difference.statuses
    status = before if before == after else f"{before} -> {after}"
    time_s = math.nan if difference.time_s is None else difference.time_s
    return (
        f"{difference.epoch:8} {time_s:12.6f} {1e3 * difference.position_m:15.6g} "
        f"{math.degrees(difference.attitude_rad):15.6g} {difference.deviations:11.3g}  {status}"
    )
