"""The command ``goldfield``: one file a subcommand."""

from __future__ import annotations

from collections.abc import Sequence

from goldfield.cli.interrupts import terminated_like_interrupted
from goldfield.errors import EXIT_INTERRUPTED

__all__ = ["main"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; `goldfield.cli.entry` does it.

    What takes long to import is imported here, so that an interrupt costs no traceback even then.
    """
    try:
        with terminated_like_interrupted():
            from goldfield.cli import entry

            return entry.main(argv)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
