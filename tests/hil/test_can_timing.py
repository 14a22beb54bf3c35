"""Beacons and sensor in step by SYNC and FOLLOW_UP on CAN alone: no sync wire anywhere, a busy bus."""

import numpy as np
import pytest

from goldfield.access.epoch import EpochSeparator
from goldfield.locate import locate
from goldfield.types import Status
from goldfield_protocol import decode
from goldfield_protocol.rates import CAN_RATES
from hil_sim.bench import SimulatedBench
from hil_sim.scenario import SCENARIOS
from tests.bench.can_rates import LOAD, bench_at, chip_errors
from tests.hil.bound import check_at_the_bound
from tests.hil.can_timing import LoadedBus, beacon_phases, cold_starts, sensor_phases, starve


@pytest.fixture(scope="module")
def bench(open_bench):
    return open_bench("prigge8can")


@pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too
def test_chip_edges_agree_within_a_microsecond_on_a_busy_bus(bench):
    bench.rig.watch_pins()
    bus = LoadedBus(bench.rig)
    for _ in range(10):
        bus.advance(0.1)
    assert bus.share() > 0.6
    judge_phases(beacon_phases(bench), beacons=8, edges=3000)


def judge_phases(phases, beacons, edges):
    assert len(phases) == beacons - 1
    for phase in phases:
        assert len(phase) > edges
        assert np.abs(phase).max() < 1e-6
        assert np.abs(phase).max() < 0.2e-6  # what it does; the line above is what it must


@pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too
def test_poses(bench):
    reports = bench.reports(20)
    assert all(r.complete and r.locked and r.chips == 1023 and r.saturated == 0 for r in reports)
    separator = EpochSeparator(bench.site)
    poses = [locate(bench.site, separator.fields(report)) for report in reports]
    assert all(pose.status is Status.OK for pose in poses)
    check_at_the_bound(bench.site, poses, bench.truth())


@pytest.fixture
def small_bench(rig_kind, tmp_path):
    """Three beacons and the sensor without sync wire."""
    text = (SCENARIOS / "patent3.toml").read_text()
    path = tmp_path / "small.toml"
    path.write_text('sync = "can"\n' + text)
    bench = SimulatedBench(str(path), rig_kind, tmp_path)
    yield bench
    bench.rig.close()


def test_a_cold_start_and_chip_edges_on_a_busy_bus(small_bench):
    bus = LoadedBus(small_bench.rig)
    starts = cold_starts(small_bench, bus, 1)
    assert starts[:, 0].max() < 1.0
    assert starts[:, 1].max() < 0.5
    small_bench.rig.watch_pins()
    bus.advance(0.3)
    assert bus.share() > 0.6
    judge_phases(beacon_phases(small_bench), beacons=3, edges=900)


def decoded(frame):
    return decode(frame.identifier, frame.data)


@pytest.mark.long
@pytest.mark.parametrize(("boards", "bit_s"), [*(("host", rate) for rate in CAN_RATES), ("emulated", CAN_RATES[-1])])
def test_chip_edges_at_each_bit_rate(tmp_path, boards, bit_s):
    """A fifth of what they must, as at 1 Mbit/s, and within the bound that each follower tells of its own clock.

    An emulated receiver at 125 kbit/s looks every 381 ns.
    """
    bench = bench_at(bit_s, boards, tmp_path)
    bus = LoadedBus(bench.rig, LOAD)
    starts = cold_starts(bench, bus, 1)
    assert starts[:, 0].max() < 1.0
    assert starts[:, 1].max() < 0.5
    bus.advance(0.8)
    errors = chip_errors(bench, bus, spans=1)
    clocks = [message for message in map(decoded, bench.rig.can_read()) if message and message.name == "CLOCK"]
    bounds_s = {m.node: 1e-9 * m.signals["error"] for m in clocks if m.signals["locked"] and m.signals["source"] == 2}
    assert len(errors) > 2 * 900
    assert len(bounds_s) == 3
    assert np.abs(errors).max() < min(0.2e-6, *bounds_s.values())
    bench.close()


@pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too
def test_cold_starts_on_a_busy_bus(small_bench):
    starts = cold_starts(small_bench, LoadedBus(small_bench.rig), 3)
    assert starts[:, 0].max() < 1.0
    assert starts[:, 1].max() < 0.5


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_a_hundred_cold_starts_on_a_busy_bus(small_bench):
    starts = cold_starts(small_bench, LoadedBus(small_bench.rig), 100)
    assert starts[:, 0].max() < 1.0
    assert starts[:, 1].max() < 0.5


@pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too
def test_a_bus_that_sync_does_not_get_for_a_second_costs_no_lock(small_bench):
    small_bench.rig.fault(0, "sync_wire_cut", False)
    starve(small_bench, 1.0)
    told = sensor_phases(small_bench, LoadedBus(small_bench.rig, load=0.0), 1.0)
    assert told[:, 1].all()
    assert np.abs(told[:, 2]).max() < 0.5
