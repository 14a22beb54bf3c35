"""Options that several subcommands share, each with its environment variable."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable
from typing import Any

import numpy as np

from goldfield.errors import UserError, counted, tell
from goldfield.files.environment import switched_on
from goldfield.site import Site

MOST_DOUBTS = 3
"""Unusual values of a site file that are told one by one."""


def add(
    parser: argparse.ArgumentParser,
    name: str,
    *,
    metavar: str,
    what: str,
    kind: Callable[[str], Any] = str,
    alone: str | None = None,
) -> None:
    """Add an option whose default is the environment variable GOLDFIELD_NAME; ``alone``: its value if it has none."""
    variable = environment_name(name)
    parser.add_argument(
        name,
        metavar=metavar,
        type=kind,
        nargs=None if alone is None else "?",
        const=alone,
        default=os.environ.get(variable) or None,
        help=f"{what} (environment: {variable})",
    )


def add_site(parser: argparse.ArgumentParser) -> None:
    """Add ``--site``; `required` says when it is missing."""
    add(parser, "--site", metavar="FILE", what="site file (TOML)")


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add ``--json``."""
    add_switch(parser, "--json", what="one JSON object a line on stdout")


def add_switch(parser: argparse.ArgumentParser, name: str, *, what: str) -> None:
    """Add an option without a value, which the environment variable GOLDFIELD_NAME sets too."""
    variable = environment_name(name)
    parser.add_argument(
        name,
        action="store_true",
        default=switched_on(variable),
        help=f"{what} (environment: {variable})",
    )


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add ``--force``, for a command that writes files."""
    parser.add_argument("--force", action="store_true", help="overwrite files that are not empty")


def add_box(parser: argparse.ArgumentParser) -> None:
    """Add ``--box`` and ``--step``: a grid of places."""
    parser.add_argument(
        "--box",
        nargs=6,
        type=finite,
        metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="two opposite corners of the box, m, the lower first",
    )
    parser.add_argument("--step", type=metres, metavar="METRES", help="distance of the grid's points")


def grid_of(arguments: argparse.Namespace) -> Any:
    """Return the grid (`goldfield.planning.Grid`) of ``--box`` and ``--step``; `UserError` if they are none."""
    if arguments.box is None or arguments.step is None:
        raise UserError("--box or --step is missing: give --box X0 Y0 Z0 X1 Y1 Z1, the corners, and --step METRES")
    from goldfield.planning import Grid  # heavy: only when something is planned

    return Grid.of_box(np.array(arguments.box[:3]), np.array(arguments.box[3:]), arguments.step)


def required(value: str | None, name: str, metavar: str) -> str:
    """Return the value of an option that must be given."""
    if not value:
        raise UserError(f"{name} is missing: give {name} {metavar} or set {environment_name(name)}")
    return value


def tell_idle(arguments: argparse.Namespace, names: tuple[str, ...], where: str) -> None:
    """Say which options of a command line have no effect, such as ("--seconds",) with "FIELDS.csv"."""
    values = {name: getattr(arguments, name.lstrip("-").replace("-", "_")) for name in names}
    given = [name for name, value in values.items() if value or value == ""]  # "": an option that may stand alone
    told = [name for name in given if not os.environ.get(environment_name(name))]
    if told:
        verb = "has" if len(told) == 1 else "have"
        tell(f"{' and '.join(told)} {verb} no effect with {where}")


def tell_assumed(site: Site) -> None:
    """Say once, on stderr, what is assumed where the site file is silent, and what in it is doubtful."""
    tell_doubts(site)
    if site.assumed:
        tell(f"the site file is silent, so this is assumed: {', '.join(site.assumed)} (0 says that it is exact)")


def tell_doubts(site: Site) -> None:
    """Say once, on stderr, which values of the site file are unusual: the first few, since often all are alike."""
    for doubt in site.doubts[:MOST_DOUBTS]:
        tell(doubt)
    if len(site.doubts) > MOST_DOUBTS:
        tell(counted(len(site.doubts) - MOST_DOUBTS, "more values of the site file are unusual"))


def environment_name(option: str) -> str:
    """Return the environment variable of an option.

    Examples
    --------
    >>> environment_name("--site")
    'GOLDFIELD_SITE'
    """
    return "GOLDFIELD_" + option.removeprefix("--").replace("-", "_").upper()


def finite(text: str) -> float:
    """Parse a finite number, for argparse."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) < 1e9:
        raise argparse.ArgumentTypeError(f"{text} is no finite number")
    return value


def seconds(text: str) -> float:
    """Parse a duration greater than zero, for argparse."""
    return _between(text, 0.0, 1e9, "number of seconds greater than zero")


def metres(text: str) -> float:
    """Parse a length greater than zero, for argparse."""
    return _between(text, 0.0, 1e9, "length in metres greater than zero")


def hertz(text: str) -> float:
    """Parse a frequency of more than 1 Hz, for argparse."""
    return _between(text, 1.0, 1e6, "frequency of 1 to 1000000 Hz")


def milliseconds(text: str) -> float:
    """Parse a number of milliseconds greater than zero as seconds, for argparse; the pipeline says how many at most."""
    return 1e-3 * _between(text, 0.0, math.inf, "number of milliseconds greater than zero")


def rate(text: str) -> float:
    """Parse a rate greater than zero, for argparse; how large it may be, the pipeline says."""
    return _between(text, 0.0, math.inf, "rate in hertz greater than zero")


def _between(text: str, least: float, most: float, what: str) -> float:
    """Parse a number between two limits, which are not allowed themselves."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (least < value and math.isfinite(value)):
        raise argparse.ArgumentTypeError(f"{text} is no {what}")
    if value >= most:
        raise argparse.ArgumentTypeError(f"{text} is too large: give less than {most:g}")
    return value


def bit_rate(text: str) -> int:
    """Parse a bit rate as a whole number, for argparse; which there are, the link says."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value.is_integer()):
        raise argparse.ArgumentTypeError(f"{text} is no whole number of bits a second")
    return int(value)


def count(text: str) -> int:
    """Parse a number of at least 1, for argparse."""
    if not (text.isascii() and text.isdigit() and len(text) <= 6 and 1 <= int(text) <= 100_000):
        raise argparse.ArgumentTypeError(f"{text} is no whole number of 1 to 100000")
    return int(text)


def node(text: str) -> int:
    """Parse a node number, for argparse."""
    if not (text.isascii() and text.isdigit() and len(text) <= 4 and 1 <= int(text) <= 4095):
        raise argparse.ArgumentTypeError(f"{text} is no node: nodes are 1 to 4095")
    return int(text)
