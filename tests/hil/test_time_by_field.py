"""A sensor that chooses its source of time: the wire is cut, CAN falls silent, the field goes on telling the time.

The beacons' own wire is whole all the time. CAN is silenced by bit errors in all frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from goldfield.access.epoch import EpochSeparator
from goldfield.link.reports import Report
from goldfield.link.requests import set_request
from goldfield.locate import locate
from goldfield.types import Status
from goldfield_protocol import FrameDecoder, Message, decode, encode_frame
from goldfield_protocol.parameters import PARAMETERS, Kind
from hil_sim.bench import SimulatedBench
from hil_sim.rig import SENSOR
from hil_sim.scenario import SCENARIOS

WIRE, CAN, FIELD, NONE = 1, 2, 3, 0
LATE_NS = 2780
"""Own chips of host boards begin so much after the beacons' while they follow the field (sensor.h tells of boards)."""
CHANGES = 21
CYCLE_S = 1023 * 16422 / 168e6
WRONG = chi2.ppf(1.0 - 1e-6, 3)
"""An ok pose that is further off, by the covariance that it states, is wrong."""


class Watch:
    """A bench whose boards choose their source of time, and what its sensor tells, since the latest look."""

    def __init__(self, directory: Path, changes: dict[str, str], boards: str = "host", beacons: int = 8) -> None:
        head, *tables = (SCENARIOS / "prigge8.toml").read_text(encoding="utf-8").split("[[beacon]]")
        text = "[[beacon]]".join([head, *tables[:beacons]])
        for old, new in {"seed =": 'sync = "automatic"\nseed =', **changes}.items():
            assert old in text
            text = text.replace(old, new, 1)
        path = directory / "automatic.toml"
        path.write_text(text, encoding="utf-8")
        self.bench = SimulatedBench(str(path), boards, directory)
        self.rig = self.bench.rig
        self._decoder = FrameDecoder()
        self.reports: list[Report] = []
        self.messages: list[Message] = []

    def wire(self, there: bool) -> None:
        self.rig.fault(SENSOR, "sync_wire_cut", not there)

    def can(self, there: bool) -> None:
        self.rig.can_errors(0.0 if there else 0.5)

    def run(self, seconds: float) -> None:
        """Run on; what was told before is forgotten."""
        self.reports, self.messages = [], []
        end_s = self.rig.now_s + seconds
        while self.rig.now_s < end_s - 1e-9:
            before = len(self.bench.stream)
            self.reports += self.bench.advance(min(0.05, end_s - self.rig.now_s))
            for frame in self._decoder.feed(bytes(self.bench.stream[before:])):
                message = decode(frame.identifier, frame.data)
                if message is not None:
                    self.messages.append(message)

    def told(self, name: str, signal: str) -> list[float]:
        return [float(m.signals[signal]) for m in self.messages if m.name == name]

    def source(self) -> float:
        return self.told("CLOCK", "source")[-1]

    def changes(self) -> float:
        return next((m.signals["value"] for m in self.messages[::-1] if (m.name, m.index) == ("COUNTER", CHANGES)), 0)

    def check_poses(self, least_ok: float = 0.9) -> None:
        """Poses of the reports since the latest look: none is wrong and called ok, and most are ok."""
        separator, truth = EpochSeparator(self.bench.site), self.bench.truth()
        ok = 0
        for report in self.reports:
            pose = locate(self.bench.site, separator.fields(report))
            if pose.status is Status.OK and report.cycle in truth:
                off = pose.position_m - truth[report.cycle].position_m
                assert off @ np.linalg.solve(pose.position_cov_m2, off) < WRONG
                ok += 1
        assert ok >= least_ok * len(self.reports)

    def check_in_step(self) -> None:
        """Each cycle since the latest look is whole and locked, and its number is that of the one before and one."""
        assert all(r.complete and r.locked and r.chips == 1023 for r in self.reports)
        assert set(np.diff([r.cycle for r in self.reports])) == {1}

    def set(self, **values: int) -> None:
        """Set parameters of the sensor at its serial port."""
        for name, value in values.items():
            frame = set_request(self.bench.scenario.sensor.node, PARAMETERS[name].first, value, Kind.UNSIGNED)
            self.rig.serial_write(encode_frame(*frame))


@pytest.fixture
def watch(tmp_path: Path) -> Iterator[Callable[..., Watch]]:
    opened: list[Watch] = []

    def make(changes: dict[str, str] | None = None, **bench: Any) -> Watch:
        opened.append(Watch(tmp_path, changes or {}, **bench))
        return opened[-1]

    yield make
    for one in opened:
        one.bench.close()


def test_wire_then_can_then_field_and_back_without_a_wrong_pose(watch: Callable[..., Watch]) -> None:
    made = watch()
    made.run(1.2)
    assert made.source() == WIRE
    followed = []
    for wire, can in ((False, True), (False, False), (False, True), (False, False), (True, False), (True, True)):
        made.wire(wire)
        made.can(can)
        made.run(3.0)
        made.check_in_step()
        made.check_poses()
        followed.append(made.source())
        assert set(made.told("CLOCK", "locked")) == {1.0}
    assert followed == [CAN, FIELD, CAN, FIELD, WIRE, WIRE]
    assert made.changes() == 5
    assert np.abs(made.told("EPOCH_STATUS", "phase")[-10:]).max() < 100.0


def test_the_image_goes_over_from_wire_to_can_to_field_and_back(watch: Callable[..., Watch]) -> None:
    """Three beacons and a sensor, emulated: too few for a sound pose, enough to be followed."""
    made = watch(boards="emulated", beacons=3)
    followed = []
    for wire, can, seconds in ((True, True, 1.2), (False, True, 1.2), (False, False, 1.8), (True, False, 1.5)):
        made.wire(wire)
        made.can(can)
        made.run(seconds)
        made.check_in_step()
        followed.append(made.source())
    assert followed == [WIRE, CAN, FIELD, WIRE]
    assert made.changes() == 3


def test_goes_over_after_five_silent_periods_and_returns_after_ten_edges(watch: Callable[..., Watch]) -> None:
    made = watch()
    made.can(False)
    made.run(1.0)
    made.wire(False)
    made.run(0.3)  # Three edges are missing.
    made.wire(True)
    made.run(2.0)
    assert made.source() == WIRE
    assert made.changes() == 0
    made.wire(False)
    made.run(0.65 + 1.2)
    assert made.source() == FIELD
    assert made.changes() == 1
    made.run(1.0)
    made.wire(True)
    made.run(0.95)
    phase_ns = np.array(made.told("EPOCH_STATUS", "phase")[2:])  # While the wire is only compared.
    assert np.abs(phase_ns + LATE_NS).max() < max(made.told("CLOCK", "error"))
    made.run(0.35)
    assert abs(made.told("EPOCH_STATUS", "phase")[-1]) < 400.0  # The wire is followed, and the rest slewed off.
    made.run(2.0)
    made.check_in_step()
    assert made.source() == WIRE
    assert made.changes() == 2


def switch_beacons(made: Watch, on: bool) -> None:
    """Set the amplitude of every beacon by its own serial port."""
    for board, beacon in enumerate(made.bench.scenario.beacons, start=1):
        amplitude = beacon.circuit.current_A if on else 0.0
        frame = set_request(beacon.node, PARAMETERS["amplitude"].first, amplitude, Kind.FLOAT)
        made.rig.serial_write(encode_frame(*frame), board)


def test_with_no_source_at_all_the_clock_holds_over_and_ends_its_lock(watch: Callable[..., Watch]) -> None:
    """The beacons are off, too: what comes back first is followed."""
    made = watch()
    made.wire(False)
    made.can(False)
    made.run(2.0)
    assert made.source() == FIELD
    switch_beacons(made, False)
    made.run(12.0)
    made.check_poses(0.0)
    assert made.told("EPOCH_STATUS", "locked")[-1] == 0.0
    errors = made.told("CLOCK", "error")
    assert errors[-4] > errors[2]
    switch_beacons(made, True)
    made.run(3.0)
    assert made.source() == FIELD
    assert made.told("EPOCH_STATUS", "locked")[-5:] == [1.0] * 5
    made.check_poses(0.0)
    made.run(1.0)
    made.check_in_step()
    made.check_poses()


def test_a_sensor_that_starts_with_the_field_alone_takes_the_numbers_when_the_wire_comes(
    watch: Callable[..., Watch],
) -> None:
    made = watch(
        {
            "[sensor]\n": "[sensor]\nsync_wire = false\n",
            "[[beacon]]": "[can]\nbit_error_probability = 0.5\n\n[[beacon]]",
        }
    )
    made.run(1.0)
    assert made.source() == FIELD
    made.check_in_step()
    made.check_poses(0.0)
    made.wire(True)
    made.can(True)
    made.run(3.0)
    assert made.source() in (WIRE, CAN)
    assert all(r.locked for r in made.reports)
    made.run(2.0)
    assert made.source() == WIRE
    made.check_in_step()
    made.check_poses()


def test_the_strongest_codes_tell_the_time_where_there_is_no_list(watch: Callable[..., Watch]) -> None:
    """A sensor that was in step has heard them (test_sync_automatic.py has one that starts without)."""
    made = watch()
    made.set(code_count=0, strongest=4)
    made.run(1.5)
    made.wire(False)
    made.can(False)
    made.run(4.0)
    made.check_in_step()
    assert made.source() == FIELD
    assert made.changes() in (1, 2)
