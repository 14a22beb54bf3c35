"""``goldfield plot``: the usual pictures of a run on one page."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from goldfield.cli import options
from goldfield.cli.export import add_run, beside
from goldfield.errors import UserError, counted, on_command_line, tell
from goldfield.files.inputs import STREAM
from goldfield.files.outputs import check_outputs, write_file

OTHER_KINDS = (".jpg", ".jpeg", ".svg", ".pdf", ".webp", ".gif", ".tif", ".tiff", ".bmp", ".eps", ".html", ".npz")
"""Ends of names that promise another format."""


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "plot",
        help="pictures of a run: track, errors, residuals, rates",
        description="Draw the track over the plan of the coils, errors or standard deviations, the residual of each "
        "beacon, rates and latency of a run, as a PNG.",
    )
    add_run(parser)
    options.add(parser, "--truth", metavar="FILE", what="the simulator's truth, to compare with")
    options.add(parser, "--out", metavar="FILE", what="where to, - is stdout (default: FILE.png)")
    options.add_force(parser)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Draw the page."""
    from goldfield.recording.pictures import picture, read  # heavy: only when a run is drawn
    from goldfield.recording.runs import open_run
    from goldfield.site import load
    from goldfield.view.truth import Truth

    out = arguments.out or beside(arguments.file, ".png")
    if Path(out).suffix.lower() in OTHER_KINDS:
        raise UserError(f"--out {out}: pictures are written as PNG: give a name that ends in .png")
    inputs = {"FILE": arguments.file, "--site": arguments.site, "--truth": arguments.truth}
    check_outputs({"--out": out}, inputs, force=arguments.force)
    run_read = open_run(arguments.file, arguments.site, again=arguments.again)
    truth = Truth(arguments.truth, wait_s=0.0) if arguments.truth else None
    poses, errors = read(run_read, truth)
    if not len(poses):
        raise UserError(f"{run_read.name}: holds no pose: there is nothing to draw")
    if truth is not None and not any(map(math.isfinite, errors.position_m)):
        tell(f"{arguments.truth}: tells of none of these poses: their errors are not known")
    site = load(arguments.site) if arguments.site else run_read.site
    write_file(out, picture(Path(run_read.name).name, poses, errors, site), "the picture", force=arguments.force)
    if out != STREAM:
        tell(f"{out}: {counted(len(poses), 'poses')}")
    return 0
