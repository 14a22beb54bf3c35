"""The sensor board alone: the poses it computes and sends, beside the host's from its fields, and the truth."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from goldfield.access.epoch import EpochSeparator
from goldfield.link.reports import ON_SENSOR_POSE, Assembler
from goldfield.locate import locate
from goldfield.locate.uncertainty import cramer_rao_bound
from goldfield.sensor.on_sensor import on_sensor_pose
from goldfield.types import Status
from goldfield_protocol import FrameDecoder, decode
from tests.hil.bound import check_at_the_bound

CYCLES = 20
FREEDOM = 3 * 8 - 6


@pytest.fixture(scope="module")
def bench(recorded):
    return recorded.bench


@pytest.fixture(scope="module")
def pairs(bench):
    """(host's pose, sensor's pose) of each cycle."""
    assembler, separator, found = Assembler(on_sensor=True), EpochSeparator(bench.site), []
    for frame in FrameDecoder().feed(bytes(bench.stream)):
        message = decode(frame.identifier, frame.data)
        if message is not None:
            for report in assembler.feed(message, 0.0):
                fields = separator.fields(report)
                found.append((locate(bench.site, fields), on_sensor_pose(bench.site, report, fields), report))
    return found[-CYCLES:]


def between(a, b):
    return (Rotation.from_quat(a.orientation_xyzw) * Rotation.from_quat(b.orientation_xyzw).inv()).magnitude()


def test_every_cycle_has_a_pose_of_the_sensor(pairs):
    """One cycle in 5,000 is improbable, and the sensor says so (pose.h). Which noise is drawn depends on each tick."""
    assert len(pairs) == CYCLES
    improbable = [chi2.sf(FREEDOM * own.residual**2, FREEDOM) < 1.0 / 5000.0 for _, own, _ in pairs]
    assert sum(improbable) <= 1
    for (_, own, report), alarm in zip(pairs, improbable, strict=True):
        assert len(report.on_sensor_pose) == len(ON_SENSOR_POSE)
        assert len(own.used) == 8
        assert own.status is (Status.INCONSISTENT if alarm else Status.OK)
        assert report.on_sensor_pose["POSE_QUALITY"]["tracked"] == float(not alarm)


def test_it_agrees_with_the_host_within_a_tenth_of_the_bound(bench, pairs):
    # Beside the bound: the messages' steps of 0.1 mm and 0.003 degrees, and the host's fields rounded to 0.1 nT.
    for host, own, _ in pairs:
        bound = cramer_rao_bound(bench.site, host.position_m[None])[0]
        assert np.linalg.norm(own.position_m - host.position_m) < 0.1 * np.sqrt(np.trace(bound[:3, :3]))
        assert between(own, host) < 0.1 * np.sqrt(np.trace(bound[3:, 3:]))
        assert own.residual == pytest.approx(host.residual, abs=0.02)
        for mine, theirs in (
            (own.position_cov_m2, host.position_cov_m2),
            (own.attitude_cov_rad2, host.attitude_cov_rad2),
        ):
            assert np.trace(mine) == pytest.approx(np.trace(theirs), rel=0.05)


def test_it_is_at_the_bound(bench, pairs):
    check_at_the_bound(bench.site, [own for _, own, _ in pairs], bench.truth())


def test_the_can_bus_carries_the_same_poses(recorded, pairs):
    received = [decode(frame.identifier, frame.data) for frame in recorded.can_frames]
    poses = [m.signals for m in received if m is not None and m.name == "POSE_POSITION"]
    assert len(poses) >= CYCLES
    sent = [report.on_sensor_pose["POSE_POSITION"] for _, _, report in pairs]
    assert all(position in poses for position in sent)
