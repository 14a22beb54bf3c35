"""What the pose is made of: attitude from vectors, and the limits of its tests."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, norm

from goldfield.locate.fault_statistics import FALSE_ALARM, OF_SENSOR, OF_SINGLE, OF_STRENGTH, OF_WHOLE
from hil_sim.clib import ROOT


def random_rotations(count, seed):
    return Rotation.random(count, random_state=np.random.default_rng(seed))


@pytest.mark.parametrize("count", [2, 3, 8])
def test_wahba_against_scipy(core, count):
    ffi, lib = core
    rng = np.random.default_rng(count)
    for rotation in random_rotations(300, 1):
        sensor = rng.normal(size=(count, 3)) * 10.0 ** rng.uniform(-1, 1, (count, 1))
        site = rotation.apply(sensor) * rng.uniform(0.9, 1.1, (count, 1)) + rng.normal(0, 0.02, (count, 3))
        if np.linalg.norm(np.cross(sensor[0], sensor[1])) < 0.3 * np.linalg.norm(sensor[0]) * np.linalg.norm(sensor[1]):
            continue  # Nearly parallel: no attitude.
        weight = 1.0 / (0.01 + 0.1 * (sensor**2).sum(axis=1))
        wahba, quaternion = ffi.new("wahba_t *"), ffi.new("float[4]")
        lib.wahba_init(wahba)
        for a, b, w in zip(site.tolist(), sensor.tolist(), weight.tolist(), strict=True):
            lib.wahba_add(wahba, a, b, w)
        lib.wahba_rotation(wahba, quaternion)
        best, _ = Rotation.align_vectors(site, sensor, weights=weight)
        loss = (weight * ((site - best.apply(sensor)) ** 2).sum(axis=1)).sum()
        assert (Rotation.from_quat(list(quaternion)) * best.inv()).magnitude() < 0.02
        assert lib.wahba_loss(wahba) == pytest.approx(loss, abs=1e-3 * wahba.energy)


def test_wahba_of_parallel_vectors_is_some_rotation(core):
    ffi, lib = core
    wahba, quaternion = ffi.new("wahba_t *"), ffi.new("float[4]")
    lib.wahba_init(wahba)
    for _ in range(3):
        lib.wahba_add(wahba, [1.0, 2.0, 3.0], [3.0, 2.0, 1.0], 1.0)
    lib.wahba_rotation(wahba, quaternion)
    assert np.linalg.norm(list(quaternion)) == pytest.approx(1.0, abs=1e-5)


def test_the_limits_of_the_faults_are_those_of_the_hosts_shares():
    """The host shares its false alarms by the number of beacons; the board takes the share of sixteen."""
    source = (ROOT / "firmware/core/pose/pose_faults.c").read_text()
    written = {name: float(value) for name, value in re.findall(r"#define (\w+) +([\d.]+)f", source)}
    whole = norm.isf(OF_WHOLE * FALSE_ALARM)
    beacon, strength = chi2.isf(OF_SINGLE * FALSE_ALARM / 16, 3), chi2.isf(OF_STRENGTH * FALSE_ALARM / 16, 1)
    sensor = [chi2.isf(share * FALSE_ALARM, freedom) for share, freedom in zip(OF_SENSOR, (1, 3, 6), strict=True)]
    names = ("WHOLE_DEVIATE", "LIMIT_BEACON", "LIMIT_STRENGTH", "LIMIT_COMMON", "LIMIT_AXES", "LIMIT_SKEWED")
    assert [written[name] for name in names] == pytest.approx([whole, beacon, strength, *sensor], abs=0.01)
