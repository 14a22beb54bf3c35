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
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from goldfield import site as sites
from hil_sim.bench import Bench, RealBench, SimulatedBench

RIG_OPTION, SITE_OPTION = "--goldfield-rig", "--goldfield-site"
RIGS = "emulated, host, serial:PATH or can:INTERFACE:CHANNEL"
SOURCES = {"serial": "port", "can": "can"}
"""Kind of the source by that of the rig."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("goldfield")
    group.addoption(RIG_OPTION, default="emulated", help=RIGS)
    group.addoption(SITE_OPTION, default=None, help="site file of a real bench")


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
        kind, _, where = rig_kind.partition(":")
        bench: Bench
        if kind in SOURCES:
            site = request.config.getoption(SITE_OPTION)
            if site is None:
                raise pytest.UsageError(f"a real bench needs {SITE_OPTION} FILE")
            bench = RealBench(SOURCES[kind], where, sites.load(site))
        elif kind in ("emulated", "host"):
            bench = SimulatedBench(scenario, boards or kind, tmp_path_factory.mktemp(scenario), link)
        else:
            raise pytest.UsageError(f"{RIG_OPTION} {rig_kind}: is none of {RIGS}")
        opened.append(bench)
        return bench

    yield open_one
    for bench in opened:
        bench.close()
