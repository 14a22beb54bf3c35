"""The hub between one sensor and any number of browsers: a slow browser loses messages and holds up nobody.

The thread that reads the sensor publishes; each browser's coroutine takes what is in its own mailbox. Neither waits for
the other, and nothing here grows with time.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from enum import StrEnum
from typing import Any

from goldfield.view.records import json_line

CAPACITY = 512
"""Messages that wait for a browser: five seconds at a hundred a second."""
HISTORY = 300
"""Epochs that a browser gets when it begins to look: half a minute of the usual codes."""
SILENCE_S = 2.0
"""A live sensor of which nothing came for so long is called silent, s; with longer cycles five of them."""


class State(StrEnum):
    """What the stream is doing."""

    WAITING = "waiting"
    """No epoch has come yet."""
    RUNNING = "running"
    """Epochs come."""
    SILENT = "silent"
    """Epochs came, and none for some seconds."""
    LOST = "lost"
    """The link is gone; it is opened again."""
    BUSY = "busy"
    """The sensor is not read, because this host computes."""
    ENDED = "ended"
    """The recording is at its end, or the command that reads the sensor."""


class Mailbox:
    """What waits for one browser: the latest messages, and how many were dropped since it last looked."""

    def __init__(self, first: Iterable[str] = ()) -> None:
        self._lock = threading.Lock()
        self._first = list(first)
        self._waiting: deque[str] = deque(maxlen=CAPACITY)
        self._dropped = 0

    def put(self, message: str) -> None:
        """Add a message; the oldest one goes if there is no room."""
        with self._lock:
            self._dropped += len(self._waiting) == CAPACITY
            self._waiting.append(message)

    @property
    def empty(self) -> bool:
        """Whether nothing waits."""
        with self._lock:
            return not (self._first or self._waiting)

    def take(self) -> list[str]:
        """Return what waits, oldest first, and forget it; a message tells how many are missing."""
        with self._lock:
            gone = [json_line({"type": "dropped", "count": self._dropped})] if self._dropped else []
            taken = [*self._first, *gone, *self._waiting]
            self._first, self._dropped = [], 0
            self._waiting.clear()
        return taken


class Hub:
    """Hands every message to each browser, and knows what a browser that comes later must get first.

    Parameters
    ----------
    greeting : str
        The first message to each browser.
    cycle_s : float
        How long a cycle takes.
    live : bool
        Whether silence means that something is wrong.
    clock : callable
        Returns the time, s.
    """

    def __init__(
        self, greeting: str, cycle_s: float, *, live: bool, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._greeting = greeting
        self._patience_s = max(SILENCE_S, 5.0 * cycle_s) if live else math.inf
        self._clock = clock
        self._lock = threading.Lock()
        self._boxes: set[Mailbox] = set()
        self._history: deque[str] = deque(maxlen=HISTORY)
        self._health: str | None = None
        self._progress: str | None = None
        self._state, self._text, self._heard_s = State.WAITING, "", clock()
        self._gone: Callable[[], str] = str

    @property
    def browsers(self) -> int:
        """How many browsers look."""
        return len(self._boxes)

    def open(self) -> Mailbox:
        """Return the mailbox of another browser, with all in it that the page needs to begin."""
        with self._lock:
            latest = [message for message in (self._health, self._progress) if message is not None]
            box = Mailbox([self._greeting, *self._history, *latest])
            self._boxes.add(box)
        return box

    def close(self, box: Mailbox) -> None:
        """Forget a browser."""
        with self._lock:
            self._boxes.discard(box)

    def watch(self, gone: Callable[[], str]) -> None:
        """Look at a link, too: it says why it is gone, while its reader waits for it, else nothing."""
        self._gone = gone

    def publish_epoch(self, message: str) -> None:
        """Hand out an epoch, which a browser that comes later gets too, and which shows that the stream runs."""
        with self._lock:
            self._history.append(message)
            self._state, self._text, self._heard_s = State.RUNNING, "", self._clock()
            self._hand_out(message)

    def publish_fix(self, message: str) -> None:
        """Hand out a pose at a time of its own."""
        with self._lock:
            self._hand_out(message)

    def publish_health(self, message: str) -> None:
        """Hand out the health of the boards, of which the latest counts."""
        with self._lock:
            self._health = message
            self._hand_out(message)

    def publish_progress(self, message: str) -> None:
        """Hand out how far a survey or a calibration is, of which the latest counts."""
        with self._lock:
            self._progress = message
            self._hand_out(message)

    @property
    def drained(self) -> bool:
        """Whether every browser has taken what was there for it."""
        with self._lock:
            return all(box.empty for box in self._boxes)

    def set_state(self, state: State, text: str = "") -> None:
        """Say what the stream is doing, and in a sentence why."""
        with self._lock:
            self._state, self._text = state, text

    def end(self, text: str = "") -> None:
        """Say that nothing more will come, and in a sentence why, to every browser as the last thing it gets."""
        self.set_state(State.ENDED, text)
        message = self.state_message()
        with self._lock:
            self._hand_out(message)

    def state_message(self) -> str:
        """Return the message that tells whether the stream runs; a browser gets one every second."""
        with self._lock:
            state, text, silent_s = self._state, self._text, self._clock() - self._heard_s
        gone = self._gone() if state is State.RUNNING else ""
        if gone:
            state, text = State.LOST, gone
        elif state is State.RUNNING and silent_s > self._patience_s:
            state = State.SILENT
            text = "nothing comes from the sensor: check its power, its cable and the port"
        record: dict[str, Any] = {"type": "state", "state": state.value, "text": text, "silent_s": round(silent_s, 1)}
        return json_line(record)

    def _hand_out(self, message: str) -> None:
        for box in self._boxes:
            box.put(message)
