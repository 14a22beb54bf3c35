"""``goldfield locate``: a pose for every epoch of a table of fields, with no prior or tracked."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from goldfield import site as sites
from goldfield.cli import options
from goldfield.cli.fields_file import COLUMNS, SIGMA_COLUMN
from goldfield.cli.output import json_line, pose_record
from goldfield.cli.tracking import add_track, locating
from goldfield.errors import UserError
from goldfield.files.csv_table import Row, read_groups
from goldfield.site import Site
from goldfield.types import Fields, Pose

if TYPE_CHECKING:
    from goldfield.track import CycleData


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "locate",
        description=f"A pose for every epoch of a CSV table with the columns {','.join(COLUMNS)}[,sigma_T] "
        "(sensor frame; an empty cell is an axis that was not measured; the rows of an epoch follow each other).",
    )
    parser.add_argument("fields", metavar="FIELDS.csv", help="table of fields")
    options.add_site(parser)
    add_track(parser)
    options.add(
        parser,
        "--own-body",
        metavar="BODY.toml",
        what="conductors that move with the sensor, whose eddy currents and magnetisation are taken off",
    )
    options.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print a line for every epoch, whatever happens."""
    from goldfield.view.terminal import PoseTable

    site = sites.load(options.required(arguments.site, "--site", "FILE"))
    table = PoseTable()
    locate = _beside(site, arguments) if arguments.own_body else locating(site, arguments.track)
    for fields in read_fields(site, arguments.fields):
        pose = locate(fields, None)
        print(json_line(pose_record(pose)) if arguments.json else table.line(pose))
    return 0


def _beside(site: Site, arguments: argparse.Namespace) -> Callable[[Fields, CycleData | None], Pose]:
    """Return what locates each epoch beside the conductors of a file."""
    from goldfield.field.conductor import body_file
    from goldfield.locate import Locator
    from goldfield.locate.own_body import OwnBody, locate_beside
    from goldfield.sensor.guard import guarded

    if arguments.track:
        raise UserError("--own-body and --track are both given: the tracker knows nothing of a body; leave one out")
    conductors = body_file.load(arguments.own_body)
    try:
        body = OwnBody(site, conductors)
    except UserError as error:
        raise UserError(f"{arguments.own_body}: {error}") from error
    locator = Locator(site)
    return lambda fields, _: guarded(lambda epoch: locate_beside(locator, body, epoch), fields)


def read_fields(site: Site, path: str) -> Iterator[Fields]:
    """Yield the epochs of a table of fields.

    Raises
    ------
    UserError
        With file, line and column of whatever is wrong.
    """
    for rows in read_groups(path, "epoch", COLUMNS, (SIGMA_COLUMN,)):
        yield _fields(site, rows)


def _fields(site: Site, rows: list[Row]) -> Fields:
    """Check and join the rows of one epoch."""
    default_sigma = site.sensor.noise_T / math.sqrt(site.chips)
    known = [beacon.id for beacon in site.beacons]
    time_s = rows[0].number("t_s")
    beacons: list[str] = []
    field, sigma = np.empty((len(rows), 3)), np.empty(len(rows))
    for place, row in enumerate(rows):
        if row.number("t_s") != time_s:
            raise row.error("t_s", f"differs from the {time_s:g} of the same epoch's first row (line {rows[0].line})")
        beacon = row.text("beacon")
        if beacon not in known:
            raise row.error("beacon", f"{beacon!r} is not in the site {site.name!r}: it has {', '.join(known[:10])}")
        if beacon in beacons:
            raise row.error("beacon", f"{beacon!r} comes twice in the epoch")
        beacons.append(beacon)
        field[place] = [row.field(column) for column in COLUMNS[3:]]
        if row.cells.get(SIGMA_COLUMN, "").strip():
            sigma[place] = row.number(SIGMA_COLUMN)
            if not 0.0 < sigma[place] < 1.0:
                raise row.error(SIGMA_COLUMN, f"is {sigma[place]:g}; it must be greater than zero and below 1 T")
        else:
            sigma[place] = default_sigma
    return Fields(rows[0].whole("epoch"), time_s, tuple(beacons), field, sigma)
