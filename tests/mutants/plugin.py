"""pytest plugin that collects tests once, traces what each of them infects, and runs chosen ones in forked children.

A child that is killed by its processor time, which the unmutated run bounds, or that crashes, has noticed its mutant
as well as one whose test fails. Nothing waits by the clock.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import hypothesis
import pytest
from _pytest.runner import runtestprotocol

SPARE_S, TIMES = 2.0, 5.0
"""A mutant may take so much processor time: seconds, and times what the test took without."""


Each = Callable[[str, bool, float], bool]
Noted = dict[str, list[int]]
"""What a test tells: mutants that it `infected`, those that can be told apart (`applicable`), and those that cannot."""


@dataclass(frozen=True)
class Ended:
    """How a child ended: `failed` names the test that noticed the mutant, if one did."""

    failed: str | None
    by: str = ""


def in_child(work: Callable[[Any], None]) -> tuple[int, list[Any]]:
    """Do some work in a forked child; return its exit status and the values that it sent."""
    reading, writing = os.pipe()
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        os.close(reading)
        quiet = os.open(os.devnull, os.O_RDWR)
        for stream in (1, 2):
            os.dup2(quiet, stream)
        out = os.fdopen(writing, "w")

        def send(value: Any) -> None:
            out.write(json.dumps(value) + "\n")
            out.flush()

        code = 1
        try:
            work(send)
            code = 0
        finally:
            os._exit(code)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        sent = [json.loads(line) for line in pipe if line.endswith("\n")]
    return os.waitpid(child, 0)[1], sent


class Tests:
    """The collected tests; ``then`` is called when they are there."""

    def __init__(self, then: Callable[[Tests], None]):
        self.items: dict[str, pytest.Item] = {}
        self._then = then

    # ---- hooks ----
    @pytest.hookimpl(tryfirst=True)
    def pytest_collection(self) -> None:
        """A failure is enough: no smaller example is looked for, and none is kept."""
        usual = hypothesis.settings.get_profile("goldfield")
        phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
        hypothesis.settings.register_profile("mutants", parent=usual, phases=phases, database=None)
        hypothesis.settings.load_profile("mutants")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.items = {item.nodeid: item for item in session.items}
        self._then(self)
        return True

    # ---- runs ----
    def run(self, names: Sequence[str], costs: dict[str, float] | None, each: Each) -> None:
        """Run tests; ``each`` is told a test's name, whether it passed and its time, and says whether to go on."""
        for i, name in enumerate(names):
            following = self.items[names[i + 1]] if i + 1 < len(names) else None
            if costs is not None:
                signal.setitimer(signal.ITIMER_PROF, SPARE_S + TIMES * costs[name])
            begun = time.process_time()
            reports = runtestprotocol(self.items[name], log=False, nextitem=following if costs is not None else None)
            passed = all(report.outcome != "failed" for report in reports)
            if not each(name, passed, time.process_time() - begun):
                return

    def warm(self, costs: dict[str, float]) -> None:
        """Run the cheapest test of each file here, without a mutant, so that what it loads need not be loaded again."""
        cheapest: dict[str, str] = {}
        for name in sorted(costs, key=costs.__getitem__):
            cheapest.setdefault(name.split("::")[0], name)
        self.run(list(cheapest.values()), None, lambda name, passed, cost: True)

    def traced(self, names: Sequence[str], noted: Callable[[], Noted]) -> dict[str, tuple[float, Noted]]:
        """Return each test's time and what it infects; ``noted`` tells that of a test, and forgets it."""

        def work(send: Any) -> None:
            def each(name: str, passed: bool, cost: float) -> bool:
                send([name, passed, cost, noted()])
                return True

            noted()
            self.run(names, None, each)

        status, sent = in_child(work)
        failed = [name for name, passed, _, _ in sent if not passed]
        if status != 0 or failed:
            raise RuntimeError(f"without a mutant these tests fail: {', '.join(failed) or 'the child crashed'}")
        return {name: (cost, told) for name, _, cost, told in sent}

    def mutated(self, become: Callable[[], None], names: Sequence[str], costs: dict[str, float]) -> Ended:
        """Run tests on the mutant that ``become`` selects until one notices it."""

        def work(send: Any) -> None:
            become()

            def each(name: str, passed: bool, cost: float) -> bool:
                send([name, passed])
                return passed

            self.run(names, costs, each)

        status, sent = in_child(work)
        done = len(sent)
        if sent and not sent[-1][1]:
            return Ended(sent[-1][0], "test")
        if os.WIFSIGNALED(status):
            by = "time" if os.WTERMSIG(status) == signal.SIGPROF else "crash"
            return Ended(names[min(done, len(names) - 1)], by)
        if status != 0 or done < len(names):
            return Ended(names[min(done, len(names) - 1)], "crash")
        return Ended(None)
