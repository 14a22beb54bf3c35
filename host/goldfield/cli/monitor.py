"""``goldfield monitor``: the live health of a sensor and its beacons."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Callable
from typing import Any

from goldfield import site as sites
from goldfield.cli import link_options, options
from goldfield.errors import on_command_line


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "monitor",
        help="live health of a sensor and its beacons",
        description="Rates, losses, clock, and each beacon's strength against the expected one, over the latest 2 s: a "
        "table that is drawn anew in place, or a line each time if stdout is no terminal.",
    )
    link_options.add(parser, log=True)
    options.add_site(parser)
    options.add(parser, "--seconds", metavar="N", what="stop after so much time of the sensor", kind=options.seconds)
    options.add(
        parser, "--every", metavar="N", what="time from one look to the next, default 1 s", kind=options.seconds
    )
    link_options.add_reading(parser)
    options.add_json(parser)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Look at the sensor's epochs, and show their health now and then; Ctrl-C is the usual end."""
    kind, where = link_options.chosen(arguments)
    site = sites.load(options.required(arguments.site, "--site", "FILE"))

    from goldfield.cli.output import json_line  # heavy: only when a sensor is looked at
    from goldfield.sensor.opening import open_sensor
    from goldfield.view.monitor import Monitor, RosterRecorder

    recorder = RosterRecorder()
    monitor = Monitor(site, where, recorder.roster)
    line_of = (lambda: json_line(monitor.record())) if arguments.json else monitor.line
    show = Screen(monitor.table) if sys.stdout.isatty() and not arguments.json else Lines(line_of)
    cycles, number = max(1, round((arguments.every or 1.0) / site.cycle_s)), 0
    try:
        with open_sensor(kind, where, site, link_options.reading(arguments), recorder) as sensor:
            for number, epoch in enumerate(sensor.epochs(), start=1):
                monitor.node = sensor.node
                monitor.add(epoch)
                if number % cycles == 0:
                    show()
        if number % cycles:
            show()  # what a recording, or --seconds, ends with
    except KeyboardInterrupt:
        pass
    return 0


class Lines:
    """Prints a text as it is each time."""

    def __init__(self, text: Callable[[], str]) -> None:
        self._text = text

    def __call__(self) -> None:
        """Print."""
        print(self._text(), flush=True)


class Screen:
    """Draws a text where it stood before.

    Parameters
    ----------
    text : callable
        Returns the text, of lines that fit the terminal.
    """

    def __init__(self, text: Callable[[], str]) -> None:
        self._text = text
        self._lines = 0

    def __call__(self) -> None:
        """Draw."""
        columns, rows = shutil.get_terminal_size()
        lines = [line[:columns] for line in self._text().splitlines()[: rows - 1]]  # what scrolls cannot be drawn over
        up = f"\x1b[{self._lines}A\x1b[J" if self._lines else ""
        self._lines = len(lines)
        print(up + "\n".join(lines), flush=True)
