"""Entry of the command: parser, subcommands of other packages, and the exit codes 0, 2 and 3."""

from __future__ import annotations

import argparse
import os
import sys
import traceback
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points, version
from typing import Any, NoReturn

from goldfield.cli import locate, run, samples, separate
from goldfield.errors import SystemFailure, UserError

EXIT_USAGE = 2
EXIT_FAILED = 3
EXIT_INTERRUPTED = 130
COMMAND_GROUP = "goldfield.commands"


class Parser(argparse.ArgumentParser):
    """A parser whose complaint is one line."""

    def error(self, message: str) -> NoReturn:
        """Print the complaint and exit with 2."""
        self.exit(EXIT_USAGE, f"{self.prog}: {message}; see {self.prog} --help\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    0: done; 2: bad usage or bad input; 3: the boards, the link or this program failed. A traceback is shown only with
    ``GOLDFIELD_DEBUG=1``.
    """
    try:
        arguments = build_parser().parse_args(argv)
        return int(arguments.run(arguments))
    except UserError as error:
        return _complain(str(error), EXIT_USAGE)
    except SystemFailure as error:
        return _complain(str(error), EXIT_FAILED)
    except BrokenPipeError:
        # The reader of our output went away, as in "| head": that ends us, and is no error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except Exception as error:
        return _complain(
            f"unexpected {type(error).__name__}: {error}; this is a defect of goldfield: please report it with the "
            "output of the same command under GOLDFIELD_DEBUG=1",
            EXIT_FAILED,
        )


def build_parser() -> argparse.ArgumentParser:
    """Build the parser with the subcommands of this package and of every installed one."""
    parser = Parser(prog="goldfield", description="Indoor position and attitude from coded magnetic fields.")
    parser.add_argument("--version", action="version", version=f"goldfield {version('goldfield')}")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for module in (run, locate, samples, separate):
        module.command(subparsers)
    for entry_point in entry_points(group=COMMAND_GROUP):
        _add_foreign(subparsers, entry_point)
    return parser


def _add_foreign(subparsers: Any, entry_point: EntryPoint) -> None:
    """Add a subcommand of another package; a broken one stays visible and says what is wrong when it is called."""
    try:
        entry_point.load()(subparsers)
    except Exception as error:
        if entry_point.name in subparsers.choices:
            return
        reason = (
            f"the command {entry_point.name} of {entry_point.value} cannot be loaded: {type(error).__name__}: {error}"
        )

        def unavailable(_: argparse.Namespace, reason: str = reason) -> int:
            raise SystemFailure(reason)

        broken = subparsers.add_parser(entry_point.name, help="(cannot be loaded)", add_help=False, prefix_chars="\0")
        broken.add_argument("rest", nargs="*")  # with no prefix that anyone types, options are taken too
        broken.set_defaults(run=unavailable)


def _complain(message: str, code: int) -> int:
    if os.environ.get("GOLDFIELD_DEBUG") == "1":
        traceback.print_exc()
    print(f"goldfield: {' '.join(message.split())}", file=sys.stderr)
    return code
