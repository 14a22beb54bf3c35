"""pytest plugin: the processor time of each test, which a loaded machine hardly changes, beside that of its file.

``python -m pytest -p tests.bench.cpu_costs ...`` runs tests as ever, with ``-n`` too, and prints at the end which cost
most. The time of the processes that a test starts and waits for counts. What a fixture of a module or a session sets up
counts to the test that comes first. The tests that took most time beyond that are told too: on an idle machine, they
wait, for a clock, a browser or a process that nobody waits for.
"""

from __future__ import annotations

import os
from collections import defaultdict

import pytest

PROPERTY = "cpu_s"
SHOWN = 60
"""Tests that are printed, and at most as many files."""
BEGUN = pytest.StashKey[float]()
"""What the process had used when the phase of a test began."""


def cpu_s():
    """Processor time of this process and of its children that have ended, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item):
    item.stash[BEGUN] = cpu_s()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item):
    report = yield
    now_s = cpu_s()
    report.user_properties.append((PROPERTY, now_s - item.stash[BEGUN]))
    item.stash[BEGUN] = now_s
    return report


def pytest_terminal_summary(terminalreporter):
    by_test, by_file, waited = defaultdict(float), defaultdict(float), defaultdict(float)
    for reports in terminalreporter.stats.values():
        for report in reports:
            for name, spent_s in getattr(report, "user_properties", ()):
                if name == PROPERTY:
                    by_test[report.nodeid] += spent_s
                    by_file[report.nodeid.partition("::")[0]] += spent_s
                    waited[report.nodeid] += report.duration - spent_s
    total_s, waited_s = sum(by_test.values()), sum(waited.values())
    terminalreporter.section(f"processor time: {total_s:.0f} s in {len(by_test)} tests, and {waited_s:.0f} s without")
    for costs in (by_test, by_file, waited):
        for name, spent_s in sorted(costs.items(), key=lambda entry: -entry[1])[:SHOWN]:
            terminalreporter.write_line(f"{spent_s:8.2f} s  {name}")
        terminalreporter.write_line("")
