"""pytest plugin: benches for hardware-in-the-loop tests, simulated or real.

``--rig emulated`` (the default: boards that run the ARM image), ``--rig host`` (the same firmware compiled for this
machine), ``--rig serial:PATH`` or ``--rig can:INTERFACE:CHANNEL`` (real boards; give their site with ``--site``).

A test takes the fixture `open_bench` and asks it for a bench by the name of a scenario.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Protocol

import pytest

from goldfield import site as sites
from goldfield.link.buses import BusSource, open_can, open_port
from goldfield.link.reports import SHORTEST_SILENCE_S, Assembler, Report
from goldfield.sensor.session import Session
from goldfield.site import Site
from goldfield_protocol import FrameDecoder, decode
from hil_sim.rig import Rig, Truth
from hil_sim.scenario import load_scenario, site_toml

START_S = 2.5
"""Virtual time in which simulated boards boot, synchronise and ramp up their currents."""


class Bench(Protocol):
    """A sensor board among beacons: what an end-to-end test needs of it."""

    site: Site

    def reports(self, count: int) -> list[Report]:
        """Return the next code cycles of the sensor."""
        ...

    def truth(self) -> dict[int, Truth]:
        """Return the true poses by cycle; empty on a real bench."""
        ...


class SimulatedBench:
    """A rig in this process, read at its serial port (``link="serial"``) or on its CAN bus (``"can"``)."""

    def __init__(self, scenario: str, boards: str, directory: Path, link: str = "serial") -> None:
        self.scenario = load_scenario(scenario)
        path = directory / "site.toml"
        path.write_text(site_toml(self.scenario))
        self.site = sites.load(path)
        self.rig = Rig(self.scenario, boards)
        self.link = link
        self.stream = bytearray()
        """Every serial byte of the sensor so far."""
        self.decoder = FrameDecoder()
        self._assembler = Assembler()
        self._truth: dict[int, Truth] = {}
        self.rig.advance(START_S)
        self._read()

    def advance(self, seconds: float) -> list[Report]:
        """Run on, and return the cycles that the sensor reported."""
        self.rig.advance(seconds)
        return self._read()

    def reports(self, count: int) -> list[Report]:
        """Return the next code cycles of the sensor."""
        reports: list[Report] = []
        for _ in range(4 * count + 20):
            if len(reports) >= count:
                break
            reports += self.advance(self.site.cycle_s)
        return reports[:count]

    def truth(self) -> dict[int, Truth]:
        """Return the true poses by cycle."""
        self._truth.update({truth.cycle: truth for truth in self.rig.truth()})
        return self._truth

    def _read(self) -> list[Report]:
        received = self.rig.serial_read()
        self.stream += received
        if self.link == "serial":
            frames = [(frame.identifier, frame.data) for frame in self.decoder.feed(received)]
        else:
            frames = [(frame.identifier, frame.data) for frame in self.rig.can_read()]
        reports: list[Report] = []
        for identifier, data in frames:
            message = decode(identifier, data)
            if message is not None and message.node == self.scenario.sensor.node:
                reports += self._assembler.feed(message, self.rig.now_s)
        return reports


class RealBench:
    """Boards on a desk."""

    def __init__(self, source: BusSource, name: str, site: Site) -> None:
        self.site = site
        self._session = Session(source, name, Assembler(silence_s=max(SHORTEST_SILENCE_S, 8.0 * site.cycle_s)))
        self._session.find_sensor()
        self._session.check_degree(source, site.degree)
        self._session.configure(source, site.codes)
        self._reports = self._session.reports(live=True)

    def reports(self, count: int) -> list[Report]:
        """Return the next code cycles of the sensor."""
        return [next(self._reports) for _ in range(count)]

    def truth(self) -> dict[int, Truth]:
        """Return nothing: nobody knows where a real sensor is."""
        return {}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options."""
    group = parser.getgroup("goldfield")
    group.addoption("--rig", default="emulated", help="emulated, host, serial:PATH or can:INTERFACE:CHANNEL")
    group.addoption("--site", default=None, help="site file of a real bench")


@pytest.fixture(scope="session")
def rig_kind(request: pytest.FixtureRequest) -> str:
    """Return the value of ``--rig``."""
    return str(request.config.getoption("--rig"))


@pytest.fixture(scope="module")
def open_bench(
    request: pytest.FixtureRequest, rig_kind: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., Any]]:
    """Return a function that opens a bench: ``open_bench("prigge8", link="serial", boards=None)``.

    A real bench is what it is: the scenario, the link and the boards asked for then do not count.
    """
    opened: list[Callable[[], None]] = []

    def open_one(scenario: str, link: str = "serial", boards: str | None = None) -> Bench:
        kind, _, where = rig_kind.partition(":")
        if kind in ("serial", "can"):
            site = request.config.getoption("--site")
            if site is None:
                raise pytest.UsageError("a real bench needs --site FILE")
            source = open_port(where) if kind == "serial" else open_can(where)
            opened.append(source.close)
            return RealBench(source, where, sites.load(site))
        if kind not in ("emulated", "host"):
            raise pytest.UsageError(f"--rig {rig_kind}: is none of emulated, host, serial:PATH, can:INTERFACE:CHANNEL")
        bench = SimulatedBench(scenario, boards or kind, tmp_path_factory.mktemp(scenario), link)
        opened.append(bench.rig.close)
        return bench

    yield open_one
    for close in opened:
        close()
