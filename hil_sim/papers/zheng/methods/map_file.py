"""Fingerprint maps as files: CSV, one row a point and beacon, so that a spreadsheet can read and mend them.

Columns ``point,x_m,y_m,z_m,beacon,strength_T``: a whole number that counts the points, the point in the site's frame,
the beacon's id, and the root mean square of |B| over a turn. Every point has every beacon once.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from goldfield.errors import UserError, counted
from goldfield.files.csv_table import Row, read_table
from goldfield.files.outputs import write_file
from hil_sim.papers.zheng.methods.fingerprint import NEIGHBOURS, FingerprintMap

COLUMNS = ("point", "x_m", "y_m", "z_m", "beacon", "strength_T")


def save(fingerprints: FingerprintMap, path: str | Path, *, force: bool = False) -> None:
    """Write a map; the errors are those of `goldfield.files.outputs.OutputFile`.

    Parameters
    ----------
    fingerprints : FingerprintMap
    path : path
    force : bool
        Whether it may replace a file that holds something.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for point, (place, strengths) in enumerate(zip(fingerprints.position_m, fingerprints.strength_T, strict=True)):
        where = [repr(float(value)) for value in place]
        for beacon, strength in zip(fingerprints.beacons, strengths, strict=True):
            writer.writerow([point, *where, beacon, repr(float(strength))])
    write_file(path, text.getvalue().encode(), "the map", force=force)


def load(path: str | Path, beacons: tuple[str, ...]) -> FingerprintMap:
    """Read a map of a site's beacons.

    Parameters
    ----------
    path : str or Path
    beacons : tuple of str
        Ids of the site, which give the columns' order.

    Raises
    ------
    UserError
        If anything is wrong; the sentence names file, line and column.
    """
    places: dict[int, tuple[float, float, float]] = {}
    strengths: dict[int, dict[str, float]] = {}
    last: dict[int, Row] = {}
    for row in read_table(path, COLUMNS):
        point, beacon = row.whole("point"), row.text("beacon")
        place = row.number("x_m"), row.number("y_m"), row.number("z_m")
        if beacon not in beacons:
            raise row.error("beacon", f'"{beacon}" is not in the site: it has {", ".join(beacons)}')
        if places.setdefault(point, place) != place:
            raise row.error("point", f"{point} stands elsewhere than in its rows before: number the points apart")
        of_point = strengths.setdefault(point, {})
        if beacon in of_point:
            raise row.error("beacon", f'"{beacon}" comes twice at point {point}')
        of_point[beacon] = row.number("strength_T")
        if not 0.0 < of_point[beacon] < 1.0:
            raise row.error("strength_T", f"is {of_point[beacon]:g}; it must be greater than zero and below 1 T")
        last[point] = row
    for point, of_point in strengths.items():
        for beacon in beacons:
            if beacon not in of_point:
                raise last[point].error("point", f'{point} has no row for the beacon "{beacon}": measure it, too')
    if len(places) < NEIGHBOURS:
        raise UserError(f"{path}: has {counted(len(places), 'points')}; the algorithms need at least {NEIGHBOURS}")
    return FingerprintMap(
        beacons,
        np.array(list(places.values())),
        np.array([[of_point[beacon] for beacon in beacons] for of_point in strengths.values()]),
    )
