"""What a subject of the bench measures with: paired times become rows, each with the memory that the work adds."""

from __future__ import annotations

import time
from dataclasses import dataclass
from importlib.metadata import version

from tests.bench.peers.measure import ROUNDS, Clock, Task, added_bytes, paired
from tests.bench.peers.row import Goal, Row


def named(package: str) -> str:
    """Return a package's name with its version."""
    return f"{package} {version(package)}"


@dataclass(frozen=True)
class Bench:
    """Measures pairs.

    Attributes
    ----------
    rounds : int
    clock : callable
        Seconds; the processor time of this process unless another is given.
    memory : bool
        Whether the memory of each is measured as well.
    """

    rounds: int = ROUNDS
    clock: Clock = time.process_time
    memory: bool = True

    def pair(
        self,
        subject: str,
        what: str,
        ours: Task,
        peer: str,
        theirs: Task,
        *,
        unit: str = "us",
        work: float = 1.0,
        their_work: float | None = None,
        goal: Goal | None = None,
    ) -> Row:
        """Return the row of two tasks that do the same work.

        Parameters
        ----------
        subject, what : str
        ours, peer, theirs
            Both tasks, and the name of the peer whose is the second.
        unit : str
            ``us`` or ``ms``, of one piece of work, or something that ends with ``/s``, pieces a second.
        work, their_work : float
            Pieces that a call of either does; left out, both do the same.
        goal : Goal, optional
        """
        their_work = work if their_work is None else their_work
        timing = paired(ours, theirs, self.rounds, self.clock)
        scale = their_work / work

        def figure(seconds: float, pieces: float) -> float:
            return pieces / seconds if unit.endswith("/s") else {"us": 1e6, "ms": 1e3}[unit] * seconds / pieces

        memories = [added_bytes(task) if self.memory else None for task in (ours, theirs)]
        ours_MB, theirs_MB = (None if value is None else value / 1e6 for value in memories)
        return Row(
            subject,
            what,
            unit,
            figure(timing.ours_s, work),
            peer,
            figure(timing.theirs_s, their_work),
            timing.ratio / scale,
            (timing.least_ratio / scale, timing.most_ratio / scale),
            ours_MB,
            theirs_MB,
            goal,
        )
