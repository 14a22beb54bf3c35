"""The options that name a link: ``--port``, ``--can``, and for what can also be replayed ``--log``."""

from __future__ import annotations

import argparse
import os

from goldfield.cli import options
from goldfield.errors import UserError

LINKS = {
    "port": ("PATH", "serial port of the sensor"),
    "can": ("INTERFACE:CHANNEL", "python-can interface and channel, as socketcan:can0"),
    "log": (
        "FILE",
        "recording instead of a sensor: of candump, or .asc, .blf, .csv, .db, .mf4, .trc; - is stdin",
    ),
}


def add(parser: argparse.ArgumentParser, *, log: bool = False, nested: bool = False) -> None:
    """Add the options; ``nested``: to the parser of an action, where they do not undo what stands before it."""
    for name, (metavar, what) in LINKS.items():
        if name != "log" or log:
            variable = options.environment_name(name)
            parser.add_argument(
                f"--{name}",
                metavar=metavar,
                default=argparse.SUPPRESS if nested else None,
                help=f"{what} (environment: {variable}, unless another is given)",
            )


def chosen(arguments: argparse.Namespace) -> tuple[str, str]:
    """Return kind and place of the link: the command line's, else the environment's.

    Raises
    ------
    UserError
        If none or more than one is given.
    """
    names = [name for name in LINKS if hasattr(arguments, name)]
    given = {name: getattr(arguments, name) for name in names if getattr(arguments, name) is not None}
    if not given:
        given = {
            name: os.environ[variable] for name in names if os.environ.get(variable := options.environment_name(name))
        }
    if len(given) != 1:
        wanted = [f"--{name} {LINKS[name][0]}" for name in names]
        raise UserError(
            f"{'no source is' if not given else 'more than one source is'} given: give one of "
            f"{', '.join(wanted[:-1])} and {wanted[-1]}"
        )
    ((kind, where),) = given.items()
    if not where:
        raise UserError(f"--{kind} is empty: give a value")
    return kind, where
