"""Beacons and sensor in step by SYNC and FOLLOW_UP on CAN alone: no sync wire anywhere, a busy bus."""

import numpy as np
import pytest

from goldfield.access.epoch import EpochSeparator
from goldfield.locate import locate
from goldfield.poses import Status
from tests.hil.can_timing import LoadedBus, beacon_phases


@pytest.fixture(scope="module")
def bench(open_bench, rig_kind):
    if rig_kind not in ("emulated", "host"):
        pytest.fail("only a simulated bench shows its pins: run with --rig emulated or host")
    return open_bench("prigge8can")


def test_chip_edges_agree_within_a_microsecond_on_a_busy_bus(bench):
    bench.rig.watch_pins()
    bus = LoadedBus(bench.rig)
    for _ in range(10):
        bus.advance(0.1)
    assert bus.share() > 0.6
    phases = beacon_phases(bench)
    assert len(phases) == 7
    for phase in phases:
        assert len(phase) > 3000
        assert np.abs(phase).max() < 1e-6
        assert np.abs(phase).max() < 0.2e-6  # what it does; the line above is what it must


def test_poses(bench):
    reports = bench.reports(10)
    assert all(r.complete and r.locked and r.chips == 1023 and r.saturated == 0 for r in reports)
    separator = EpochSeparator(bench.site)
    poses = [locate(bench.site, separator.fields(report)) for report in reports]
    assert all(pose.status is Status.OK for pose in poses)
    truth = bench.truth()
    errors = [np.linalg.norm(pose.position_m - truth[pose.epoch].position_m) for pose in poses]
    assert np.sqrt(np.mean(np.square(errors))) < 0.02
