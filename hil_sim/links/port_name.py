"""A stable name for a serial port of the bench, whose own name is another each time."""

from __future__ import annotations

import re
from pathlib import Path

from goldfield.errors import UserError

PSEUDO_TERMINAL = re.compile(r"/dev/pts/\d+")


class PortName:
    """A symbolic link to a pseudo-terminal, from now until `close`.

    What a bench that was killed has left, a link to a pseudo-terminal that is no more, is replaced; anything else that
    has the name stays, and is an error.

    Parameters
    ----------
    path : path
    port : str
        The pseudo-terminal.

    Raises
    ------
    UserError
        If the name is taken, or the directory does not take it.
    """

    def __init__(self, path: Path, port: str) -> None:
        self._path, self._port = path, port
        try:
            if _stale(path, port):
                path.unlink()
            path.symlink_to(port)
        except FileExistsError as error:
            raise UserError(f"--link {path}: {_what(path)}: give another name, or remove it") from error
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or "is no path"
            raise UserError(f"--link {path}: cannot be made: {reason}") from error

    def close(self) -> None:
        """Take the name away, unless it is another's by now."""
        try:
            if str(self._path.readlink()) == self._port:
                self._path.unlink()
        except OSError:  # it is gone already, or is no link any more
            return


def _stale(path: Path, port: str) -> bool:
    """Return whether a name is the left-over of a bench: its terminal is gone, or has been given to this bench."""
    if not path.is_symlink():
        return False
    target = str(path.readlink())
    return target == port or (PSEUDO_TERMINAL.fullmatch(target) is not None and not path.exists())


def _what(path: Path) -> str:
    if not path.is_symlink():
        return "there is something of this name already"
    return f"there is a link of this name to {path.readlink()} already"
