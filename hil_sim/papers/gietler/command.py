"""``goldfield paper gietler``: moving emitters tracked by a fixed sensor, with and without a conductor beside them."""

from __future__ import annotations

import argparse
import math
from typing import Any

from goldfield.cli.options import add_force
from hil_sim.papers.actions import action


def command(subparsers: Any) -> None:
    """Add the subcommand to ``goldfield paper``."""
    parser = subparsers.add_parser(
        "gietler",
        help="moving emitters beside conductors, tracked by a fixed sensor",
        description="The system of Gietler, Ammari and Zangl, simulated. Exit code 3: a figure misses its goal.",
    )
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    track = _add(actions, "track", "base against extended model beside carbon, copper, a permeable body")
    track.add_argument("--body", choices=("sphere", "cube"), default="sphere", help=_BODY_HELP)
    track.add_argument("--path", choices=("brownian", "helix"), default="brownian", help="default: brownian")
    track.add_argument(
        "--material", choices=("all", "carbon", "copper", "permeable"), default="all", help="default: all"
    )
    _seeded(track, runs=5)
    _frequency(track)
    converge = _add(actions, "converge", "iterated against plain filter from the paper's poor guess")
    _seeded(converge, runs=200)
    table = _add(actions, "table", "the paper's Tables I and II beside our solutions")
    _frequency(table)
    formula = _add(actions, "formula", "the explicit formula beside the exact series of a sphere")
    _frequency(formula)


_BODY_HELP = (
    "what moves with the emitters: a sphere of the cube's volume, whose field is known exactly (default), or the "
    "paper's cube (copper only, as a perfect conductor, by boundary elements)"
)


def _add(actions: Any, name: str, what: str) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = actions.add_parser(name, help=what, description=what)
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    parser.add_argument("--figure", metavar="FILE.png", help="draw it")
    add_force(parser)
    parser.set_defaults(run=action(f"gietler.reports:run_{name}"))
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
