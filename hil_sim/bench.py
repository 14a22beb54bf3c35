"""Benches for end-to-end tests: a sensor board among beacons, simulated in this process or real."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from pathlib import Path

from goldfield import site as sites
from goldfield.link.reports import Assembler, Report
from goldfield.sensor.opening import open_sensor
from goldfield.sensor.separation import Separation
from goldfield.site import Site
from goldfield.types import Fields
from goldfield_protocol import FrameDecoder, decode
from hil_sim.rig import Rig, Truth
from hil_sim.scenario import load_scenario, site_toml

START_S = 2.5
"""Virtual time in which simulated boards boot, synchronise and ramp up their currents."""


class Bench(ABC):
    """A sensor board among beacons: what an end-to-end test needs of it.

    Attributes
    ----------
    site : Site
    """

    site: Site

    @abstractmethod
    def reports(self, count: int) -> list[Report]:
        """Return the next code cycles of the sensor."""

    @abstractmethod
    def truth(self) -> dict[int, Truth]:
        """Return the true poses by cycle; empty on a real bench."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the boards."""

    def fields(self, count: int) -> list[Fields]:
        """Return the field of each beacon in the next code cycles, for `goldfield.locate`; ``epoch`` is the cycle.

        Raises
        ------
        UserError
            If the site's beacons are told apart by anything but codes that a sensor board reports.
        """
        return [self._separation.fields(report) for report in self.reports(count)]

    @cached_property
    def _separation(self) -> Separation:
        return Separation(self.site, of_instants=False)


class SimulatedBench(Bench):
    """A rig in this process: its time stands still unless it is asked to run on.

    Parameters
    ----------
    scenario : str
        A name in ``hil_sim/scenarios``, or a file.
    boards : str
        ``"emulated"`` or ``"host"``.
    directory : path
        The site file is written there.
    link : str
        Whether the sensor is read at its serial port, ``"serial"``, or on the CAN bus, ``"can"``.
    cycles_per_instruction : float or str
        How many cycles an instruction takes on emulated boards (1 to 100), or ``m4``: by class of instruction.

    Attributes
    ----------
    scenario : Scenario
    site : Site
    rig : Rig
    stream : bytearray
        Every serial byte of the sensor so far.
    decoder : FrameDecoder
        Takes the serial stream apart.
    """

    def __init__(
        self,
        scenario: str,
        boards: str,
        directory: Path,
        link: str = "serial",
        cycles_per_instruction: float | str = 1.0,
    ) -> None:
        self.scenario = load_scenario(scenario)
        path = directory / "site.toml"
        path.write_text(site_toml(self.scenario))
        self.site = sites.load(path)
        self.rig = Rig(self.scenario, boards, cycles_per_instruction=cycles_per_instruction)
        self.link = link
        self.stream = bytearray()
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

    def close(self) -> None:
        """End the rig."""
        self.rig.close()

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


class RealBench(Bench):
    """Boards on a desk.

    Parameters
    ----------
    kind, where : str
        ``"port"`` and its path, or ``"can"`` and ``INTERFACE:CHANNEL``.
    site : Site
    """

    def __init__(self, kind: str, where: str, site: Site) -> None:
        self.site = site
        self._sensor = open_sensor(kind, where, site)
        self._reports = self._sensor.reports()

    def reports(self, count: int) -> list[Report]:
        """Return the next code cycles of the sensor."""
        return [next(self._reports) for _ in range(count)]

    @property
    def node(self) -> int | None:
        """The sensor's node."""
        return self._sensor.node

    def truth(self) -> dict[int, Truth]:
        """Return nothing: nobody knows where a real sensor is."""
        return {}

    def close(self) -> None:
        """Let go of the link."""
        self._sensor.close()
