"""``goldfield run``: live poses from a sensor, or from a recorded log."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import sys
from collections.abc import Iterator, Mapping
from typing import Any

from goldfield import site as sites
from goldfield.cli import options
from goldfield.cli.fields_file import FieldsWriter
from goldfield.cli.on_sensor import add_on_sensor, check_on_sensor
from goldfield.cli.output import json_line, number, pose_record
from goldfield.cli.tracking import add_track, locating
from goldfield.errors import UserError
from goldfield.link.buses import BusSource, LogSource, Source, open_can, open_port
from goldfield.link.recordings import CandumpReader, CandumpWriter
from goldfield.link.reports import SHORTEST_SILENCE_S, Assembler, Report
from goldfield.sensor.session import Session
from goldfield.site import Site
from goldfield_protocol.parameters import PARAMETERS, counter_name

SOURCES = ("port", "can", "log")


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "run",
        description="Poses from a sensor on a serial port or CAN, or from a recorded log: a line for every epoch.",
    )
    for name, metavar, what in (
        ("--port", "PATH", "serial port of the sensor"),
        ("--can", "INTERFACE:CHANNEL", "python-can interface and channel, as socketcan:can0"),
        ("--log", "FILE", "candump log instead of a sensor"),
    ):
        parser.add_argument(
            name,
            metavar=metavar,
            help=f"{what} (environment: {options.environment_name(name)}, unless another is given)",
        )
    options.add_site(parser)
    add_track(parser)
    add_on_sensor(parser)
    options.add_json(parser)
    options.add(parser, "--record", metavar="FILE", what="write every message received to a candump log")
    options.add(parser, "--fields", metavar="FILE", what="write the separated fields to a table for goldfield locate")
    options.add(parser, "--seconds", metavar="N", what="stop after so much time of the sensor", kind=options.seconds)
    options.add(parser, "--truth", metavar="FILE", what="the simulator's truth, to compare with")
    options.add(parser, "--node", metavar="N", what="node of the sensor (else the first one heard)", kind=options.node)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print a line for every epoch, and a summary."""
    kind, where = _choose_source(arguments)
    site = sites.load(options.required(arguments.site, "--site", "FILE"))
    if arguments.on_sensor:
        check_on_sensor(site, arguments.track)
    with contextlib.ExitStack() as stack:
        recorder = None
        if arguments.record:
            recorder = CandumpWriter(arguments.record)
            stack.callback(recorder.close)
        source: Source = LogSource(CandumpReader(where)) if kind == "log" else _open_bus(kind, where)
        stack.callback(source.close)
        assembler = Assembler(silence_s=max(SHORTEST_SILENCE_S, 8.0 * site.cycle_s), own_pose=arguments.on_sensor)
        session = Session(source, where, assembler, arguments.node, recorder)
        if isinstance(source, BusSource):
            session.find_sensor()
            session.check_degree(source, site.degree)
            session.configure(source, site.codes, _parameters(arguments, site))
        return _print_poses(arguments, site, session, live=isinstance(source, BusSource))


def _parameters(arguments: argparse.Namespace, site: Site) -> Mapping[int, int | float]:
    """Return what the sensor must know beside the codes."""
    from goldfield.sensor.onboard import onboard_parameters
    from goldfield.track.parts import PARTS, sensor_sends_parts

    if arguments.on_sensor:
        return onboard_parameters(site)
    return {PARAMETERS["parts"].first: PARTS} if arguments.track and sensor_sends_parts(site) else {}


def _open_bus(kind: str, where: str) -> BusSource:
    return open_port(where) if kind == "port" else open_can(where)


def _print_poses(arguments: argparse.Namespace, site: Site, session: Session, live: bool) -> int:
    from goldfield.access.epoch import EpochSeparator  # heavy: only when a pose is wanted
    from goldfield.access.sweep import SweepRepair
    from goldfield.sensor.onboard import onboard_pose
    from goldfield.track.parts import cycle_of_parts
    from goldfield.view.terminal import PoseTable, Summary
    from goldfield.view.truth import NO_ERROR, Truth

    separator = EpochSeparator(site)
    sweep = SweepRepair(site)
    locate = locating(site, arguments.track)
    truth = Truth(arguments.truth) if arguments.truth else None
    writer = FieldsWriter(arguments.fields) if arguments.fields else None
    table = PoseTable(live=True, truth=truth is not None)
    summary = Summary()
    try:
        for report in _limited(session.reports(live), arguments.seconds, site.cycle_s):
            fields = sweep.repaired(separator.fields(report), report.offset_T if report.chips == site.chips else None)
            if writer is not None:
                writer.write(fields)
            if arguments.on_sensor:
                pose = onboard_pose(site, report, fields)
            else:
                pose = locate(fields, cycle_of_parts(site, report, fields.time_s))
            error = NO_ERROR if truth is None else truth.error_of(pose)
            lost = report.lost(expected_fields=len(site.codes))
            summary.add(pose, error, lost)
            if arguments.json:
                record = pose_record(pose) | {
                    "lost": lost,
                    "chips": report.chips,
                    "saturated": report.saturated,
                    "locked": report.locked,
                }
                if truth is not None:
                    record |= {
                        "position_error_m": number(error.position_m),
                        "attitude_error_rad": number(error.attitude_rad),
                    }
                print(json_line(record), flush=True)
            else:
                print(table.line(pose, error, lost, _note(report, site)), flush=True)
    except KeyboardInterrupt:
        pass  # the usual end of a live run
    finally:
        summary.bad_frames = session.bad_frames
        summary.missed_cycles = session.assembler.missed_cycles
        summary.counters = {counter_name(number): count for number, count in sorted(session.counters.items()) if count}
        if summary.epochs:
            print(summary.text(truth is not None), file=sys.stderr if arguments.json else sys.stdout, flush=True)
        for file in (truth, writer):
            if file is not None:
                file.close()
    if not summary.epochs and not live:
        raise UserError(f"{session.name}: holds no cycle of a sensor")
    return 0


def _note(report: Report, site: Site) -> str:
    """Say what the sensor says was wrong with the cycle."""
    notes = []
    if report.locked is False:
        notes.append("not synchronised")
    if report.chips is not None and report.chips < site.chips:
        notes.append(f"{site.chips - report.chips} chips lost")
    if report.saturated:
        notes.append(f"{report.saturated} chips saturated")
    return ", ".join(notes)


def _limited(reports: Iterator[Report], seconds: float | None, cycle_s: float) -> Iterator[Report]:
    """Yield the reports that fill so much time of the sensor, to the nearest cycle."""
    first = math.nan
    for report in reports:
        yield report
        if math.isnan(first):
            first = report.time_s
        if seconds is not None and report.time_s - first >= seconds - 1.5 * cycle_s:
            return


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
