"""pytest plugin: benches for hardware-in-the-loop tests, simulated or real.

A project asks for it with ``pytest_plugins = ["hil_sim.pytest_plugin"]`` in its top ``conftest.py``, or with
``-p hil_sim.pytest_plugin``; it never loads by itself. A test takes the fixture `open_bench` and asks it for a bench by
the name of a scenario::

    def test_one_metre_up(open_bench):
        bench = open_bench("prigge8")
        poses = [goldfield.locate(bench.site, fields) for fields in bench.fields(10)]

``--goldfield-rig emulated`` (the default: boards that run the ARM image), ``--goldfield-rig host`` (the same firmware
compiled for this machine), ``--goldfield-rig serial:PATH`` or ``--goldfield-rig can:INTERFACE:CHANNEL`` (real boards;
``--goldfield-site`` gives their site) say which boards the tests run on.

Before the first test a real bench is tried once: its site is read, its link opened, and one cycle of its sensor
awaited. A test that only a simulated bench can serve, because it needs the truth, a fault or a scenario of its own, has
the mark ``simulated_bench``; with a real bench such tests are deselected, and their number is told.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from goldfield import site as sites
from goldfield.errors import SystemFailure, UserError, counted, option
from hil_sim import KINDS
from hil_sim.bench import Bench, RealBench, SimulatedBench

RIG_OPTION, SITE_OPTION = "--goldfield-rig", "--goldfield-site"
RIGS = "emulated, host, serial:PATH or can:INTERFACE:CHANNEL"
SOURCES = {"serial": "port", "can": "can"}
"""Kind of the source by that of the rig."""
MARK = "simulated_bench"
LEFT_OUT = pytest.StashKey[int]()
"""How many tests were deselected for the sake of a real bench."""
FOUND = pytest.StashKey[str]()
"""What was found of a real bench."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("goldfield")
    group.addoption(RIG_OPTION, default="emulated", help=RIGS)
    group.addoption(SITE_OPTION, default=None, help="site file of a real bench")


def pytest_configure(config: pytest.Config) -> None:
    """Make the mark known, and refuse a rig that is none."""
    config.addinivalue_line(
        "markers", f"{MARK}: needs the truth, a fault or a scenario of its own: deselected on a real bench"
    )
    rig = str(config.getoption(RIG_OPTION))
    kind, _, where = rig.partition(":")
    if rig not in KINDS and not (kind in SOURCES and where):
        raise pytest.UsageError(f"{RIG_OPTION} {rig}: is none of {RIGS}")
    if not _is_real(config):
        return
    if config.getoption(SITE_OPTION) is None:
        raise pytest.UsageError(f"{RIG_OPTION} {rig}: a real bench has a site: give {SITE_OPTION} FILE, too")
    if config.getoption("numprocesses", None):
        raise pytest.UsageError(f"{RIG_OPTION} {rig}: one process reads a bench at a time: leave out -n")


@pytest.hookimpl(tryfirst=True)  # before the header is printed
def pytest_sessionstart(session: pytest.Session) -> None:
    """Try a real bench, once for all tests."""
    config = session.config
    if not _is_real(config) or config.getoption("collectonly"):
        return
    try:
        bench = _real_bench(config)
        try:
            bench.reports(1)
        finally:
            bench.close()
    except (UserError, SystemFailure) as error:
        sentence = str(error).removesuffix(f": check {option('port')}")  # an option that pytest has not
        raise pytest.UsageError(f"{RIG_OPTION} {config.getoption(RIG_OPTION)}: {sentence}") from error
    config.stash[FOUND] = (
        f"sensor {bench.node}, {counted(len(bench.site.beacons), 'beacons')} of the site {bench.site.name}"
    )


def pytest_report_header(config: pytest.Config) -> list[str]:
    """Tell what was found of a real bench."""
    return [f"goldfield: {config.getoption(RIG_OPTION)}: {config.stash[FOUND]}"] if FOUND in config.stash else []


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Deselect the tests that a real bench cannot serve."""
    if not _is_real(config):
        return
    left_out = [item for item in items if item.get_closest_marker(MARK)]
    items[:] = [item for item in items if not item.get_closest_marker(MARK)]
    config.stash[LEFT_OUT] = len(left_out)
    config.hook.pytest_deselected(items=left_out)


def pytest_report_collectionfinish(config: pytest.Config) -> list[str]:
    """Tell how many tests were deselected, and why."""
    count = config.stash.get(LEFT_OUT, 0)
    why = "they need the truth, faults or a scenario of their own, which only a simulated bench has"
    return [f"goldfield: {count} deselected: {why}"] if count else []


@pytest.fixture(scope="session")
def rig_kind(request: pytest.FixtureRequest) -> str:
    """Return the value of ``--goldfield-rig``."""
    return str(request.config.getoption(RIG_OPTION))


@pytest.fixture(scope="module")
def open_bench(
    request: pytest.FixtureRequest, rig_kind: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., Any]]:
    """Return a function that opens a bench: ``open_bench("prigge8", link="serial", boards=None)``.

    A real bench is what it is: the scenario, the link and the boards asked for then do not count.
    """
    opened: list[Bench] = []

    def open_one(scenario: str, link: str = "serial", boards: str | None = None) -> Bench:
        bench: Bench
        if _is_real(request.config):
            bench = _real_bench(request.config)
        else:
            bench = SimulatedBench(scenario, boards or rig_kind, tmp_path_factory.mktemp(scenario), link)
        opened.append(bench)
        return bench

    yield open_one
    for bench in opened:
        bench.close()


def _is_real(config: pytest.Config) -> bool:
    return str(config.getoption(RIG_OPTION)).partition(":")[0] in SOURCES


def _real_bench(config: pytest.Config) -> RealBench:
    kind, _, where = str(config.getoption(RIG_OPTION)).partition(":")
    return RealBench(SOURCES[kind], where, sites.load(config.getoption(SITE_OPTION)))
