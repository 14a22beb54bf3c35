"""``goldfield paper zheng survey|locate|simulate``: a map of fingerprints from samples, and poses."""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.cli.chips_file import PLACE
from goldfield.cli.output import elements, json_line, number
from goldfield.errors import UserError
from goldfield.site.rotating import RotatingSite
from goldfield.types import FloatArray
from hil_sim.papers.zheng import options
from hil_sim.papers.zheng.windows import COLUMNS_HELP, SAMPLES, Window, read_windows

ALGORITHMS = ("ellipse", "axes", "lines", "regions", "nearest", "local")
"""Ours, with all components and with the ellipse's axes alone; the paper's 1 with global lines and with those of
regions; its 2; its 3 as intended."""


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
    options.add_site(survey)
    survey.set_defaults(run=run_survey)

    locate = actions.add_parser(
        "locate",
        help="poses from samples, with or without a map",
        description=f"A pose a window. SAMPLES: {COLUMNS_HELP}; where they have places, errors are shown.",
    )
    locate.add_argument("samples", metavar="SAMPLES.csv")
    locate.add_argument("--map", metavar="MAP.csv", help="of goldfield paper zheng survey; ellipse and axes need none")
    locate.add_argument("--algorithm", choices=ALGORITHMS, default="ellipse", help="default ellipse: all components")
    _add_separation(locate)
    options.add_site(locate)
    options.add_json(locate)
    locate.set_defaults(run=run_locate)

    simulate = actions.add_parser(
        "simulate", help="samples of a simulated room", description="Writes samples to try survey and locate with."
    )
    simulate.add_argument("samples", metavar="SAMPLES.csv", help="to write")
    kind = simulate.add_mutually_exclusive_group(required=True)
    kind.add_argument("--grid", action="store_true", help="level, at the places of a survey, every 0.5 m")
    kind.add_argument("--targets", type=options.count, metavar="N", help="at random places")
    simulate.add_argument("--tilt-deg", type=options.positive, metavar="D", help="turned, tilted up to so much")
    options.add_site(simulate)
    options.add_world(simulate)
    simulate.set_defaults(run=run_simulate)


def _add_separation(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--separation",
        choices=("least-squares", "fft"),
        default="least-squares",
        help="least-squares (default) takes any window; fft, the paper's, only whole periods of every beacon",
    )


def run_survey(arguments: argparse.Namespace) -> int:
    """Build and save a map; windows at one place make one point."""
    from hil_sim.papers.zheng.methods import map_file
    from hil_sim.papers.zheng.methods.field_ellipse import rms_strength
    from hil_sim.papers.zheng.methods.fingerprint import FingerprintMap

    site = options.measured_site(arguments, 3)
    names = tuple(beacon.id for beacon in options.dual_axis_beacons(site).beacons)
    strengths: dict[tuple[float, ...], list[FloatArray]] = {}
    for window in read_windows(site, arguments.samples, arguments.separation):
        if window.place_m is None:
            raise UserError(f"{arguments.samples}: has no places: a survey needs the columns {','.join(PLACE)}")
        strength = rms_strength(window.field_T)[0]
        if not np.isfinite(strength).all():
            raise UserError(f"{arguments.samples}: window {window.window} lacks samples: leave it out of the survey")
        strengths.setdefault(tuple(window.place_m.tolist()), []).append(strength)
    means = np.array([np.mean(of_place, axis=0) for of_place in strengths.values()])
    map_file.save(FingerprintMap(names, np.array(list(strengths)), means), arguments.map)
    print(f"{arguments.map}: {len(strengths)} points, {len(names)} beacons")
    return 0


def run_locate(arguments: argparse.Namespace) -> int:
    """Print a line a window, whatever happens."""
    measured_site = options.measured_site(arguments, 3)
    locate = _locator(options.dual_axis_beacons(measured_site), arguments.algorithm, arguments.map)
    if not arguments.json:
        print(
            f"{'window':>6} {'x m':>9} {'y m':>9} {'z m':>9} {'roll':>7} {'pitch':>7} {'yaw deg':>8} {'residual':>9} "
            "error m"
        )
    for window in read_windows(measured_site, arguments.samples, arguments.separation):
        position, rotation, residual = np.full(3, np.nan), np.full((3, 3), np.nan), math.nan
        if np.isfinite(window.field_T).all():
            position, rotation, residual = locate(window)
        error = math.nan if window.place_m is None else float(np.linalg.norm(position - window.place_m))
        show = _record if arguments.json else _line
        print(show(window.window, position, rotation, residual, error), flush=True)
    return 0


def _locator(
    site: RotatingSite, algorithm: str, map_path: str | None
) -> Callable[[Window], tuple[FloatArray, FloatArray, float]]:
    """Return what makes position, rotation and residual (NaN: not of this algorithm) of a window.

    Raises
    ------
    UserError
        If the algorithm needs a map, or the map is wrong.
    """
    from hil_sim.papers.zheng.methods import map_file
    from hil_sim.papers.zheng.methods.attitude import attitude_from_normals
    from hil_sim.papers.zheng.methods.ellipse import locate_by_ellipse, position_from_axes
    from hil_sim.papers.zheng.methods.field_ellipse import rms_strength
    from hil_sim.papers.zheng.methods.fingerprint import LineLocator, nearest_neighbours

    if algorithm == "ellipse":

        def by_components(window: Window) -> tuple[FloatArray, FloatArray, float]:
            fit = locate_by_ellipse(site, window.field_T, window.sigma_T)
            residual = float(np.sqrt(fit.cost[0] / (6 * len(site.beacons) - 6)))
            return fit.position_m[0], fit.rotation[0], residual

        return by_components
    if algorithm == "axes":

        def position_of(window: Window) -> FloatArray:
            return position_from_axes(site, window.field_T, window.sigma_T)

    else:
        if map_path is None:
            raise UserError(f"--map is missing: {algorithm} needs a map of goldfield paper zheng survey")
        fingerprints = map_file.load(map_path, tuple(beacon.id for beacon in site.beacons))
        lines = LineLocator(site.position_m, fingerprints, site.up)
        methods: dict[str, Callable[[FloatArray], FloatArray]] = {
            "lines": lines.by_global_lines,
            "regions": lines.by_region_lines,
            "nearest": partial(nearest_neighbours, fingerprints),
            "local": lines.by_local_lines,
        }
        by_strength = methods[algorithm]

        def position_of(window: Window) -> FloatArray:
            return by_strength(rms_strength(window.field_T))

    def by_normals(window: Window) -> tuple[FloatArray, FloatArray, float]:
        position = position_of(window)
        return position[0], attitude_from_normals(site, position, window.field_T)[0], math.nan

    return by_normals


def _record(window: int, position_m: FloatArray, rotation: FloatArray, residual: float, error_m: float) -> str:
    located = bool(np.isfinite(position_m).all())
    return json_line(
        {
            "window": window,
            "position_m": elements(position_m) if located else None,
            "orientation_xyzw": elements(Rotation.from_matrix(rotation).as_quat(canonical=True)) if located else None,
            "residual": number(residual),
            "error_m": number(error_m),
        }
    )


def _line(window: int, position_m: FloatArray, rotation: FloatArray, residual: float, error_m: float) -> str:
    if not np.isfinite(position_m).all():
        return f"{window:6d} not located: the samples that arrived do not tell all fields on all axes"
    yaw, pitch, roll = Rotation.from_matrix(rotation).as_euler("ZYX", degrees=True)
    cells = " ".join(f"{value:9.4f}" for value in position_m)
    fitted = f"{'':9}" if math.isnan(residual) else f"{residual:9.2f}"
    error = "" if math.isnan(error_m) else f"{error_m:.4f}"
    return f"{window:6d} {cells} {roll:7.2f} {pitch:7.2f} {yaw:8.2f} {fitted} {error}"


def run_simulate(arguments: argparse.Namespace) -> int:
    """Write simulated samples."""
    from hil_sim.papers.zheng.room import Room
    from hil_sim.world.rotating_room import RotatingRoom

    site = options.site(arguments, 1)
    room = Room(site, RotatingRoom(site.beacons), options.setting(arguments, site))
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
