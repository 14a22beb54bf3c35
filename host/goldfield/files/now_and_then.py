"""Something that is done now and then beside the work, as handing what a recording has gathered to the system."""

from __future__ import annotations

import threading
from collections.abc import Callable


class NowAndThen:
    """Calls a function again and again from a thread of its own.

    Parameters
    ----------
    call : callable
        It raises nothing.
    every_s : float
        Time from the end of one call to the next.
    name : str
        Name of the thread.
    """

    def __init__(self, call: Callable[[], None], every_s: float, name: str) -> None:
        self._call = call
        self._every_s = every_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Wait for a call that is under way; there is none afterwards."""
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.wait(self._every_s):
            self._call()
