"""The exceptions whose text a user reads: one sentence that says what was wrong, where, and what to do."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from enum import Enum

EXIT_USAGE, EXIT_FAILED, EXIT_INTERRUPTED = 2, 3, 130
"""Exit codes of the command line for what the exceptions of this module say, and for an interrupt."""

_on_command_line: ContextVar[bool] = ContextVar("on_command_line", default=False)


class UserError(Exception):
    """Bad usage or bad input; the CLI prints it as one line and exits with 2."""


class SystemFailure(Exception):
    """The boards or the link to them failed; the CLI prints it as one line and exits with 3."""


class Loudness(Enum):
    """How much is told on stderr."""

    QUIET = -1
    """Failures alone."""
    USUAL = 0
    VERBOSE = 1
    """Tracebacks, and the log of python-can, too."""


_loudness = Loudness.USUAL


def loudness() -> Loudness:
    """Return how much is told."""
    return _loudness


def set_loudness(wanted: Loudness) -> None:
    """Say how much is told from now on, in every thread."""
    global _loudness
    _loudness = wanted
    if wanted is Loudness.VERBOSE:
        import logging  # takes time that most runs need not spend

        logging.basicConfig(level=logging.DEBUG, format="goldfield: %(name)s: %(message)s")


def tell(message: str, *, failure: bool = False) -> None:
    """Print a line for the user on stderr; one that is full or closed must end neither the run nor a thread of it.

    Parameters
    ----------
    message : str
        A sentence.
    failure : bool
        It says what failed: it is told however quiet the rest is.
    """
    if sys.stderr is not None and (failure or _loudness is not Loudness.QUIET):
        with suppress(OSError, ValueError):  # ValueError: a stream that was closed
            print(f"goldfield: {printable(message)}", file=sys.stderr, flush=True)


def printable(text: str) -> str:
    r"""Return a text that others wrote with an escape for whatever would act on a terminal in place of being shown.

    Every text of a file, a link or a command line goes through this function before it is printed: `tell` does it for
    the sentences that it is given.

    Examples
    --------
    >>> printable("hall\x1b[2J\nleft"), printable("Hörsaal 3")
    ('hall\\x1b[2J\\nleft', 'Hörsaal 3')
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


def counted(count: int, phrase: str) -> str:
    """Return a number with what it counts, a phrase in the plural that is put into the singular for 1.

    The first noun loses its s, a second one behind "or" too, and the verb follows.

    Examples
    --------
    >>> counted(2, "messages of other channels"), counted(1, "messages of other channels")
    ('2 messages of other channels', '1 message of other channels')
    >>> counted(1, "garbled lines or datagrams"), counted(1, "frames were corrupt"), counted(0, "bus errors")
    ('1 garbled line or datagram', '1 frame was corrupt', '0 bus errors')
    """
    if count == 1:
        phrase = _PLURAL.sub(lambda nouns: " or ".join(map(_singular, nouns[0].split(" or "))), phrase, count=1)
        phrase = re.sub(r"\b(?:were|are|have|need)\b", lambda verb: _SINGULAR[verb[0]], phrase, count=1)
    return f"{count} {phrase}"


def listed(items: Iterable[object]) -> str:
    """Return things in one row of words.

    Examples
    --------
    >>> listed(["b1"]), listed([3, 4]), listed("xyz"), listed(())
    ('b1', '3 and 4', 'x, y and z', '')
    """
    *rest, last = [*map(str, items)] or [""]
    return f"{', '.join(rest)} and {last}" if rest else last


def _singular(noun: str) -> str:
    if noun == "axes":
        return "axis"
    return f"{noun[:-3]}y" if noun.endswith("ies") else noun[:-1]


_PLURAL = re.compile(r"\b[a-z]+[^sui\W]s\b(?: or [a-z]+s\b)?")
_SINGULAR = {"were": "was", "are": "is", "have": "has", "need": "needs"}


def option(name: str, value: object = "") -> str:
    """Return how the reader of an error gives an option: a keyword argument, or within `on_command_line` an option.

    The unit at the end of a keyword argument is no part of the option's name.

    Examples
    --------
    >>> option("node", 3), option("port")
    ('node=3', 'port=')
    >>> with on_command_line():
    ...     option("node", 3), option("on_sensor"), option("rate_hz"), option("conflict_dB")
    ('--node 3', '--on-sensor', '--rate', '--conflict')
    """
    if _on_command_line.get():
        return f"--{name.removesuffix('_hz').removesuffix('_s').removesuffix('_dB').replace('_', '-')} {value}".rstrip()
    return f"{name}={value}"


@contextmanager
def on_command_line() -> Iterator[None]:
    """Make the errors that are raised meanwhile name options as the command line does; serves as a decorator too."""
    token = _on_command_line.set(True)
    try:
        yield
    finally:
        _on_command_line.reset(token)
