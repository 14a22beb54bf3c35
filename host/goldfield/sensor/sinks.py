"""Where results go: any number of sinks, each fed by its own thread, so that none holds up the pipeline or another.

A sink is whatever has `write` and `close`: a table on stdout, a file, a page in a browser. `Branch` feeds one from a
bounded queue, `Fanout` any number of them.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import TracebackType
from typing import Generic, Protocol, Self, TypeVar

from goldfield.errors import tell
from goldfield.files.inputs import reason_of

T = TypeVar("T")
U = TypeVar("U")
T_contra = TypeVar("T_contra", contravariant=True)

CAPACITY = 1000
"""Items that a branch keeps for a slow sink: epochs of 100 s, some 6 MB, or poses at 330 Hz of 3 s."""

INTERRUPTED_S = 1.0
"""How long an interrupted run waits for a sink to take what is left, as a pipe that nobody reads never does."""

POLL_S = 0.001
"""How often a full queue that is waited for is looked at again."""


class Sink(Protocol[T_contra]):
    """Takes items, in order, from one thread."""

    def write(self, item: T_contra, /) -> None:
        """Take the next item; it may block."""
        ...

    def close(self) -> None:
        """End; nothing is written afterwards."""
        ...


class Part(Generic[T, U]):
    """Gives a sink a part of every item that has it.

    Parameters
    ----------
    sink : Sink
    part_of : callable
        Returns the part, as the fields of an epoch; None if the item has none.
    """

    def __init__(self, sink: Sink[U], part_of: Callable[[T], U | None]) -> None:
        self._sink = sink
        self._part_of = part_of

    def write(self, item: T, /) -> None:
        """Write the item's part, if it has one."""
        part = self._part_of(item)
        if part is not None:
            self._sink.write(part)

    def close(self) -> None:
        """Close the sink."""
        self._sink.close()


class _End:
    """Ends a branch's queue."""


class Branch(Generic[T]):
    """Feeds one sink from a thread of its own; a sink itself.

    Parameters
    ----------
    sink : Sink
        Written and closed in the branch's thread only.
    name : str
        What it is, for messages: "the table of fields".
    waits : bool
        Whether `write` waits while the queue is full, as suits a recording; else the item is dropped and counted, as
        suits a live source.
    essential : bool, optional
        Whether an error of the sink ends the run: it is raised, once, by the next `write` or by `close`. Else the error
        is told on stderr, and what follows is discarded.
    capacity : int, optional
        Items that the queue holds.
    newest : bool, optional
        Whether it is the oldest item of a full queue that is dropped, not the one that comes.

    Attributes
    ----------
    dropped : int
        Items that the sink did not get because it was too slow, or stuck at the end.
    stuck : bool
        True if the sink has not come to its end after `close`.
    failed : bool
        True if the sink has raised an error.
    """

    def __init__(
        self,
        sink: Sink[T],
        name: str,
        *,
        waits: bool,
        essential: bool = False,
        capacity: int = CAPACITY,
        newest: bool = False,
    ) -> None:
        self.name = name
        self._handed = self._taken = self._refused = 0
        self._sink = sink
        self._waits = waits
        self._essential = essential
        self._capacity = capacity
        self._newest = newest
        # A SimpleQueue, whose lock an interrupt cannot leave locked, as it can that of a Queue.
        self._queue: queue.SimpleQueue[T | _End] = queue.SimpleQueue()
        self._error: Exception | None = None
        self.failed = False
        self._closed = False
        self._ended = False  # is_alive would not do: a join that is interrupted makes it False at once
        self._thread = threading.Thread(target=self._feed, name=name, daemon=True)
        self._thread.start()

    def write(self, item: T, /) -> None:
        """Hand an item over; it never waits for the sink unless ``waits`` was asked for."""
        self._raise_error()
        self._handed += 1
        while self._queue.qsize() >= self._capacity:
            if self._waits:
                time.sleep(POLL_S)
                continue
            if not self._newest:
                self._refused += 1
                return
            with suppress(queue.Empty):  # the sink may have been faster
                self._queue.get_nowait()
                self._refused += 1
        self._queue.put(item)

    def close(self, patience_s: float | None = None) -> None:
        """Wait until the sink has got what is in the queue, and close it; without end if no patience is given."""
        if not self._closed:
            self._queue.put(_End())  # first: an interrupt in between would leave the thread without its end
            self._closed = True
        self._thread.join(patience_s)
        self._raise_error()

    @property
    def closed(self) -> bool:
        """Whether it is known to be closed; an interrupt of `close` may leave it open, and it is closed again."""
        return self._closed

    @property
    def stuck(self) -> bool:
        """Whether the sink has not come to its end, though it was closed."""
        return self._closed and not self._ended

    @property
    def dropped(self) -> int:
        """How many items the sink has missed: for want of room in the queue, or because it is stuck."""
        return self._handed - self._taken if self.stuck else self._refused

    def _feed(self) -> None:
        failed = False
        while not isinstance(item := self._queue.get(), _End):
            self._taken += 1
            if not failed:  # else the queue is emptied, so that nobody waits for room in it
                failed = not self._attempt(item)
        self._attempt(None)
        self._ended = True

    def _attempt(self, item: T | None) -> bool:
        """Write an item, or close with None; tells whether that went well."""
        try:
            if item is None:
                self._sink.close()
            else:
                self._sink.write(item)
        except Exception as error:  # whatever a sink raises must not end the others
            self.failed = True
            if self._essential:
                self._error = self._error or error
            else:
                reason = reason_of(error)
                path = self.name.partition(":")[2]  # of a feed to a file, whose errors begin with it
                told = reason.removeprefix(f"{self.name}: ").removeprefix(f"{path}: ")
                tell(f"{self.name}: {told}; the run goes on without", failure=True)
            return False
        return True

    def _raise_error(self) -> None:
        error, self._error = self._error, None
        if error is not None:
            self._essential = False  # one error ends the run; those that follow from it are only told
            raise error


class Fanout(Generic[T]):
    """Hands every item to each of its sinks; as a context manager it closes them at the end.

    Parameters
    ----------
    waits : bool
        As for `Branch`: True for a recording (nothing is lost), False for a live source (nothing is held up).
    """

    def __init__(self, *, waits: bool) -> None:
        self._waits = waits
        self._branches: list[Branch[T]] = []

    def add(self, sink: Sink[T], name: str, *, essential: bool = False, capacity: int = CAPACITY) -> None:
        """Add a sink; see `Branch`."""
        self._branches.append(Branch(sink, name, waits=self._waits, essential=essential, capacity=capacity))

    def write(self, item: T, /) -> None:
        """Hand an item to every sink.

        Raises
        ------
        Exception
            The error of an essential sink.
        """
        for branch in self._branches:
            branch.write(item)

    def close(self, patience_s: float | None = None) -> None:
        """Wait until every sink has got what is left for it, and close them all.

        Parameters
        ----------
        patience_s : float, optional
            How long each of them is waited for; without end if it is not given.

        Raises
        ------
        Exception
            The error of an essential sink.
        """
        self._close(self._branches, patience_s)

    def close_again(self) -> None:
        """Close the sinks that `close` has left open because an interrupt ended it; it does not wait for one for long.

        Raises
        ------
        Exception
            The error of an essential sink.
        """
        self._close([branch for branch in self._branches if not branch.closed], INTERRUPTED_S)

    @staticmethod
    def _close(branches: Sequence[Branch[T]], patience_s: float | None) -> None:
        errors = []
        for branch in branches:
            try:
                branch.close(patience_s)
            except Exception as error:  # the others are closed first
                errors.append(error)
        if errors:
            raise errors[0]

    @property
    def stuck(self) -> bool:
        """Whether a sink has not come to its end, though it was closed: its thread lives on."""
        return any(branch.stuck for branch in self._branches)

    @property
    def failed(self) -> bool:
        """Whether a sink has raised an error: what it writes is not whole."""
        return any(branch.failed for branch in self._branches)

    @property
    def dropped(self) -> dict[str, int]:
        """How many items each sink that was too slow has missed, by its name."""
        return {branch.name: branch.dropped for branch in self._branches if branch.dropped}

    def __enter__(self) -> Self:
        """Return the fan-out itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the sinks; one that is stuck does not hold up an interrupt."""
        self.close(INTERRUPTED_S if kind is KeyboardInterrupt else None)
