"""What ``goldfield paper zheng compare|range|beacons|stability`` prints and draws."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from goldfield.cli.output import json_line, number
from goldfield.errors import UserError, counted
from goldfield.types import FloatArray
from hil_sim.papers import plot
from hil_sim.papers.zheng import room_options, sites
from hil_sim.papers.zheng.experiments import Compared, compare, direction_errors, more_beacons, stability
from hil_sim.papers.zheng.room import Room

PAPER_POSITION_M = {
    "1 attenuation lines, global": 0.336,
    "1 attenuation lines, regions": 0.336,
    "2 nearest fingerprints": 0.114,
    "3 improved fingerprints": 0.069,
}
"""Mean position errors that the paper prints. It does not say which of the two kinds of lines its algorithm 1 has."""

PAPER_ORDER = "3 < 2 < 1"
"""The paper's algorithms by these errors, the best first."""

PAPER_ATTITUDE_DEG = {
    "1 attenuation lines, global": 5.62,
    "1 attenuation lines, regions": 5.62,
    "2 nearest fingerprints": 3.91,
    "3 improved fingerprints": 2.37,
}
"""Mean errors of the attitude's angles that the paper prints."""

PAPER_BEACONS_M = {3: 0.110, 4: 0.085, 5: 0.077, 6: 0.071}
"""Mean position errors that the paper prints for each number of beacons."""

PAPER_RANGE = "the paper: 14 m in its laboratory, 20 m in its simulation, limit not stated"

STILL_M = (1.20, 1.80, 0.50)
"""Where the sensor of the stability experiment stands: a point of the paper's Table 1."""

COMPARE_CELLS = (
    ("mean_m", 8, 4),
    ("p95_m", 8, 4),
    ("worst_m", 7, 3),
    ("paper_m", 6, 3),
    ("printed_level_deg", 9, 2),
    ("paper_deg", 6, 2),
    ("turned_deg", 8, 3),
    ("turned_worst_deg", 7, 2),
    ("printed_turned_deg", 9, 1),
)
"""Key, width and digits of each number in a line of the comparison."""


def run_compare(arguments: argparse.Namespace) -> int:
    """Print a line an algorithm."""
    room = room_options.room(arguments, 3)
    results = compare(room, arguments.runs, arguments.tilt_deg)
    records = [_compare_record(result) for result in results]
    if arguments.json:
        for record in records:
            print(json_line(record))
    else:
        print(_about(room, counted(arguments.runs, "places")))
        _print_compared(records)
        failed = max(int(np.isnan(result.printed_deg).sum()) for result in results if result.printed_deg is not None)
        print(
            f"printed: eqns 18 to 23, for yaw only, without the places (at most {failed}) whose estimate lies in the "
            f"beacons' plane, where they have no solution. turned: any yaw, tilts up to {arguments.tilt_deg:g} deg."
        )
        print(
            f"order by mean position error (1: global lines): {_order(results, '')} as printed, "
            f"{_order(results, ', ln B')} with distances of ln B; the paper: {PAPER_ORDER}."
        )
    if arguments.figure:
        figure, (left, right) = plot.panels(2, "Zheng et al. 2022, figs 7 and 8, in the simulated room")
        plot.cumulative(left, {result.name: result.error_m for result in results}, "position error m")
        turned = {result.name: result.turned_deg for result in results}
        plot.cumulative(right, turned, f"attitude error deg, tilts up to {arguments.tilt_deg:g} deg")
        plot.save(figure, arguments.figure)
    return 0


def _compare_record(result: Compared) -> dict[str, Any]:
    return {
        "algorithm": result.name,
        "mean_m": number(float(np.mean(result.error_m))),
        "p95_m": number(float(np.quantile(result.error_m, 0.95))),
        "worst_m": number(float(result.error_m.max())),
        "paper_m": PAPER_POSITION_M.get(result.name),
        "printed_level_deg": _mean(result.printed_deg),
        "paper_deg": PAPER_ATTITUDE_DEG.get(result.name),
        "turned_deg": number(float(np.mean(result.turned_deg))),
        "turned_worst_deg": number(float(result.turned_deg.max())),
        "printed_turned_deg": _mean(result.printed_turned_deg),
        "printed_failed": None if result.printed_deg is None else int(np.isnan(result.printed_deg).sum()),
    }


def _print_compared(records: Sequence[dict[str, Any]]) -> None:
    print(f"{'':30s} {'position error m':^32s} {'attitude error deg':^43s}")
    print(
        f"{'algorithm':30s} {'mean':>8} {'95 %':>8} {'worst':>7} {'paper':>6}"
        f" {'printed,':>9} {'paper':>6} {'Wahba,':>8} {'worst':>7} {'printed,':>9}"
    )
    print(f"{'':62s} {'level':>9} {'':6} {'turned':>8} {'':7} {'turned':>9}")
    for record in records:
        values = [_cell(record[key], width, digits) for key, width, digits in COMPARE_CELLS]
        print(f"{record['algorithm']:30s} {' '.join(values)}")


def _order(results: Sequence[Compared], kind: str) -> str:
    """Return the paper's algorithms by their mean error, the best first; kind: how 2 and 3 measure distances."""
    names = ("1 attenuation lines, global", f"2 nearest fingerprints{kind}", f"3 improved fingerprints{kind}")
    mean = {result.name: float(np.mean(result.error_m)) for result in results}
    return " < ".join(name[0] for name in sorted(names, key=lambda name: mean[name]))


def run_range(arguments: argparse.Namespace) -> int:
    """Print a line a distance."""
    room = room_options.room(arguments, 1)
    distance = np.arange(2.0, 31.0, 1.0)
    error = direction_errors(room, distance, arguments.polar_deg, arguments.runs)
    beyond = np.flatnonzero(error > arguments.limit_deg)
    last = None if not len(beyond) else float(distance[beyond[0] - 1]) if beyond[0] else 0.0
    if arguments.json:
        for metres, degrees in zip(distance, error, strict=True):
            print(json_line({"distance_m": float(metres), "rms_deg": float(degrees)}))
        print(json_line({"limit_deg": arguments.limit_deg, "range_m": last}))
    else:
        print(
            _about(room, f"{counted(arguments.runs, 'directions')} {arguments.polar_deg:g} deg from z at each distance")
        )
        print(f"{'distance m':>10} {'rms error of the direction, deg':>32} {'variance, deg^2':>16}")
        for metres, degrees in zip(distance, error, strict=True):
            print(f"{metres:10.0f} {degrees:32.2f} {degrees**2:16.2f}")
        within = "beyond 30 m" if last is None else f"{last:g} m"
        print(f"within {arguments.limit_deg:g} deg up to {within} ({PAPER_RANGE})")
    if arguments.figure:
        figure, (axes,) = plot.panels(1, "Zheng et al. 2022, fig 6, in the simulated room")
        plot.curves(axes, distance, {"one beacon": error**2}, "distance m", "mean square error of the direction, deg^2")
        axes.set_yscale("log")
        plot.save(figure, arguments.figure)
    return 0


def run_beacons(arguments: argparse.Namespace) -> int:
    """Print a line a number of beacons."""
    site = sites.simulated(arguments, 3)
    results = more_beacons(site, room_options.setting(arguments, site), arguments.runs)
    if not arguments.json:
        print(f"{'beacons':>7} {'3 improved m':>13} {'paper m':>8} {'ours m':>8}")
    for result in results:
        paper = PAPER_BEACONS_M.get(result.beacons)
        improved, ours = float(result.improved_m.mean()), float(result.ours_m.mean())
        if arguments.json:
            print(json_line({"beacons": result.beacons, "improved_m": improved, "paper_m": paper, "ours_m": ours}))
        else:
            print(f"{result.beacons:7d} {improved:13.4f} {_cell(paper, 8, 3)} {ours:8.4f}")
    if arguments.figure:
        figure, (left, right) = plot.panels(2, "Zheng et al. 2022, fig 11, in the simulated room")
        plot.cumulative(left, {f"{r.beacons} beacons": r.improved_m for r in results}, "improved fingerprints, error m")
        plot.cumulative(right, {f"{r.beacons} beacons": r.ours_m for r in results}, "ours, error m")
        plot.save(figure, arguments.figure)
    return 0


def run_stability(arguments: argparse.Namespace) -> int:
    """Print a line an algorithm and kind of error."""
    if arguments.runs < 2:
        raise UserError("--runs is 1: the uncertainty of the slope comes from the spread over at least 2 runs")
    if arguments.hours < 30.0:
        raise UserError(f"--hours is {arguments.hours:g}: less than 30 h cannot tell a slope from the daily cycle")
    room = room_options.room(arguments, 3)
    result = stability(room, arguments.hours, np.array(STILL_M), arguments.runs, arguments.ageing_per_day)
    if not arguments.json:
        print(_about(room, f"{counted(arguments.runs, 'runs')} of {arguments.hours:g} h, one estimate a minute"))
        print(f"the currents drift by up to {100.0 * result.drive_range:.2f} % (first run)")
        print(
            f"{'algorithm':26s} {'mean error':>12} {'slope a day':>13} {'+-':>10} {'one run':>10}  consistent with zero"
        )
    parts = (
        ("m", 1e3, "mm", result.error_m, result.trend_m),
        ("deg", 1.0, "deg", result.error_deg, result.trend_deg),
    )
    for unit, factor, shown, errors, trends in parts:
        for name, trend in trends.items():
            mean = float(errors[name].mean())
            if arguments.json:
                record = {"algorithm": name, "unit": unit, "mean": mean, "slope_per_day": trend.per_day}
                record |= {"sigma_per_day": trend.sigma_per_day, "one_run_per_day": trend.one_run_per_day}
                print(json_line(record | {"consistent_with_zero": trend.consistent_with_zero}))
            else:
                cells = [mean, trend.per_day, trend.sigma_per_day, trend.one_run_per_day]
                text = [f"{factor * value:{width}.4f}" for value, width in zip(cells, (8, 13, 10, 10), strict=True)]
                verdict = "yes" if trend.consistent_with_zero else "no"
                print(f"{name:26s} {text[0]} {shown:3s} {' '.join(text[1:])}  {verdict}")
    if arguments.figure:
        figure, (left, right) = plot.panels(2, "Zheng et al. 2022, figs 9 and 10, in the simulated room: the first run")
        plot.curves(left, result.hours, result.error_m, "hours", "position error m")
        plot.curves(right, result.hours, result.error_deg, "hours", "attitude error deg")
        left.set_yscale("log")
        right.set_yscale("log")
        plot.save(figure, arguments.figure)
    return 0


def _about(room: Room, what: str) -> str:
    setting = room.setting
    return (
        f"{len(room.site.beacons)} beacons, {setting.noise_T * 1e9:g} nT a sample, windows of {setting.window_s:g} s "
        f"at {setting.rate_Hz:g} Hz ({room.sigma_T.max() * 1e9:.2f} nT a component), seed {setting.seed}, {what}"
    )


def _mean(values: FloatArray | None) -> float | None:
    """Return the mean of what is finite: for a position in the beacons' plane the printed attitude does not exist."""
    if values is None or not np.isfinite(values).any():
        return None
    return number(float(np.nanmean(values)))


def _cell(value: float | None, width: int, digits: int) -> str:
    return " " * width if value is None else f"{value:{width}.{digits}f}"
