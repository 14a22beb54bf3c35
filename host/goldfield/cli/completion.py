"""``goldfield completion``: what a shell needs to complete this command line."""

from __future__ import annotations

import argparse
from typing import Any

SHELLS = ("bash", "zsh")
FILES = ("FILE", "PATH", "SECOND", "FIELDS.csv", "SAMPLES.csv", "BODY.toml", "SCENARIO")
"""Placeholders of values that are names of files."""


def command(subparsers: Any) -> None:
    """Add the subcommand."""
    parser = subparsers.add_parser(
        "completion",
        help="completion for bash or zsh",
        description="Prints what a shell needs to complete commands, options and files; docs/cli.md says where to put "
        "it.",
    )
    parser.add_argument("shell", choices=SHELLS)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Print the completion of a parser that knows every subcommand."""
    import shtab  # only when somebody asks

    from goldfield.cli.entry import build_parser

    parser = build_parser(every=True)
    _complete_files(parser, shtab.FILE)
    print(shtab.complete(parser, arguments.shell))
    return 0


def _complete_files(parser: argparse.ArgumentParser, file: object) -> None:
    """Mark the options and arguments of a parser, and of those below it, that take the name of a file."""
    for action in parser._actions:
        if action.metavar in FILES:
            action.complete = file  # type: ignore[attr-defined]  # shtab looks for this attribute
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                _complete_files(below, file)
