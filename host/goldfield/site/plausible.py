"""What the numbers of a site file can be: values in millimetres, milliamperes or milligauss are told from SI units.

A number that no site has is refused; one that few sites have is a doubt, which the commands tell on stderr. Both
sentences name the unit that would make the number usual.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from goldfield.files.toml_table import Table
from goldfield.site.model import Beacon
from goldfield.types import FloatArray


@dataclass(frozen=True)
class Range:
    """The range of a quantity.

    Attributes
    ----------
    unit : str
    least, most : float
        Sizes outside these are refused.
    usual : tuple of (float, float)
        Sizes outside these are doubted.
    others : mapping of str to float
        Units that people take by mistake, and what they are in the right one.
    """

    unit: str
    least: float
    most: float
    usual: tuple[float, float]
    others: Mapping[str, float] = field(default_factory=dict)

    def hint(self, value: float) -> str:
        """Return what the value would be in the units that make it usual; empty if none does."""
        low, high = self.usual
        inside = {name: value * size for name, size in self.others.items() if low <= abs(value) * size <= high}
        return "".join(f"; if it is in {name}, that is {number:g} {self.unit}" for name, number in inside.items())


LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2}
RANGES = {
    "chip_period_s": Range("s", 1e-6, 1.0, (5e-6, 5e-3), {"microseconds": 1e-6, "milliseconds": 1e-3}),
    "noise_T": Range(
        "T", 1e-16, 1e-3, (1e-15, 2e-5), {"milligauss": 1e-7, "gauss": 1e-4, "microtesla": 1e-6, "nanotesla": 1e-9}
    ),
    "hum_Hz": Range("Hz", 1.0, 1e4, (16.0, 1000.0), {"kilohertz": 1e3}),
    "radius_m": Range("m", 1e-4, 100.0, (1e-3, 10.0), LENGTHS),
    "sides_m": Range("m", 1e-4, 100.0, (1e-3, 10.0), LENGTHS),
    "length_m": Range("m", 1e-5, 100.0, (1e-4, 10.0), LENGTHS),
    "pitch_m": Range("m", 1e-6, 10.0, (1e-5, 0.2), LENGTHS),
    "layer_pitch_m": Range("m", 1e-6, 10.0, (1e-5, 0.2), LENGTHS),
    "current_A": Range("A", 1e-9, 1e4, (1e-6, 200.0), {"milliamperes": 1e-3}),
    "turns": Range("turns", 1e-3, 1e6, (0.1, 1e5)),
    "alert_limit_m": Range("m", 1e-6, 1e4, (1e-3, 20.0), LENGTHS),
    "ambient_gradient_T_m": Range("T/m", 1e-9, 1e-2, (1e-7, 1e-4), {"microtesla a metre": 1e-6}),
}
"""The ranges by the key of the site file.

A chip of a microsecond is no longer sampled, one of a second makes a cycle of minutes. Noise of a millitesla hides the
earth's field twenty times over. Coils of 100 m and currents of 10 kA are none that anybody drives with codes.
"""

POSITION = Range("m", 0.0, 1e6, (0.0, 1e5), LENGTHS)
"""Distance of a beacon from the origin: a survey's grid may lie far off, the beacons near each other."""
EXTENT = Range("m", 0.0, 2000.0, (0.0, 100.0), LENGTHS)
"""Distance of a beacon from the one next to it: at 100 m a coil of 13 A m^2 makes 3 pT."""
MOST_POINTS = 10_000
"""Points of one coil's wire: the field of more takes minutes to compute."""


def checked(table: Table, key: str, value: float, doubts: list[str]) -> float:
    """Return a value of a site file that is in its range.

    Parameters
    ----------
    table : Table
    key : str
        One of `RANGES`.
    value : float
        Its size counts; zero is the reader's to judge.
    doubts : list of str
        Gets a sentence if the value is an unusual one.

    Raises
    ------
    UserError
        If it is out of range.
    """
    known, size = RANGES[key], abs(value)
    low, high = known.usual
    if not known.least <= size <= known.most:
        within = f"the range is {known.least:g} to {known.most:g} {known.unit}"
        raise table.error(key, f"is {value:g} {known.unit}, which no site has: {within}{known.hint(value)}")
    if not low <= size <= high:
        doubts.append(str(table.error(key, f"is {value:g} {known.unit}, which is unusual{known.hint(value)}")))
    return value


def check_place(table: Table, key: str, points_m: FloatArray) -> None:
    """Check where a coil is, and how many points its wire has.

    Parameters
    ----------
    table : Table
    key : str
        ``position_m`` or ``points_m``.
    points_m : ndarray, shape (3,) or (n, 3)

    Raises
    ------
    UserError
        If a coordinate is out of range, or the points are too many.
    """
    if points_m.ndim == 2 and len(points_m) > MOST_POINTS:
        raise table.error(key, f"has {len(points_m)} points; give at most {MOST_POINTS}: leave out those on a line")
    farthest = float(np.abs(points_m).max())
    if farthest > POSITION.most:
        raise table.error(
            key, f"has a coordinate of {farthest:g} m; coordinates are at most {POSITION.most:g} m from the origin"
        )


def check_extent(tables: Sequence[Table], beacons: Sequence[Beacon], doubts: list[str]) -> None:
    """Check that each beacon has another one near, as the fields of coils need.

    Raises
    ------
    UserError
        If one is out of all reach.
    """
    if len(beacons) < 2:
        return
    places = np.array([beacon.position_m for beacon in beacons])
    gaps = np.array([np.partition(np.linalg.norm(places - place, axis=1), 1)[1] for place in places])
    row = int(np.argmax(gaps))
    gap = float(gaps[row])
    if gap <= EXTENT.usual[1]:
        return
    key = "position_m" if "position_m" in tables[row] else "points_m"
    what = f"is {gap:g} m from the next beacon"
    if gap > EXTENT.most:
        raise tables[row].error(key, f"{what}, farther than any field reaches{EXTENT.hint(gap)}")
    doubts.append(str(tables[row].error(key, f"{what}, which is unusual{EXTENT.hint(gap)}")))
