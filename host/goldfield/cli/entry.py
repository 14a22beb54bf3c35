"""Entry of the command: parser, subcommands of other packages, and the exit codes 0, 2 and 3.

Only the subcommand that was called is imported: the others are known by name and one line of help.
"""

from __future__ import annotations

import argparse
import ast
import errno
import io
import os
import sys
import traceback
from collections.abc import Iterable, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from goldfield.errors import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    EXIT_USAGE,
    Loudness,
    SystemFailure,
    UserError,
    loudness,
    printable,
    set_loudness,
    tell,
)
from goldfield.files.environment import switched_on
from goldfield.files.inputs import reason_of

if TYPE_CHECKING:
    from importlib.metadata import Distribution, EntryPoint

COMMANDS = {
    "run": ("goldfield.cli.run", "live poses from a sensor"),
    "locate": ("goldfield.cli.locate", "poses from a table of fields"),
    "view": ("goldfield.cli.view", "live page: poses and beacons in the browser"),
    "monitor": ("goldfield.cli.monitor", "live health of a sensor and its beacons"),
    "compare-runs": ("goldfield.cli.compare_runs", "recorded poses beside today's, or two runs"),
    "export": ("goldfield.cli.export", "poses and fields of a run as CSV, NPZ or Parquet"),
    "plot": ("goldfield.cli.plot", "pictures of a run: track, errors, residuals, rates"),
    "ports": ("goldfield.cli.ports", "serial ports and CAN interfaces"),
    "doctor": ("goldfield.cli.doctor", "what is wrong, and what to do"),
    "calibrate": ("goldfield.cli.calibrate", "what sensor and coils are really like"),
    "nodes": ("goldfield.cli.nodes", "boards of a link: parameters, numbers, start, stop"),
    "site": ("goldfield.cli.site", "boards set to a site, or compared with it"),
    "flash": ("goldfield.cli.flash", "new images for the boards of a link"),
    "image": ("goldfield.cli.image", "images signed for boards, and what a file of them holds"),
    "keys": ("goldfield.cli.keys", "the key pair that signs a site's images"),
    "samples": ("goldfield.cli.samples", "raw samples of a sensor"),
    "completion": ("goldfield.cli.completion", "completion for bash or zsh"),
    "separate": ("goldfield.cli.separate", "field of each beacon from raw samples"),
    "survey": ("goldfield.cli.survey", "beacons and sensor as they are, from a walk"),
    "plan": ("goldfield.cli.plan", "accuracy everywhere in a room, before anything is installed"),
}
"""Each subcommand of this package: the module whose function ``command`` adds its parser, and its line of help."""
COMMAND_GROUP = "goldfield.commands"
OWN_PACKAGES = ("goldfield", "hil_sim")
"""What begins so is part of every installation; other packages are needed by some commands only."""
LONGEST_COMPLAINT = 600


class _Formatter(argparse.HelpFormatter):
    """Leaves room for the longest subcommand, whose indent argparse does not count."""

    def add_argument(self, action: argparse.Action) -> None:
        """See `argparse.HelpFormatter`."""
        super().add_argument(action)
        for below in self._iter_indented_subactions(action):
            width = len(self._format_action_invocation(below)) + self._current_indent
            self._action_max_length = max(self._action_max_length, width)


class Parser(argparse.ArgumentParser):
    """A parser whose complaint is one line, and which knows ``-q`` and ``-v`` wherever they stand."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.helpful = self.prog
        """The command whose ``--help`` a complaint names: what a subcommand left over is complained of by the whole."""
        if "-" in self.prefix_chars and self.add_help:
            for letter, loudness, text in (
                ("q", Loudness.QUIET, "tell on stderr what failed, and nothing else"),
                ("v", Loudness.VERBOSE, "tell more on stderr: tracebacks, and the log of python-can"),
            ):
                self.add_argument(
                    f"-{letter}",
                    f"--{loudness.name.lower()}",
                    dest="loudness",
                    action="store_const",
                    const=loudness,
                    default=argparse.SUPPRESS,
                    help=text,
                )

    def error(self, message: str) -> NoReturn:
        """Print the complaint and exit with 2."""
        if len(message) > LONGEST_COMPLAINT:  # a word of thousands of letters is in it
            message = f"{message[: LONGEST_COMPLAINT // 2]} ... {message[-LONGEST_COMPLAINT // 2 :]}"
        self.exit(EXIT_USAGE, f"{self.prog}: {printable(message)}; see {self.helpful} --help\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    0: done; 2: bad usage or bad input; 3: the boards, the link or this program failed. A traceback is shown only with
    ``GOLDFIELD_DEBUG=1``.
    """
    # A stream that was closed before the start is None, for which print would take stdout.
    sys.stdout = sys.stdout or Path(os.devnull).open("w")  # noqa: SIM115 - stays open to the end
    sys.stderr = sys.stderr or Path(os.devnull).open("w")  # noqa: SIM115
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Who reads a pipe gets each line at once, and a letter that the terminal does not have is no error.
        sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")
    try:
        code = _outcome(sys.argv[1:] if argv is None else list(argv))
    except SystemExit as end:  # of a parser: help, version or a complaint
        raise SystemExit(_flushed(int(end.code or 0))) from None
    return _flushed(code)


def _outcome(words: list[str]) -> int:
    """Run a command, tell what went wrong, and return the exit code."""
    try:
        arguments = build_parser(_called(words)).parse_args(words)
        set_loudness(getattr(arguments, "loudness", Loudness.USUAL))
        return int(arguments.run(arguments))
    except UserError as error:
        return _complain(str(error), EXIT_USAGE)
    except SystemFailure as error:
        return _complain(str(error), EXIT_FAILED)
    except BrokenPipeError:
        return 0  # The reader of our output went away, as in "| head": that ends us, and is no error.
    except OSError as error:
        return _complain(_refused(error), EXIT_FAILED)
    except MemoryError:
        return _complain("the memory does not hold what was asked for: give less", EXIT_FAILED)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except Exception as error:
        if isinstance(error, ModuleNotFoundError) and not (error.name or "").startswith(OWN_PACKAGES):
            from importlib.metadata import distribution  # heavy, here and below: most commands need nothing of it

            return _complain(f"a package is missing: {error}{_extras(distribution('goldfield'))}", EXIT_FAILED)
        return _complain(
            f"unexpected {type(error).__name__}: {error}; this is a defect of goldfield: please report it with the "
            "output of the same command under GOLDFIELD_DEBUG=1",
            EXIT_FAILED,
        )


def _refused(error: OSError) -> str:
    """Return what the system refused; an error without a file is of a stream, and one of a full disk of the output."""
    if error.filename is not None:
        return f"{error.filename}: cannot be read or written: {reason_of(error)}"
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return f"the output cannot be written: {reason_of(error)}: make room, or write to another place"
    return f"the system refused to read or write: {reason_of(error)}"


def _called(words: list[str]) -> str | None:
    """Return the first word that is not ``-q`` or ``-v``: the name of the subcommand, or an option such as --help."""
    return next((word for word in words if word not in ("-q", "--quiet", "-v", "--verbose")), None)


def _flushed(code: int) -> int:
    """Write out what is buffered and return the exit code; Python itself would end with 120 if that fails."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, KeyboardInterrupt) as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            if isinstance(error, KeyboardInterrupt):
                code = EXIT_INTERRUPTED
            elif stream is sys.stdout and code == 0 and not isinstance(error, BrokenPipeError):
                code = _complain(_refused(error), EXIT_FAILED)
    return code


class _Version(argparse.Action):
    """Print the installed version and the hash of the protocol, which take time to look up, and exit."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """See `argparse.Action`."""
        from importlib.metadata import version

        from goldfield_protocol.messages import protocol_hash  # reads the table of all messages

        print(f"goldfield {version('goldfield')}, protocol {protocol_hash():#010x}")
        parser.exit()


def build_parser(called: str | None = None, *, every: bool = False) -> argparse.ArgumentParser:
    """Build the parser.

    Parameters
    ----------
    called : str, optional
        First word of the command line. The subcommand of this name is loaded; of the others the parser knows the name
        and the line of help only. Other packages are not searched for a word that this package knows.
    every : bool
        Load every subcommand.
    """
    parser = Parser(
        prog="goldfield",
        description="Indoor position and attitude from coded magnetic fields.",
        formatter_class=_Formatter,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="show version and protocol, and exit")
    subparsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for name, (module, summary) in COMMANDS.items():
        if every or name == called:
            import_module(module).command(_Summarised(subparsers, summary))
        else:
            subparsers.add_parser(name, help=summary, add_help=False)
    known = called in COMMANDS or called == "--version"
    for entry_point in () if known else _foreign():
        if entry_point.name in subparsers.choices:
            continue
        if every or entry_point.name == called:
            _add_foreign(_Summarised(subparsers, _summary(entry_point) if every else ""), entry_point)
        else:
            subparsers.add_parser(entry_point.name, help=_summary(entry_point), add_help=False)
    if called in subparsers.choices:
        parser.helpful = subparsers.choices[called].prog
    return parser


def _foreign() -> Iterable[EntryPoint]:
    """Return the subcommands that other packages bring."""
    from importlib.metadata import entry_points

    return entry_points(group=COMMAND_GROUP)


class _Summarised:
    """The subparsers of the command, each with a line of help, without which it would be in no list."""

    def __init__(self, subparsers: Any, summary: str) -> None:
        self._subparsers = subparsers
        self._summary = summary
        self.choices = subparsers.choices

    def add_parser(self, name: str, **options: Any) -> argparse.ArgumentParser:
        """Add a subcommand."""
        parser: argparse.ArgumentParser = self._subparsers.add_parser(name, **{"help": self._summary, **options})
        return parser


def _summary(entry_point: EntryPoint) -> str:
    """Return the line of help of another package's subcommand, without running its module.

    It is the first line of the module's docstring: "``goldfield NAME``: line of help."
    """
    module = entry_point.value.partition(":")[0]
    try:
        spec = find_spec(module)
        source = Path(spec.origin).read_text(encoding="utf-8")  # type: ignore[union-attr, arg-type]  # caught below
        first, *_ = (ast.get_docstring(ast.parse(source)) or "").splitlines() or [""]
    except Exception:
        return "(cannot be loaded)"
    summary = first.removeprefix(f"``goldfield {entry_point.name}``: ").rstrip(".")
    return (summary or f"see goldfield {entry_point.name} --help").replace("%", "%%")


def _add_foreign(subparsers: Any, entry_point: EntryPoint) -> None:
    """Add the subcommand of another package; a broken one says what is wrong with it when it is called."""
    name = entry_point.name
    try:
        entry_point.load()(subparsers)
        reason = "it adds no subcommand of this name"
    except ModuleNotFoundError as error:
        reason = f"{type(error).__name__}: {error}{_extras(getattr(entry_point, 'dist', None))}"
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"
    if name in subparsers.choices:
        return

    def unavailable(_: argparse.Namespace) -> int:
        raise SystemFailure(f"the command {name} of {entry_point.value} cannot be loaded: {reason}")

    broken = subparsers.add_parser(name, add_help=False, prefix_chars="\0")
    broken.add_argument("rest", nargs="*")  # with no prefix that anyone types, options are taken too
    broken.set_defaults(run=unavailable)


def _extras(package: Distribution | None) -> str:
    """Return how to install everything that a package can use, if it names any extras."""
    extras = package.metadata.get_all("Provides-Extra") if package else None
    return f"; pip install '{package.name}[{','.join(extras)}]' brings what it needs" if package and extras else ""


def _complain(message: str, code: int) -> int:
    if switched_on("GOLDFIELD_DEBUG") or loudness() is Loudness.VERBOSE:
        traceback.print_exc()
    tell(" ".join(message.split()), failure=True)
    return code
