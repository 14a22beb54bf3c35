"""``goldfield paper zheng locate``: a pose for each window of samples, by the paper's algorithms or by the ellipses."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.cli.output import elements, json_line, number
from goldfield.errors import UserError
from goldfield.site.rotating import RotatingSite
from goldfield.types import FloatArray
from hil_sim.papers.zheng import sites
from hil_sim.papers.zheng.methods import map_file
from hil_sim.papers.zheng.methods.attitude import attitude_from_normals
from hil_sim.papers.zheng.methods.ellipse import locate_by_ellipse, position_from_axes
from hil_sim.papers.zheng.methods.field_ellipse import rms_strength
from hil_sim.papers.zheng.methods.fingerprint import LineLocator, nearest_neighbours
from hil_sim.papers.zheng.windows import Window, read_windows


def run(arguments: argparse.Namespace) -> int:
    """Print a line a window, whatever happens."""
    measured_site = sites.measured_site(arguments, 3)
    locate = _locator(sites.dual_axis_beacons(measured_site), arguments.algorithm, arguments.map)
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
    """Return the function from a window to position, rotation and residual (NaN: the algorithm has none).

    Raises
    ------
    UserError
        If the algorithm needs a map, or the map is wrong.
    """
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
