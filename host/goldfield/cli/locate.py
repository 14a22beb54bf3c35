"""``goldfield locate``: a pose for every epoch of a table of fields, with no prior or tracked."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import Any

from goldfield.cli import options
from goldfield.cli.location_options import add_alert_limit, add_track, site_of
from goldfield.cli.output import json_line, pose_record
from goldfield.errors import UserError
from goldfield.files.outputs import check_outputs
from goldfield.sensor.fields_table import COLUMNS, read_fields
from goldfield.site import Site
from goldfield.types import Fields, Pose


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "locate",
        description=f"A pose for every epoch of a CSV table with the columns {','.join(COLUMNS)}[,sigma_T] "
        "(sensor frame; an empty cell is an axis that was not measured; the rows of an epoch follow each other); "
        "- is stdin.",
    )
    parser.add_argument("fields", metavar="FIELDS.csv", help="table of fields")
    options.add_site(parser)
    add_track(parser)
    add_alert_limit(parser)
    options.add(
        parser,
        "--own-body",
        metavar="BODY.toml",
        what="conductors that move with the sensor, whose eddy currents and magnetisation are taken off",
    )
    options.add(
        parser,
        "--workers",
        metavar="N",
        kind=options.count,
        what="processes of this machine that compute, for long tables (default: 1)",
    )
    options.add(
        parser,
        "--scheduler",
        metavar="ADDRESS",
        what="address of a Dask scheduler whose workers compute instead, such as tcp://10.0.0.1:8786",
    )
    options.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print a line for every epoch, whatever happens, and below a table a summary."""
    from goldfield.view.summary import Summary
    from goldfield.view.terminal import PoseTable

    inputs = {"--site": arguments.site, "FIELDS.csv": arguments.fields, "--own-body": arguments.own_body}
    check_outputs({}, inputs)
    site = site_of(arguments)
    options.tell_assumed(site)
    table, summary = PoseTable(), Summary()
    for pose in _poses(site, arguments):
        summary.add(pose)
        print(json_line(pose_record(pose)) if arguments.json else table.line(pose))
    if not arguments.json:
        print(summary.text(truth=False))
    return 0


def _poses(site: Site, arguments: argparse.Namespace) -> Iterator[Pose]:
    """Yield the pose of each epoch of the table."""
    epochs = read_fields(site, arguments.fields)
    if arguments.own_body or arguments.track:
        options.tell_idle(arguments, ("--workers", "--scheduler"), "--own-body" if arguments.own_body else "--track")
    elif arguments.scheduler or (arguments.workers or 1) > 1:
        from goldfield.sensor.spread_location import spread_poses  # heavy: only when work is spread

        if arguments.scheduler:
            options.tell_idle(arguments, ("--workers",), "--scheduler")
        return spread_poses(site, epochs, workers=arguments.workers or 1, scheduler=arguments.scheduler)
    return map(_beside_body(site, arguments) if arguments.own_body else _location(site, arguments.track), epochs)


def _location(site: Site, track: bool) -> Callable[[Fields], Pose]:
    from goldfield.sensor.location import location  # heavy: only when a pose is wanted
    from goldfield.sensor.options import Method

    locate = location(site, Method.TRACK if track else Method.EACH)
    return lambda fields: locate(fields, None)


def _beside_body(site: Site, arguments: argparse.Namespace) -> Callable[[Fields], Pose]:
    """Return what locates each epoch beside the conductors of a file."""
    from goldfield.field.conductor import body_file
    from goldfield.locate import Locator
    from goldfield.locate.own_body import OwnBody, locate_beside
    from goldfield.sensor.guard import guarded
    from goldfield.sensor.location import Succession

    if arguments.track:
        raise UserError("--own-body and --track are both given: the tracker knows nothing of a body; leave one out")
    conductors = body_file.load(arguments.own_body)
    try:
        body = OwnBody(site, conductors)
    except UserError as error:
        raise UserError(f"{arguments.own_body}: {error}") from error
    locator, succession = Locator(site), Succession()
    return lambda fields: succession.follow(guarded(lambda epoch: locate_beside(locator, body, epoch), fields))
