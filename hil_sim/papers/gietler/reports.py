"""``goldfield paper gietler``: moving emitters tracked by a fixed sensor, with and without a conductor beside them."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from goldfield.errors import SystemFailure, UserError
from goldfield.types import FloatArray

Rows = list[dict[str, Any]]

LEAST_CONVERGED = 0.95
MOST_VOXEL_ERROR = 0.02
MOST_TRACK_ERROR_M = 0.01


def command(subparsers: Any) -> None:
    """Add the subcommand to the command line of goldfield."""
    parser = subparsers.add_parser(
        "gietler",
        help="moving emitters beside conductors, tracked by a fixed sensor",
        description="The system of Gietler, Ammari and Zangl, simulated. Exit code 3: a figure misses its goal.",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    track = _action(actions, "track", run_track, "base against extended model beside carbon, copper, a permeable body")
    track.add_argument("--body", choices=("sphere", "cube"), default="sphere", help=_BODY_HELP)
    track.add_argument("--path", choices=("brownian", "helix"), default="brownian", help="default: brownian")
    track.add_argument(
        "--material", choices=("all", "carbon", "copper", "permeable"), default="all", help="default: all"
    )
    _seeded(track, runs=5)
    _frequency(track)
    converge = _action(actions, "converge", run_converge, "iterated against plain filter from the paper's poor guess")
    _seeded(converge, runs=200)
    table = _action(actions, "table", run_table, "the paper's Tables I and II beside our solutions")
    _frequency(table)
    formula = _action(actions, "formula", run_formula, "the explicit formula beside the exact series of a sphere")
    _frequency(formula)


_BODY_HELP = (
    "what moves with the emitters: a sphere of the cube's volume, whose field is known exactly (default), or the "
    "paper's cube (copper only, as a perfect conductor, by boundary elements)"
)


def _action(actions: Any, name: str, run: Callable[[argparse.Namespace], int], what: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = actions.add_parser(name, help=what, description=what)
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    parser.add_argument("--figure", metavar="FILE.png", help="draw it")
    parser.set_defaults(run=run)
    return parser


def _seeded(parser: argparse.ArgumentParser, runs: int) -> None:
    parser.add_argument("--runs", type=_count, default=runs, metavar="N", help=f"seeded runs; default {runs}")
    parser.add_argument("--seed", type=_whole, default=0, metavar="N", help="of the first run; default 0")
    parser.add_argument(
        "--noise", type=_positive, default=1e-4, metavar="A/M", help="of the sensor, each axis and phase; default 1e-4"
    )


def _frequency(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--frequency", type=_positive, default=1e4, metavar="HZ", help="of the emitters; not printed; default 10000"
    )


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is no number greater than zero")
    return value


def _whole(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise argparse.ArgumentTypeError(f"{text} is no whole number from 0 up")
    return int(text)


def _count(text: str) -> int:
    value = _whole(text)
    if value == 0:
        raise argparse.ArgumentTypeError("at least one run is needed")
    return value


def run_track(arguments: argparse.Namespace) -> int:
    """Track paths beside each conductor; a row a material and model."""
    from hil_sim.papers.gietler import experiments

    helix = arguments.path == "helix"
    materials = list(experiments.MATERIALS) if arguments.material == "all" else [arguments.material]
    if arguments.body == "cube" and arguments.material == "all":
        materials = ["copper"]
    rows: Rows = []
    drawn: dict[str, Any] = {}
    missed = False
    for material in materials:
        truth = experiments.true_conductor(arguments.body, material, arguments.frequency)
        models = experiments.models(arguments.body, material, arguments.frequency)
        tracks: dict[str, list[experiments.Track]] = {name: [] for name in models}
        for seed in range(arguments.seed, arguments.seed + (1 if helix else arguments.runs)):
            path, found = experiments.beside_conductor(truth, models, arguments.noise, seed, helix)
            for name, one in found.items():
                tracks[name].append(one)
            if seed == arguments.seed:
                drawn[material] = (path, found)
        within = math.inf if helix else experiments.NEAR_M
        for name, several in tracks.items():
            rms: FloatArray = np.array([one.rms(within) for one in several])
            whole = np.array([one.rms()[0] for one in several])
            row: dict[str, Any] = {
                "material": material,
                "model": name,
                "runs": len(several),
                "rms_m": float(np.sqrt(np.mean(rms[:, 0] ** 2))),
                "worst_run_m": float(rms[:, 0].max()),
                "rms_deg": float(np.degrees(np.sqrt(np.mean(rms[:, 1] ** 2)))),
                "whole_path_rms_m": float(np.sqrt(np.mean(whole**2))),
                "farthest_m": float(max(one.range_m.max() for one in several)),
            }
            rows.append(row)
            missed |= name == "extended" and not row["worst_run_m"] < MOST_TRACK_ERROR_M
    where = "the whole helix" if helix else f"ranges up to {experiments.NEAR_M:g} m"
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
    return 3 if missed else 0


def run_converge(arguments: argparse.Namespace) -> int:
    """Count the runs in which each filter finds the track."""
    from hil_sim.papers.gietler import experiments

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
        from hil_sim.papers import plot

        figure, axes = plot.panels(1, "Final position error from the paper's initial guess")
        plot.cumulative(axes[0], {name: np.array(values) for name, values in errors.items()}, "error, m")
        plot.save(figure, arguments.figure)
    return 0 if good["iterated"] >= LEAST_CONVERGED * arguments.runs else 3


def run_table(arguments: argparse.Namespace) -> int:
    """Print Tables I and II beside our solutions of the same cube."""
    from hil_sim.papers.gietler import experiments

    _no_figure(arguments, "table")
    rows: Rows = []
    for number, material in (("I", "copper"), ("II", "permeable")):
        for name, fields in experiments.table(material, arguments.frequency).items():
            for emitter, field in enumerate(fields):
                ratio, cosine = experiments.agreement(experiments.PRINTED[material][emitter], field)
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
    from hil_sim.papers.gietler import experiments

    _no_figure(arguments, "formula")
    rows: Rows = []
    for material, (conductivity, permeability) in experiments.MATERIALS.items():
        try:
            error = experiments.formula_error(conductivity, permeability, arguments.frequency)
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


def _no_figure(arguments: argparse.Namespace, action: str) -> None:
    if arguments.figure:
        raise UserError(f"emitter {action} has nothing to draw: leave out --figure, or take track or converge")


def _draw_tracks(path: str, drawn: dict[str, Any]) -> None:
    """Draw plan and error over range of the first run with each material."""
    from hil_sim.papers import plot

    if not drawn:
        raise SystemFailure("there is no track to draw: this is a defect, please report it")
    figure, axes = plot.panels(len(drawn), "Emitters beside a conductor: path from above, and error", rows=2)
    for place, (material, (truth, tracks)) in enumerate(drawn.items()):
        above, below = axes[place], axes[len(drawn) + place]
        above.plot(truth.position_m[:, 0], truth.position_m[:, 1], "k.", markersize=2, label="true")
        time = 0.1 * np.arange(len(truth.position_m))
        for name, track in tracks.items():
            above.plot(track.position_m[:, 0], track.position_m[:, 1], label=name, linewidth=1.0)
            below.semilogy(time, track.error_m, label=name, linewidth=1.0)
        above.set(title=material, xlabel="x, m", ylabel="y, m", aspect="equal")
        below.set(xlabel="time, s", ylabel="position error, m")
        below.legend()
        below.grid(alpha=0.3)
    plot.save(figure, path)
