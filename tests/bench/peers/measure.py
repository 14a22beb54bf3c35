"""Two ways of doing the same work, timed in turns in one run: what else a machine does strikes both alike."""

from __future__ import annotations

import contextlib
import math
import os
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Task = Callable[[], Any]
Clock = Callable[[], float]

ROUNDS = 9
"""Rounds of a comparison, each with both ways in it: the medians of so many are taken."""
LEAST_S = 0.02
"""A round repeats what takes less until it takes so long: the clock's own steps are then of no account."""
LONG_S = 0.5
"""A first call that took so long is not made a second time before the rounds."""
STATUS, CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")


@dataclass(frozen=True)
class Timing:
    """What came of the rounds.

    Attributes
    ----------
    ours_s, theirs_s : float
        Medians of the time of one call.
    ratio : float
        Median of what the rounds say each: how many times as long theirs took.
    least_ratio, most_ratio : float
        Quartiles of the same.
    """

    ours_s: float
    theirs_s: float
    ratio: float
    least_ratio: float
    most_ratio: float


def paired(ours: Task, theirs: Task, rounds: int = ROUNDS, clock: Clock = time.process_time) -> Timing:
    """Time two tasks in turns, ours first in one round and theirs in the next; a first call of each is not counted.

    The clock is that of this process, all its threads together, unless another is given.
    """
    tasks = (ours, theirs)
    repeats = [_repeats(task, clock) for task in tasks]
    spent: tuple[list[float], list[float]] = ([], [])
    for number in range(rounds):
        for which in (0, 1) if number % 2 == 0 else (1, 0):
            begun = clock()
            for _ in range(repeats[which]):
                tasks[which]()
            spent[which].append((clock() - begun) / repeats[which])
    ratios = [their_s / our_s for our_s, their_s in zip(*spent, strict=True)]
    low, _, high = statistics.quantiles(ratios, n=4) if rounds > 1 else ratios * 3
    medians = [statistics.median(times) for times in spent]
    return Timing(medians[0], medians[1], statistics.median(ratios), low, high)


def _repeats(task: Task, clock: Clock) -> int:
    """Call a task once to fill caches, and again if that was short; return how often a round has to call it."""
    begun = clock()
    task()
    first_s = clock() - begun
    if first_s > LONG_S:
        return 1
    begun = clock()
    task()
    return max(1, math.ceil(LEAST_S / max(clock() - begun, 1e-7)))


def added_bytes(task: Task) -> int | None:
    """Return how much memory a task adds at its peak, in a copy of this process; None where Linux does not tell."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            CLEAR.write_text("5")
            before = _status_bytes("VmRSS")
            kept = task()  # alive until the peak is read
            os.write(writing, str(max(_status_bytes("VmHWM") - before, 0)).encode())
            del kept
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        told = pipe.read()
    os.waitpid(child, 0)
    return int(told) if told else None


def _status_bytes(name: str) -> int:
    (line,) = (line for line in STATUS.read_text().splitlines() if line.startswith(f"{name}:"))
    return 1024 * int(line.split()[1])
