"""The command ``goldfield``: one file a subcommand."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

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


@contextmanager
def terminated_like_interrupted() -> Iterator[None]:
    """Let SIGTERM, and a terminal that is closed, end every command as Ctrl-C does, with its files put in order.

    Only the main thread can do so, and a signal that is ignored, as by nohup, stays so.
    """

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    numbers = (signal.SIGTERM, signal.SIGHUP) if threading.current_thread() is threading.main_thread() else ()
    before = {number: handler for number in numbers if (handler := signal.getsignal(number)) is not None}
    wanted = {number: handler for number, handler in before.items() if handler is not signal.SIG_IGN}
    try:
        for number in wanted:
            signal.signal(number, interrupt)
        yield
    finally:
        for number, handler in wanted.items():
            signal.signal(number, handler)
