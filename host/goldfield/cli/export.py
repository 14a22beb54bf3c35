"""``goldfield export``: the poses and fields of a run as CSV, NPZ or Parquet."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from goldfield.cli import options
from goldfield.errors import UserError, counted, on_command_line, tell
from goldfield.files.inputs import STREAM
from goldfield.files.outputs import check_outputs, write_file

TABLES = ("poses", "fields")
FORMATS = ("csv", "npz", "parquet")


def add_run(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that name a run, which `opened` opens."""
    parser.add_argument(
        "file",
        metavar="FILE",
        help="recording in MCAP, lines of goldfield run --json, or with --site a log of messages; - is stdin",
    )
    options.add(parser, "--site", metavar="FILE", what="site file (TOML), unless the recording has it")
    parser.add_argument(
        "--again", action="store_true", help="poses that today's estimator makes of the recording's messages"
    )


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "export",
        help="poses and fields of a run as CSV, NPZ or Parquet",
        description="Write the poses or the separated fields of a run as a table.",
    )
    add_run(parser)
    parser.add_argument("--to", choices=FORMATS, required=True, help="format of the table")
    parser.add_argument("--table", choices=TABLES, help="what is written (default: poses; with npz both)")
    options.add(parser, "--out", metavar="FILE", what="where to, - is stdout (default: FILE with the format's ending)")
    options.add_force(parser)
    parser.set_defaults(run=run)


@on_command_line()
def run(arguments: argparse.Namespace) -> int:
    """Write the table."""
    from goldfield.recording.runs import open_run  # heavy: only when a run is read
    from goldfield.recording.tables import WRITERS, tables_of

    ending = f".fields.{arguments.to}" if arguments.table == "fields" else f".{arguments.to}"
    out = arguments.out or beside(arguments.file, ending)
    check_outputs({"--out": out}, {"FILE": arguments.file, "--site": arguments.site}, force=arguments.force)
    poses, fields = tables_of(open_run(arguments.file, arguments.site, again=arguments.again))
    if arguments.table == "fields" and not len(fields):
        raise UserError(f"{arguments.file}: holds no fields: give a recording in MCAP, or a log with --site")
    if arguments.to == "npz":
        columns = {} if arguments.table == "fields" else {"beacons": _texts(poses.beacons), **poses.columns()}
        if arguments.table != "poses" and len(fields):
            columns |= {f"fields_{name}": column for name, column in fields.columns().items()}
    else:
        columns = fields.columns() if arguments.table == "fields" else poses.flat()
    write_file(out, WRITERS[arguments.to](columns), "the table", force=arguments.force)
    what = counted(len(fields), "rows of fields") if arguments.table == "fields" else counted(len(poses), "poses")
    if out != STREAM:
        tell(f"{out}: {what}")
    return 0


def beside(file: str, ending: str) -> str:
    """Return where what is made of a run goes if no place is given; `UserError` for a run from stdin."""
    if file == STREAM:
        raise UserError("--out is missing: a run from stdin has no name to go by")
    return str(Path(file).with_suffix(ending))


def _texts(values: list[str]) -> Any:
    import numpy as np

    return np.array(values, dtype=np.str_)
