"""What the long commands of the tests have in common: numbers in ranges, files of results, and errors in a sentence."""

from __future__ import annotations

import argparse
import ctypes
import fcntl
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from goldfield.errors import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_USAGE, SystemFailure, UserError, tell

T = TypeVar("T")
PR_SET_PDEATHSIG = 1
"""An option of Linux's `prctl`."""

# ---- Numbers and names ----


def whole_number(least: int = 0) -> Callable[[str], int]:
    """Return a type of argparse: a whole number that is not less."""

    def read(word: str) -> int:
        if not word.removeprefix("-").isdecimal() or int(word) < least:
            raise argparse.ArgumentTypeError(f"{word!r} is no whole number from {least} on")
        return int(word)

    return read


def real_number(least: float, most: float = math.inf) -> Callable[[str], float]:
    """Return a type of argparse: a finite number that is neither less nor more."""

    def read(word: str) -> float:
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not least <= value <= most or math.isinf(value):
            upper = "on" if math.isinf(most) else f"to {most:g}"
            raise argparse.ArgumentTypeError(f"{word!r} is no number from {least:g} {upper}")
        return value

    return read


def one_of(names: Collection[str]) -> Callable[[str], str]:
    """Return a type of argparse: one of these names; `choices` would refuse that none is given where none need be."""

    def read(word: str) -> str:
        if word not in names:
            raise argparse.ArgumentTypeError(f"{word!r} is none of {', '.join(names)}")
        return word

    return read


# ---- The end ----


def ended(main: Callable[[], int]) -> int:
    """Run a command and return its exit code; what goes wrong is told in a sentence.

    An interrupt ends the process where it is, were it in a call of C's that would swallow an exception: what is kept
    of a run is written as it comes.
    """
    signal.signal(signal.SIGINT, _stopped)
    try:
        return main()
    except UserError as error:
        return _told(str(error), EXIT_USAGE)
    except SystemFailure as error:
        return _told(str(error), EXIT_FAILED)
    except OSError as error:
        what = "the system" if error.filename is None else str(error.filename)
        return _told(f"{what}: cannot be read or written: {error.strerror or error}", EXIT_FAILED)


def _told(sentence: str, code: int) -> int:
    print(file=sys.stderr)  # Behind a line that counts.
    tell(sentence, failure=True)
    return code


def _stopped(*_: object) -> None:
    os._exit(_told("stopped; what was kept of the run stays", EXIT_INTERRUPTED))


def end_with_parent() -> None:
    """Let a worker be ended by an interrupt at once, without a word, and with the process that has started it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


# ---- Files of results ----


def results_in(text: str, of: type[T]) -> list[T]:
    """Return the results, of a dataclass, that lines of JSON hold.

    A line that a killed run has cut off is left out, and so is one that holds something else.
    """
    hints = get_type_hints(of)
    found = []
    for line in text.splitlines():
        try:
            told = json.loads(line)
            if isinstance(told, dict) and all(_fits(value, hints[name]) for name, value in told.items()):
                found.append(of(**told))
        except (ValueError, TypeError, KeyError, RecursionError):
            continue
    return found


def _fits(value: object, hint: Any) -> bool:
    """Tell whether a value of JSON is of a field's type: a plain type, a dictionary, or one of several."""
    allowed = {get_origin(one) or one for one in (get_args(hint) if isinstance(hint, UnionType) else (hint,))}
    return type(value) in allowed or (type(value) is int and float in allowed)


def read_results(path: Path, of: type[T]) -> list[T]:
    """Return the results of a file; none if there is no file.

    Raises
    ------
    UserError
        If the path is something else than a file.
    """
    must_be_a_file(path)
    return results_in(path.read_text(encoding="utf-8", errors="replace"), of) if path.exists() else []


@contextmanager
def growing(path: Path, of: type[T]) -> Iterator[tuple[list[T], Callable[[T], None]]]:
    """Open a file of results to write more behind them; give what it holds, and what writes one.

    The lock is the process's own, not its children's, and ends with it, however that is.

    Raises
    ------
    UserError
        If the path is something else than a file, or another run is writing into it.
    SystemFailure
        If a result cannot be written.
    """
    must_be_a_file(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("ab+", buffering=0) as file:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise UserError(
                f"{path}: another run is writing into it: wait for its end, or take another file"
            ) from error
        file.seek(0)
        held = file.readall()
        cut_off = [b"\n"] if held and not held.endswith(b"\n") else []

        def append(result: T) -> None:
            data = b"".join(cut_off) + (json.dumps(asdict(result)) + "\n").encode()  # type: ignore[call-overload]
            cut_off.clear()
            try:
                while data:
                    data = data[file.write(data) :]
            except OSError as error:
                raise SystemFailure(f"{path}: cannot be written: {error.strerror}; what it holds is kept") from error

        yield results_in(held.decode("utf-8", "replace"), of), append


def must_be_a_file(path: Path) -> None:
    """Raise `UserError` if a path is that of a folder or a device, which may have no end."""
    if path.exists() and not path.is_file():
        raise UserError(f"{path}: is no file")
