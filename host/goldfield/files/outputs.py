"""Files that a command writes, kept apart from those that it reads: a mistyped option must not cost a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from goldfield.errors import UserError


def check_outputs(outputs: Mapping[str, str | Path | None], inputs: Mapping[str, str | Path | None]) -> None:
    """Check that no file is written twice, or written and read, before any of them is opened.

    Parameters
    ----------
    outputs, inputs : mapping of str to path or None
        The files by the option that names them; None or an empty path is an option that was not given. Whatever exists
        and is no regular file, such as ``/dev/null``, may be named more than once.

    Raises
    ------
    UserError
        If an output is also an input or another output.

    Examples
    --------
    >>> check_outputs({"--fields": "room.toml"}, {"--site": "./room.toml"})
    Traceback (most recent call last):
    goldfield.errors.UserError: room.toml: is the file of --site and would be overwritten by --fields: give another
    """
    earlier = [(option, Path(path)) for option, path in inputs.items() if path]
    for option, path in ((option, Path(path)) for option, path in outputs.items() if path):
        for other, taken in earlier:
            if _same(path, taken):
                raise UserError(f"{path}: is the file of {other} and would be overwritten by {option}: give another")
        earlier.append((option, path))


def _same(one: Path, other: Path) -> bool:
    if one.exists() and other.exists():
        return one.is_file() and one.samefile(other)  # a link has another name
    return one.resolve() == other.resolve()
