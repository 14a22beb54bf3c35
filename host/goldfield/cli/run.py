"""``goldfield run``: live poses from a sensor, or from a recorded log."""

from __future__ import annotations

import argparse
import os
from typing import Any

from goldfield.cli import options
from goldfield.cli.location_options import add_alert_limit, add_on_sensor, add_track, site_of
from goldfield.errors import UserError, on_command_line
from goldfield.files.outputs import check_outputs
from goldfield.sensor.options import SOURCES


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "run",
        help="live poses from a sensor",
        description="Poses from a sensor on a serial port or CAN, or from a recorded log: a line for every epoch.",
    )
    for name, metavar, what in (
        ("--port", "PATH", "serial port of the sensor"),
        ("--can", "INTERFACE:CHANNEL", "python-can interface and channel, as socketcan:can0"),
        (
            "--log",
            "FILE",
            "recording instead of a sensor: of candump, or .asc, .blf, .csv, .db, .mf4, .trc; - is stdin",
        ),
    ):
        parser.add_argument(
            name,
            metavar=metavar,
            help=f"{what} (environment: {options.environment_name(name)}, unless another is given)",
        )
    options.add_site(parser)
    add_track(parser)
    add_on_sensor(parser)
    add_alert_limit(parser)
    options.add_json(parser)
    options.add(parser, "--record", metavar="FILE", what="write every message received to a candump log")
    options.add(parser, "--fields", metavar="FILE", what="write the separated fields to a table for goldfield locate")
    options.add_force(parser)
    options.add(parser, "--seconds", metavar="N", what="stop after so much time of the sensor", kind=options.seconds)
    options.add(parser, "--truth", metavar="FILE", what="the simulator's truth, to compare with")
    options.add(parser, "--node", metavar="N", what="node of the sensor, where there are several", kind=options.node)
    options.add(parser, "--channel", metavar="NAME", what="channel of the sensor, in a log of several buses")
    options.add_switch(parser, "--listen-only", what="send nothing, ever: for a bus on which a recording is replayed")
    options.add_switch(parser, "--reconnect", what="wait for a port that is gone or a sensor that is silent, and go on")
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Print a line for every epoch, and a summary."""
    from goldfield.cli.live import print_poses  # heavy: only when a pose is wanted

    kind, where = _choose_source(arguments)
    site = options.required(arguments.site, "--site", "FILE")
    inputs = {"--site": site, "--log": where if kind == "log" else None, "--truth": arguments.truth}
    check_outputs({"--record": arguments.record, "--fields": arguments.fields}, inputs, force=arguments.force)
    known = site_of(arguments)
    options.tell_assumed(known)
    return print_poses(arguments, kind, where, known)


def _choose_source(arguments: argparse.Namespace) -> tuple[str, str]:
    """Return which of the sources is wanted: the command line's, else the environment's."""
    given = [(name, getattr(arguments, name)) for name in SOURCES if getattr(arguments, name) is not None]
    if not given:
        names = {name: options.environment_name(f"--{name}") for name in SOURCES}
        given = [(name, os.environ[variable]) for name, variable in names.items() if os.environ.get(variable)]
    if len(given) != 1:
        raise UserError(
            f"{'no source is' if not given else 'more than one source is'} given: "
            "give one of --port PATH, --can INTERFACE:CHANNEL and --log FILE"
        )
    kind, where = given[0]
    if not where:
        raise UserError(f"--{kind} is empty: give a value")
    return kind, where
