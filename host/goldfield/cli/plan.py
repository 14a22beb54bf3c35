"""``goldfield plan``: how well a sensor could be located everywhere in a box, before anything is installed."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from goldfield import site as sites
from goldfield.cli import options
from goldfield.cli.output import json_line
from goldfield.errors import Loudness, UserError, loudness, on_command_line, tell
from goldfield.files.outputs import check_outputs, check_writable, write_file
from goldfield.site import Site
from goldfield.site.plausible import EXTENT
from goldfield.types import FloatArray

KINDS = (".npz", ".png", ".html")
"""Ends of names by which an output's format is chosen."""


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "plan",
        description="Cramer-Rao bound on position and attitude, protection level, ambiguity, and the beacons that "
        "matter, at every point of a grid in a box; for a site or a lattice of equal beacons.",
    )
    options.add_site(parser)
    options.add(parser, "--lattice", metavar="FILE", what="lattice file (TOML) in place of a site file")
    options.add_box(parser)
    parser.add_argument(
        "--out",
        action="append",
        default=[],
        metavar="FILE",
        help="write the maps: .npz (arrays), .png (picture) or .html (page of its own); may be given several times",
    )
    options.add_force(parser)
    parser.add_argument("--floor", metavar="IMAGE", help="floor plan (PNG or JPEG) that is drawn beneath the maps")
    parser.add_argument(
        "--floor-extent",
        nargs=4,
        type=options.finite,
        metavar=("X0", "Y0", "X1", "Y1"),
        help="where the floor plan's lower left and upper right corners are, m (default: those of the box)",
    )
    parser.add_argument(
        "--optimise",
        metavar="FILE",
        help="improve places, axes or currents as this optimisation file (TOML) says; the maps are those of the result",
    )
    parser.add_argument("--site-out", metavar="FILE", help="write the site that --optimise found (TOML)")
    _add_settings(parser)
    options.add_json(parser)
    parser.set_defaults(run=run)


def _add_settings(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--best", type=options.count, default=8, metavar="K", help="size of the best-K set of beacons (default: 8)"
    )
    parser.add_argument(
        "--truncation",
        type=_part,
        default=0.01,
        metavar="PART",
        help="leave far beacons out as long as no bound becomes larger by more than this part (default: 0.01; 0 takes "
        "all of them everywhere)",
    )
    parser.add_argument(
        "--conflict",
        type=options.finite,
        default=40.0,
        metavar="DB",
        help="two beacons may share a code if each is weaker by so much where the other is used (default: 40)",
    )
    options.add(
        parser,
        "--workers",
        metavar="N",
        kind=options.count,
        what="processes of this machine that compute (default: one for each core)",
    )
    options.add(
        parser,
        "--scheduler",
        metavar="ADDRESS",
        what="address of a Dask scheduler whose workers compute instead, such as tcp://10.0.0.1:8786",
    )


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Compute the maps, write them, and print their summary."""
    _check_files(arguments)
    site = _site_of(arguments)
    grid = options.grid_of(arguments)
    from goldfield.planning import Request, Settings, plan  # heavy: only when a plan is wanted

    box = np.array(arguments.box)
    _check_near(site, box[:3], box[3:])
    request = Request(
        site, grid, Settings(min(arguments.best, len(site.beacons)), arguments.truncation, arguments.conflict)
    )
    floor = _floor_of(arguments)
    workers = arguments.workers or os.cpu_count() or 1
    if arguments.scheduler:
        options.tell_idle(arguments, ("--workers",), "--scheduler")
    if arguments.optimise:
        return _optimised(arguments, request, floor, workers)
    with _progress(len(grid)) as progress:
        maps = plan(request, workers=workers, scheduler=arguments.scheduler, progress=progress)
    summary = maps.summary()
    _write(arguments, maps, floor)
    print(json_line(summary) if arguments.json else _text(summary))
    return 0


def _optimised(arguments: argparse.Namespace, request: Any, floor: Any, workers: int) -> int:
    """Optimise, write the result and its maps, and print both summaries."""
    from goldfield.planning import optimise_file
    from goldfield.planning.optimise import optimise
    from goldfield.planning.site_text import site_text

    if arguments.scheduler:
        raise UserError(
            "--scheduler and --optimise are both given: the optimisation runs on this machine; leave one out"
        )
    wishes = optimise_file.load(arguments.optimise)
    if not arguments.site:
        site_text(request.site)  # what cannot be written is told before the work
    outcome = optimise(request, wishes, workers=workers, told=tell)
    if arguments.site_out:
        text = _revised(arguments.site, outcome.site) if arguments.site else site_text(outcome.site)
        write_file(arguments.site_out, text.encode(), "the site", force=arguments.force)
    _write(arguments, outcome.after, floor)
    before, after = outcome.before.summary(), outcome.after.summary()
    reached = wishes.target_m is None or outcome.figure_after_m <= wishes.target_m
    if arguments.json:
        print(json_line({**after, "before": before, "target_reached": reached}))
    else:
        print(f"before:\n{_text(before)}\n\nafter:\n{_text(after)}")
        if wishes.target_m is not None and not reached:
            print(
                f"the target of {100.0 * wishes.target_m:.3g} cm is not reached: allow more power, regions or beacons"
            )
    return 0


def _revised(path: str, site: Site) -> str:
    """Return the site file with new places, axes and currents; all else stays as its author wrote it."""
    from goldfield.site.revision import BeaconRevision, revised  # heavy: only when a site is written

    beacons = {one.id: BeaconRevision(one.position_m, one.axis, one.current_A) for one in site.beacons}
    return revised(Path(path), beacons)


def _write(arguments: argparse.Namespace, maps: Any, floor: Any) -> None:
    for path in arguments.out:
        write_file(path, _written(path, maps, floor), "the plan", force=arguments.force)


def _check_files(arguments: argparse.Namespace) -> None:
    """Refuse what cannot be written before anything is computed."""
    inputs = {
        "--site": arguments.site,
        "--lattice": arguments.lattice,
        "--floor": arguments.floor,
        "--optimise": arguments.optimise,
    }
    outputs: dict[str, str | Path | None] = {
        f"--out {count}" if count > 1 else "--out": path for count, path in enumerate(arguments.out, start=1)
    }
    for path in arguments.out:
        if not path.lower().endswith(KINDS):
            raise UserError(f"--out {path}: the name's end tells the format: give one of {', '.join(KINDS)}")
    for path in [*arguments.out, *([arguments.site_out] if arguments.site_out else [])]:
        folder = Path(path).parent
        if not os.access(folder, os.W_OK):
            raise UserError(f"{path}: the folder {folder} cannot be written: make it, or give another")
    if arguments.site_out and not arguments.optimise:
        raise UserError("--site-out is given without --optimise: there is no new site to write")
    check_outputs({**outputs, "--site-out": arguments.site_out}, inputs, force=arguments.force)
    check_writable(arguments.site_out, "the site")
    for path in arguments.out:
        check_writable(path, "the plan")


def _site_of(arguments: argparse.Namespace) -> Site:
    if arguments.site and arguments.lattice:
        raise UserError("--site and --lattice are both given: a plan is of one of them; leave one out")
    if arguments.lattice:
        from goldfield.planning import lattice

        site = lattice.load(arguments.lattice)
        options.tell_doubts(site)
        return site
    site = sites.load(options.required(arguments.site, "--site", "FILE"))
    options.tell_assumed(site)
    return site


def _check_near(site: Site, low_m: FloatArray, high_m: FloatArray) -> None:
    """Refuse a box that no beacon reaches: one of box and site is in another unit."""
    places = np.array([beacon.position_m for beacon in site.beacons])
    gap = float(np.linalg.norm(places - np.clip(places, low_m, high_m), axis=1).min())
    if gap > EXTENT.usual[1]:
        raise UserError(
            f"--box is {gap:g} m from the nearest beacon, where none is heard: give metres in --box and in the file"
        )


def _floor_of(arguments: argparse.Namespace) -> Any:
    """Load the floor plan, if one is given."""
    if arguments.floor is None:
        if arguments.floor_extent is not None:
            raise UserError("--floor-extent is given without --floor: give the image, too")
        return None
    from goldfield.planning.floor import load

    box = arguments.box
    return load(arguments.floor, arguments.floor_extent or [box[0], box[1], box[3], box[4]])


def _written(path: str, maps: Any, floor: Any) -> bytes:
    """Return the bytes of an output, by the end of its name."""
    if path.lower().endswith(".npz"):
        from goldfield.planning.table import npz

        return npz(maps)
    if path.lower().endswith(".png"):
        from goldfield.planning.picture import png

        return png(maps, floor)
    from goldfield.planning.page import html

    return html(maps, floor)


def _part(text: str) -> float:
    """Parse a part of one, for argparse."""
    value = options.finite(text)
    if not 0.0 <= value < 1.0:
        raise argparse.ArgumentTypeError(f"{text} is no part of 0 to below 1")
    return value


@contextmanager
def _progress(points: int) -> Iterator[Callable[[int], None]]:
    """Show on a terminal how far the computation is; yields what is called with the points that are done."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    shown = console.is_terminal and loudness() is not Loudness.QUIET
    with Progress(*columns, console=console, transient=True, disable=not shown) as progress:
        task = progress.add_task("points", total=points)
        yield lambda done: progress.advance(task, done)


def _text(summary: dict[str, Any]) -> str:
    """Return the summary for people."""
    from goldfield.planning.layers import shown

    def row(name: str, key: str, unit: str, factor: float = 1.0) -> str:
        values = [summary[key][which] for which in ("median", "p95", "worst")]
        cells = ["unbounded" if value is None else f"{shown(factor * value)} {unit}" for value in values]
        return f"{name:18}" + "".join(f"{cell:>14}" for cell in cells)

    lines = [
        f"{summary['points']} points, {summary['beacons']} beacons",
        f"{'':18}{'median':>14}{'95 %':>14}{'worst':>14}",
        row("position bound", "position_m", "cm", 100.0),
        row("attitude bound", "attitude_rad", "deg", 180.0 / np.pi),
        row("protection level", "protection_m", "cm", 100.0),
        f"ambiguous {100 * summary['ambiguous']:.3g} % of the points, weak {100 * summary['weak']:.3g} %",
        f"{summary['codes']} codes are enough for the {summary['beacons']} beacons",
    ]
    if summary["truncation"] != 0.0:
        part = "unbounded" if summary["truncation"] is None else f"{100 * summary['truncation']:.2g} %"
        lines.append(f"far beacons are left out: the bounds are too large by at most {part}")
    return "\n".join(lines)
