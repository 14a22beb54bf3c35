"""``goldfield rotating survey|locate|simulate``: a map of fingerprints from samples, and poses with or without it."""

from __future__ import annotations

import argparse
import csv
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.access.rotating import RotatingSeparation, RotatingSeparator, separate_by_fft
from goldfield.cli import rotating_options
from goldfield.cli.output import elements, json_line, number
from goldfield.errors import UserError
from goldfield.poses import FloatArray
from goldfield.rotating_site import RotatingSite
from goldfield.tables import Row, read_groups

SAMPLES = ("window", "t_s", "bx_T", "by_T", "bz_T")
PLACE = ("x_m", "y_m", "z_m")
COLUMNS_HELP = (
    f"CSV with the columns {','.join(SAMPLES)}[,{','.join(PLACE)}], one row a sample; a window is one standing place, "
    "its rows follow each other; t_s is on the beacons' clock"
)
EVEN = 1e-4
"""Steps of time that differ by less than this part of themselves are even: what is left by printing the times."""
ALGORITHMS = ("ellipse", "lines", "regions", "nearest", "local")
"""Ours; the paper's 1 with global lines and with those of regions; its 2; its 3 as intended."""


@dataclass(frozen=True, eq=False)
class Window:
    """The separated fields of one standing place.

    Attributes
    ----------
    window : int
    field_T : ndarray, shape (1, n, 2, 3)
    sigma_T : ndarray, shape (n,)
    place_m : ndarray, shape (3,), or None
        Where the table says the sensor stood.
    """

    window: int
    field_T: FloatArray
    sigma_T: FloatArray
    place_m: FloatArray | None


def add_actions(actions: Any) -> None:
    """Add the actions."""
    survey = actions.add_parser(
        "survey",
        help="a map of fingerprints from samples at known places",
        description=f"Writes a map of fingerprints. SAMPLES: {COLUMNS_HELP}; here the places are needed.",
    )
    survey.add_argument("samples", metavar="SAMPLES.csv")
    survey.add_argument("--map", required=True, metavar="MAP.csv", help="to write: point,x_m,y_m,z_m,beacon,strength_T")
    _add_separation(survey)
    rotating_options.add_site(survey)
    survey.set_defaults(run=run_survey)

    locate = actions.add_parser(
        "locate",
        help="poses from samples, with or without a map",
        description=f"A pose a window. SAMPLES: {COLUMNS_HELP}; where they have places, errors are shown.",
    )
    locate.add_argument("samples", metavar="SAMPLES.csv")
    locate.add_argument("--map", metavar="MAP.csv", help="of goldfield rotating survey; ellipse needs none")
    locate.add_argument("--algorithm", choices=ALGORITHMS, default="ellipse", help="default ellipse: all components")
    _add_separation(locate)
    rotating_options.add_site(locate)
    rotating_options.add_json(locate)
    locate.set_defaults(run=run_locate)

    simulate = actions.add_parser(
        "simulate", help="samples of a simulated room", description="Writes samples to try survey and locate with."
    )
    simulate.add_argument("samples", metavar="SAMPLES.csv", help="to write")
    kind = simulate.add_mutually_exclusive_group(required=True)
    kind.add_argument("--grid", action="store_true", help="level, at the places of a survey, every 0.5 m")
    kind.add_argument("--targets", type=rotating_options.count, metavar="N", help="at random places")
    simulate.add_argument(
        "--tilt-deg", type=rotating_options.positive, metavar="D", help="turned, tilted up to so much"
    )
    rotating_options.add_site(simulate)
    rotating_options.add_world(simulate)
    simulate.set_defaults(run=run_simulate)


def _add_separation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--separation",
        choices=("least-squares", "fft"),
        default="least-squares",
        help="least-squares (default) takes any window; fft, the paper's, only whole periods of every beacon",
    )


def run_survey(arguments: argparse.Namespace) -> int:
    """Build and save a map."""
    from goldfield.field.rotating import rms_strength
    from goldfield.locate.rotating import map_file
    from goldfield.locate.rotating.fingerprint import FingerprintMap

    site = rotating_options.site(arguments, 3)
    places, strengths = [], []
    for window in read_windows(site, arguments.samples, arguments.separation):
        if window.place_m is None:
            raise UserError(f"{arguments.samples}: has no places: a survey needs the columns {','.join(PLACE)}")
        places.append(window.place_m)
        strengths.append(rms_strength(window.field_T)[0])
    names = tuple(beacon.id for beacon in site.beacons)
    map_file.save(FingerprintMap(names, np.array(places), np.array(strengths)), arguments.map)
    print(f"{arguments.map}: {len(places)} points, {len(names)} beacons")
    return 0


def run_locate(arguments: argparse.Namespace) -> int:
    """Print a line a window."""
    from goldfield.field.rotating import rms_strength
    from goldfield.locate.rotating import map_file
    from goldfield.locate.rotating.attitude import attitude_from_normals
    from goldfield.locate.rotating.ellipse import locate_by_ellipse
    from goldfield.locate.rotating.fingerprint import LineLocator, nearest_neighbours

    site = rotating_options.site(arguments, 3)
    algorithms = {}
    if arguments.algorithm != "ellipse":
        if arguments.map is None:
            raise UserError(f"--map is missing: {arguments.algorithm} needs a map of goldfield rotating survey")
        fingerprints = map_file.load(arguments.map, tuple(beacon.id for beacon in site.beacons))
        lines = LineLocator(site.position_m, fingerprints, site.up)
        algorithms = {
            "lines": lines.by_global_lines,
            "regions": lines.by_region_lines,
            "nearest": lambda strength: nearest_neighbours(fingerprints, strength),
            "local": lines.by_local_lines,
        }
    if not arguments.json:
        print(
            f"{'window':>6} {'x m':>9} {'y m':>9} {'z m':>9} {'roll':>7} {'pitch':>7} {'yaw deg':>8} {'residual':>9} "
            "error m"
        )
    for window in read_windows(site, arguments.samples, arguments.separation):
        residual = None
        if arguments.algorithm == "ellipse":
            fit = locate_by_ellipse(site, window.field_T, window.sigma_T)
            position, rotation = fit.position_m, fit.rotation
            residual = number(float(np.sqrt(fit.cost[0] / (6 * len(site.beacons) - 6))))
        else:
            position = algorithms[arguments.algorithm](rms_strength(window.field_T))
            rotation = attitude_from_normals(site, position, window.field_T)
        turned = Rotation.from_matrix(rotation[0])
        error = None if window.place_m is None else number(float(np.linalg.norm(position[0] - window.place_m)))
        if arguments.json:
            record = {
                "window": window.window,
                "position_m": elements(position[0]),
                "orientation_xyzw": elements(turned.as_quat(canonical=True)),
                "residual": residual,
                "error_m": error,
            }
            print(json_line(record))
        else:
            yaw, pitch, roll = turned.as_euler("ZYX", degrees=True)
            cells = " ".join(f"{value:9.4f}" for value in position[0])
            fitted = f"{'':9}" if residual is None else f"{residual:9.2f}"
            print(
                f"{window.window:6d} {cells} {roll:7.2f} {pitch:7.2f} {yaw:8.2f} {fitted} "
                f"{'' if error is None else f'{error:.4f}'}"
            )
    return 0


def run_simulate(arguments: argparse.Namespace) -> int:
    """Write simulated samples."""
    from goldfield.experiments.rotating_room import Room
    from goldfield.experiments.worlds import rotating_world

    site = rotating_options.site(arguments, 1)
    room = Room(site, rotating_world(site), rotating_options.setting(arguments, site))
    places = room.grid() if arguments.grid else room.targets(arguments.targets)
    rotation = None if arguments.tilt_deg is None else room.tilted(len(places), arguments.tilt_deg)
    samples, times = room.samples(places, rotation), room.setting.times_s()
    try:
        with open(arguments.samples, "w", encoding="utf-8", newline="") as file:  # noqa: PTH123
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(SAMPLES + PLACE)
            for window, (place, rows) in enumerate(zip(places, samples, strict=True)):
                for time_s, field in zip(times, rows, strict=True):
                    writer.writerow([window, *(repr(float(value)) for value in (time_s, *field, *place))])
    except OSError as error:
        raise UserError(f"{arguments.samples}: the samples cannot be written: {error.strerror}") from error
    print(f"{arguments.samples}: {len(places)} windows of {len(times)} samples")
    return 0


def read_windows(site: RotatingSite, path: str, separation: str = "least-squares") -> Iterator[Window]:
    """Yield the separated windows of a table of samples.

    Raises
    ------
    UserError
        With file, line and column of whatever is wrong.
    """
    for rows in read_groups(path, "window", SAMPLES, PLACE):
        yield _window(site, rows, separation)


def _window(site: RotatingSite, rows: list[Row], method: str) -> Window:
    first = rows[0]
    times = np.array([row.number("t_s") for row in rows])
    samples = np.array([[row.number(column) for column in SAMPLES[2:]] for row in rows])
    try:
        if method == "fft":
            separation = _by_fft(site, times, samples)
        else:
            separation = RotatingSeparator(site.frequency_Hz, times, site.noise_T).separate(samples[None])
    except UserError as error:
        raise first.error("window", f"{first.text('window')}: {error}") from error
    place = None
    given = [column for column in PLACE if column in first.cells]
    if given:
        if len(given) < len(PLACE):
            raise UserError(f"{first.path}: has {','.join(given)} but not all of {','.join(PLACE)}")
        place = np.array([first.number(column) for column in PLACE])
        for row in rows:
            for column, value in zip(PLACE, place, strict=True):
                if row.number(column) != value:
                    raise row.error(column, f"differs from the {value:g} of the window's first row: one place a window")
    return Window(first.whole("window"), separation.field_T, separation.sigma_T, place)


def _by_fft(site: RotatingSite, time_s: FloatArray, samples_T: FloatArray) -> RotatingSeparation:
    steps = np.diff(time_s)
    if not len(steps) or steps.min() <= 0.0 or np.ptp(steps) > EVEN * steps.mean():
        raise UserError("an FFT needs samples at even distances in time: separate by least squares, which takes any")
    rate_Hz = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    return separate_by_fft(samples_T[None], rate_Hz, site.frequency_Hz, site.noise_T, time_s[0])
