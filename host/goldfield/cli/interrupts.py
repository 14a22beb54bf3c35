"""Signals that end a command: SIGTERM, and a terminal that is closed, do what Ctrl-C does, and none of them is missed.

Python notes a signal when it comes, and looks at its notes between two steps of the program. A signal that comes
between the last look and a system call that waits without end, for a thread or for a pipe, would be seen only when that
call ends. So a thread learns of each signal, too, and ends the system calls of the program until it has looked.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

WAKING = signal.SIGURG
"""What ends a system call of the program: a signal that nobody sends to it, and of which nothing comes by itself."""
LOOK_S = 0.05
"""How long the program gets to look at its notes before it is woken, and again before it is woken once more, s."""
END = b"\0"
"""No signal has this number."""


@contextmanager
def terminated_like_interrupted() -> Iterator[None]:
    """Let SIGTERM, and a terminal that is closed, end every command as Ctrl-C does, with its files put in order.

    Only the main thread can do so, and a signal that is ignored, as by nohup, stays so.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = {number: handler for number in numbers if (handler := signal.getsignal(number)) is not None}
    wanted = {number: handler for number, handler in before.items() if handler is not signal.SIG_IGN}
    waker = _Waker()
    try:
        for number in wanted:
            signal.signal(number, interrupt)
        yield
    finally:
        for number, handler in wanted.items():
            signal.signal(number, handler)
        waker.end()


class _Waker:
    """Wakes the thread that makes it, which is the main thread, when a signal has come."""

    def __init__(self) -> None:
        self._main = threading.get_ident()
        self._looked = True
        self._told, self._telling = os.pipe()
        os.set_blocking(self._telling, False)
        self._handler = signal.signal(WAKING, self._look)
        self._before = signal.set_wakeup_fd(self._telling, warn_on_full_buffer=False)
        self._thread = threading.Thread(target=self._wake, name="waker", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Wake nobody any more."""
        signal.set_wakeup_fd(self._before)
        os.write(self._telling, END)  # closing it would not do: a process that was forked may have it, too
        self._thread.join()
        signal.signal(WAKING, self._handler)
        os.close(self._told)
        os.close(self._telling)

    def _look(self, *_: object) -> None:
        self._looked = True

    def _wake(self) -> None:
        while (number := os.read(self._told, 1)) != END:
            if number[0] == WAKING:
                continue
            self._looked = False
            while not self._looked:
                time.sleep(LOOK_S)
                signal.pthread_kill(self._main, WAKING)
