"""From chips to poses: boards in one virtual time, the sensor's stream, the host's poses beside the truth."""

import numpy as np
import pytest

from goldfield.access.epoch import EpochSeparator
from goldfield.locate import locate
from goldfield.types import Status
from hil_sim import KINDS
from tests.hil.bound import check_at_the_bound

CYCLES = 30


def poses_of(site, reports):
    separator = EpochSeparator(site)
    return [locate(site, separator.fields(report)) for report in reports]


@pytest.fixture(scope="module")
def measured(rig_kind, request, open_bench):
    """The site of whatever bench there is, its reports, and the true poses by cycle, which a real bench has not."""
    if rig_kind in KINDS:
        run = request.getfixturevalue("recorded")
        return run.bench.site, run.reports[:CYCLES], run.bench.truth()
    bench = open_bench("prigge8")
    return bench.site, bench.reports(CYCLES), bench.truth()


def test_every_cycle_is_reported_whole(measured):
    _, reports, _ = measured
    assert [r.cycle for r in reports] == list(range(reports[0].cycle, reports[0].cycle + CYCLES))
    assert all(r.complete and r.locked and r.chips == 1023 and r.saturated == 0 for r in reports)


def test_poses_are_at_the_bound(measured):
    site, reports, truth = measured
    poses = poses_of(site, reports)
    assert all(len(p.used) == len(site.beacons) for p in poses)
    alarms = sum(p.status is not Status.OK for p in poses)
    assert alarms <= 1  # false alarms are granted to 1 epoch in 1,000
    assert {p.status for p in poses} <= {Status.OK, Status.INCONSISTENT}
    if truth:  # a simulated bench
        check_at_the_bound(site, poses, truth)


def test_time_is_the_middle_of_the_cycle(measured):
    site, reports, truth = measured
    times = np.array([r.time_s for r in reports])
    assert np.diff(times) == pytest.approx(site.cycle_s, rel=1e-3)
    if truth:
        late = times - np.array([truth[r.cycle].time_s for r in reports])
        assert np.ptp(late) < 200e-6 * (times[-1] - times[0]) + 5e-6  # the sensor's clock: 17 ppm against 0
