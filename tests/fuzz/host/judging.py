"""What every harness of the host judges by: an answer, or one sentence of the project's own errors."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TypeVar

from goldfield.errors import Loudness, SystemFailure, UserError, set_loudness

Answer = TypeVar("Answer")

SHORTEST, LONGEST = 15, 2000
"""Characters of a sentence that tells what was wrong, where, and what to do."""


@cache
def place(suffix: str) -> Path:
    """Return the path of a file that each input is written to, one for each kind of file and process."""
    set_loudness(Loudness.QUIET)
    folder = tempfile.TemporaryDirectory(prefix="goldfield-fuzz-")
    FOLDERS.append(folder)
    return Path(folder.name) / f"input{suffix}"


FOLDERS: list[tempfile.TemporaryDirectory[str]] = []
"""Kept, so that they are removed at the end of the process and not before."""


def written(data: bytes, suffix: str) -> Path:
    """Return the path of a file that holds an input."""
    path = place(suffix)
    path.write_bytes(data)
    return path


def answered(read: Callable[[], Answer]) -> Answer | None:
    """Return what a function returns, None if it refuses with a sentence.

    Raises
    ------
    AssertionError
        If what it says is no sentence for a user. Every other error goes through: it is a defect.
    """
    try:
        return read()
    except (UserError, SystemFailure) as error:
        sentence = str(error)
        assert SHORTEST <= len(sentence) <= LONGEST, sentence
        assert "\n" not in sentence, sentence
        assert "Traceback" not in sentence, sentence
        return None
