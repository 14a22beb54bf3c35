"""``goldfield separate``: the field of each beacon from raw samples of the sum field."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np

from goldfield import site as sites
from goldfield.access.cdma import Separation, Separator
from goldfield.cli import options
from goldfield.cli.output import elements, json_line, number
from goldfield.errors import UserError
from goldfield.poses import FloatArray
from goldfield.site import Site
from goldfield.tables import read_table

COLUMNS = ("chip", "bx_T", "by_T", "bz_T")


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "separate",
        help="field of each beacon from raw samples",
        description=f"The field of each beacon from a CSV table with the columns {','.join(COLUMNS)}: one row a chip "
        "from chip 0 (counting on or beginning again at every cycle), an empty cell is a sample that is missing.",
    )
    parser.add_argument("samples", metavar="SAMPLES.csv", help="table of samples")
    options.add_site(parser)
    options.add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print a line for every cycle."""
    site = sites.load(options.required(arguments.site, "--site", "FILE"))
    try:
        separator = Separator(site.degree, site.codes, site.sensor.noise_T)
    except UserError as error:
        raise UserError(f"{arguments.site}: {error}") from error
    for cycle, samples in enumerate(read_cycles(site, arguments.samples)):
        separation = separator.from_samples(samples)
        if arguments.json:
            print(json_line(separation_record(site, cycle, separation)))
        else:
            print(_table(site, cycle, separation))
    return 0


def separation_record(site: Site, cycle: int, separation: Separation) -> dict[str, Any]:
    """Return a separated cycle under the keys of ``goldfield separate --json``."""
    return {
        "cycle": cycle,
        "offset_T": elements(separation.offset_T),
        "fields": [
            {"beacon": beacon.id, "b_T": elements(field), "sigma_T": number(sigma)}
            for beacon, field, sigma in zip(site.beacons, separation.field_T, separation.sigma_T, strict=True)
        ],
    }


def read_cycles(site: Site, path: str) -> Iterator[FloatArray]:
    """Yield the samples of each cycle, shape (N, 3).

    Raises
    ------
    UserError
        With file, line and column of whatever is wrong, and if there is no whole cycle.
    """
    samples = np.empty((site.chips, 3))
    count = 0
    for row in read_table(path, COLUMNS):
        chip = row.whole("chip")
        expected = count % site.chips
        if chip not in (expected, count):
            raise row.error("chip", f"is {chip} where {expected} follows: give every chip in order from chip 0")
        samples[expected] = [row.field(column) for column in COLUMNS[1:]]
        count += 1
        if count % site.chips == 0:
            yield samples
    cycles, rest = divmod(count, site.chips)
    if cycles == 0:
        raise UserError(f"{path}: has {count} chips, fewer than a cycle's {site.chips} (degree {site.degree})")
    if rest:
        print(f"goldfield: {path}: the last {rest} chips are no whole cycle and were left out", file=sys.stderr)


def _table(site: Site, cycle: int, separation: Separation) -> str:
    def components(vector: FloatArray) -> str:
        return " ".join(f"{value * 1e9:12.3f}" if np.isfinite(value) else f"{'-':>12}" for value in vector)

    width = max(8, *(len(beacon.id) for beacon in site.beacons))
    lines = [f"cycle {cycle}", f"  {'nT':<{width}} {'x':>12} {'y':>12} {'z':>12} {'sigma':>10}"]
    lines.append(f"  {'offset':<{width}} {components(separation.offset_T)}")
    for beacon, field, sigma in zip(site.beacons, separation.field_T, separation.sigma_T, strict=True):
        lines.append(f"  {beacon.id:<{width}} {components(field)} {sigma * 1e9:10.3f}")
    return "\n".join(lines)
