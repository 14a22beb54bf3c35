"""What ``goldfield paper gietler`` prints and draws; an action whose figure misses its goal ends with exit code 3."""

from __future__ import annotations

import argparse
import json
import math
import sys
from typing import Any

import numpy as np

from goldfield.errors import SystemFailure, UserError
from goldfield.types import FloatArray
from hil_sim.papers import plot
from hil_sim.papers.gietler import experiments, formula
from hil_sim.papers.gietler.conductors import MATERIALS, true_conductor
from hil_sim.papers.gietler.experiments import NEAR_M, Track, beside_conductor, models
from hil_sim.world.emitter_world import STEP_S, Path

Rows = list[dict[str, Any]]
Drawn = dict[str, tuple[Path, dict[str, Track]]]
"""The first run with each material: the true path, and the track of each model."""

LEAST_CONVERGED = 0.95
"""Smallest share of runs in which the iterated filter must find the track."""

MOST_VOXEL_ERROR = 0.02
"""Largest relative error of the host's model of a sphere."""

MOST_TRACK_ERROR_M = 0.01
"""Largest root mean square error of a run with the extended model."""


def run_track(arguments: argparse.Namespace) -> int:
    """Track paths beside each conductor; a row a material and model."""
    helix = arguments.path == "helix"
    materials = list(MATERIALS) if arguments.material == "all" else [arguments.material]
    if arguments.body == "cube" and arguments.material == "all":
        materials = ["copper"]
    rows: Rows = []
    drawn: Drawn = {}
    for material in materials:
        tracks, drawn[material] = _track(arguments, material, helix)
        rows += [_track_row(material, name, several, helix) for name, several in tracks.items()]
    where = "the whole helix" if helix else f"ranges up to {NEAR_M:g} m"
    _show(
        arguments,
        rows,
        f"{arguments.body} beside the emitters, {arguments.frequency:g} Hz, {arguments.noise:g} A/m; rms over {where}",
        {
            "material": "{}",
            "model": "{}",
            "runs": "{}",
            "rms_m": "{:.5f}",
            "worst_run_m": "{:.5f}",
            "rms_deg": "{:.3f}",
            "whole_path_rms_m": "{:.5f}",
            "farthest_m": "{:.2f}",
        },
    )
    if arguments.figure:
        _draw_tracks(arguments.figure, drawn)
    extended = [row for row in rows if row["model"] == "extended"]
    return 0 if all(row["worst_run_m"] < MOST_TRACK_ERROR_M for row in extended) else 3


def _track(
    arguments: argparse.Namespace, material: str, helix: bool
) -> tuple[dict[str, list[Track]], tuple[Path, dict[str, Track]]]:
    """Return the tracks of all runs by model, and the first run's path and tracks; a helix is run once."""
    truth = true_conductor(arguments.body, material, arguments.frequency)
    compared = models(arguments.body, material, arguments.frequency)
    runs = [
        beside_conductor(truth, compared, arguments.noise, seed, helix)
        for seed in range(arguments.seed, arguments.seed + (1 if helix else arguments.runs))
    ]
    return {name: [found[name] for _, found in runs] for name in compared}, runs[0]


def _track_row(material: str, model: str, tracks: list[Track], helix: bool) -> dict[str, Any]:
    rms: FloatArray = np.array([track.rms(math.inf if helix else NEAR_M) for track in tracks])
    whole = np.array([track.rms()[0] for track in tracks])
    return {
        "material": material,
        "model": model,
        "runs": len(tracks),
        "rms_m": float(np.sqrt(np.mean(rms[:, 0] ** 2))),
        "worst_run_m": float(rms[:, 0].max()),
        "rms_deg": float(np.degrees(np.sqrt(np.mean(rms[:, 1] ** 2)))),
        "whole_path_rms_m": float(np.sqrt(np.mean(whole**2))),
        "farthest_m": float(max(track.range_m.max() for track in tracks)),
    }


def run_converge(arguments: argparse.Namespace) -> int:
    """Count the runs in which each filter finds the track."""
    good: dict[str, int] = {}
    errors: dict[str, list[float]] = {}
    for seed in range(arguments.seed, arguments.seed + arguments.runs):
        for name, track in experiments.from_poor_guess(arguments.noise, seed).items():
            good[name] = good.get(name, 0) + experiments.converged(track)
            errors.setdefault(name, []).append(float(track.error_m[-1]))
    rows: Rows = [
        {
            "filter": name,
            "runs": arguments.runs,
            "converged": good[name],
            "median_final_error_m": float(np.median(errors[name])),
        }
        for name in good
    ]
    _show(
        arguments,
        rows,
        f"20 s from the paper's guess, {arguments.noise:g} A/m, seeds {arguments.seed} to "
        f"{arguments.seed + arguments.runs - 1}; converged: the last 5 s within 5 % of the range and 0.1 rad",
        {"filter": "{}", "runs": "{}", "converged": "{}", "median_final_error_m": "{:.2g}"},
    )
    if arguments.figure:
        figure, axes = plot.panels(1, "Final position error from the paper's initial guess")
        plot.cumulative(axes[0], {name: np.array(values) for name, values in errors.items()}, "error, m")
        plot.save(figure, arguments.figure)
    return 0 if good["iterated"] >= LEAST_CONVERGED * arguments.runs else 3


def run_table(arguments: argparse.Namespace) -> int:
    """Print Tables I and II beside our solutions of the same cube."""
    _no_figure(arguments, "table")
    rows: Rows = []
    for number, material in (("I", "copper"), ("II", "permeable")):
        for name, fields in formula.table(material, arguments.frequency).items():
            for emitter, field in enumerate(fields):
                ratio, cosine = formula.agreement(formula.PRINTED[material][emitter], field)
                row: dict[str, Any] = {"table": number, "emitter": emitter + 1, "source": name}
                for axis, value in zip("xyz", field, strict=True):
                    row[axis] = [round(float(value.real), 3), round(float(value.imag), 3)]
                row |= {"ratio": ratio, "cosine": cosine.real}
                rows.append(row)
    _show(
        arguments,
        sorted(rows, key=lambda row: (row["table"], row["emitter"])),
        f"secondary field of the 5 cm cube in mA/m (printed: mT, which cannot be), ours at {arguments.frequency:g} Hz; "
        "ratio of lengths and cosine against the printed vector",
        {
            "table": "{}",
            "emitter": "{}",
            "source": "{}",
            "x": "{0[0]:.1f}{0[1]:+.1f}i",
            "y": "{0[0]:.1f}{0[1]:+.1f}i",
            "z": "{0[0]:.1f}{0[1]:+.1f}i",
            "ratio": "{:.3f}",
            "cosine": "{:+.3f}",
        },
    )
    return 0


def run_formula(arguments: argparse.Namespace) -> int:
    """Compare the explicit formula with the exact series, for each material."""
    _no_figure(arguments, "formula")
    rows: Rows = []
    for material, (conductivity, permeability) in MATERIALS.items():
        try:
            error = formula.formula_error(conductivity, permeability, arguments.frequency)
        except UserError as refusal:
            print(f"goldfield: {material} is left out: {refusal}", file=sys.stderr)
            continue
        rows.append(
            {
                "material": material,
                "radius_over_skin_depth": error.skin_depths,
                "secondary_over_primary": error.share,
                "host_error": error.host,
                "given_interior_error": error.given,
                "first_order_error": error.first_order if math.isfinite(error.first_order) else None,
            }
        )
    _show(
        arguments,
        rows,
        f"sphere of the cube's volume, 3 emitters, 4 points, {arguments.frequency:g} Hz; largest relative errors of "
        "the secondary field against the exact series",
        {
            "material": "{}",
            "radius_over_skin_depth": "{:.3g}",
            "secondary_over_primary": "{:.3g}",
            "host_error": "{:.4f}",
            "given_interior_error": "{:.4f}",
            "first_order_error": "{:.3g}",
        },
    )
    return 0 if all(row["host_error"] < MOST_VOXEL_ERROR for row in rows) else 3


def _show(arguments: argparse.Namespace, rows: Rows, title: str, formats: dict[str, str]) -> None:
    """Print JSON lines, or a table under a title."""
    if arguments.json:
        for row in rows:
            print(json.dumps(row, allow_nan=False))
        return
    cells = [[name.replace("_", " ") for name in formats]]
    cells += [["-" if row[name] is None else form.format(row[name]) for name, form in formats.items()] for row in rows]
    widths = [max(len(line[column]) for line in cells) for column in range(len(formats))]
    print(title)
    for line in cells:
        print("  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)))


def _no_figure(arguments: argparse.Namespace, name: str) -> None:
    if arguments.figure:
        raise UserError(f"paper gietler {name} has nothing to draw: leave out --figure, or take track or converge")


def _draw_tracks(path: str, drawn: Drawn) -> None:
    """Draw plan and error over time of the first run with each material."""
    if not drawn:
        raise SystemFailure("there is no track to draw: this is a defect, please report it")
    figure, axes = plot.panels(len(drawn), "Emitters beside a conductor: path from above, and error", rows=2)
    for place, (material, (truth, tracks)) in enumerate(drawn.items()):
        above, below = axes[place], axes[len(drawn) + place]
        above.plot(truth.position_m[:, 0], truth.position_m[:, 1], "k.", markersize=2, label="true")
        time = STEP_S * np.arange(len(truth.position_m))
        for name, track in tracks.items():
            above.plot(track.position_m[:, 0], track.position_m[:, 1], label=name, linewidth=1.0)
            below.semilogy(time, track.error_m, label=name, linewidth=1.0)
        above.set(title=material, xlabel="x, m", ylabel="y, m", aspect="equal")
        below.set(xlabel="time, s", ylabel="position error, m")
        below.legend()
        below.grid(alpha=0.3)
    plot.save(figure, path)
