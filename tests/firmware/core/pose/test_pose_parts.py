"""What the pose is made of: attitude from vectors, least squares in square-root form, quaternions."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
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


@pytest.mark.parametrize("condition", [1.0, 1e2, 1e4])
def test_least_squares_of_ill_conditioned_rows(core, condition):
    """The truth is in double precision; the last case's normal matrix, of condition 1e8, is lost in single."""
    ffi, lib = core
    rng = np.random.default_rng(2)
    u, _, vt = np.linalg.svd(rng.normal(size=(24, 6)), full_matrices=False)
    rows = (u * np.geomspace(1.0, 1.0 / condition, 6)) @ vt
    rows = rows.astype(np.float32).astype(float)
    truth = rng.normal(size=6)
    right = (rows @ truth).astype(np.float32)
    triangle = ffi.new("triangle_t *")
    lib.triangle_init(triangle)
    for block in range(0, 24, 3):
        table = np.column_stack([rows[block : block + 3], right[block : block + 3]])
        lib.triangle_add(triangle, table.tolist())
    step, inverse = ffi.new("float[6]"), ffi.new("float[6][6]")
    lib.triangle_solve(triangle, 0.0, step)
    np.testing.assert_allclose(list(step), truth, atol=2e-6 * condition)
    assert lib.triangle_invert(triangle, inverse)
    root = np.array([list(row) for row in inverse])
    expected = np.linalg.inv(rows.T @ rows)
    np.testing.assert_allclose(np.diag(root @ root.T), np.diag(expected), rtol=1e-5 * condition)
    damping = 0.3
    lib.triangle_solve(triangle, damping, step)
    normal = rows.T @ rows
    damped = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), rows.T @ right)
    np.testing.assert_allclose(list(step), damped, atol=1e-4)


def test_an_unknown_that_no_row_tells(core):
    ffi, lib = core
    rng = np.random.default_rng(3)
    triangle = ffi.new("triangle_t *")
    lib.triangle_init(triangle)
    for _ in range(4):
        rows = rng.normal(size=(3, 7))
        rows[:, 4] = 0.0
        lib.triangle_add(triangle, rows.tolist())
    step = ffi.new("float[6]")
    lib.triangle_solve(triangle, 1e-3, step)
    assert np.isfinite(list(step)).all()
    assert step[4] == 0.0
    assert not lib.triangle_invert(triangle, ffi.new("float[6][6]"))


def test_quaternion_and_matrix(core):
    ffi, lib = core
    matrix, quaternion = ffi.new("float[3][3]"), ffi.new("float[4]")
    halves = Rotation.from_rotvec(np.pi * np.vstack([np.eye(3), -np.eye(3)]))
    for rotation in (*random_rotations(200, 4), *halves, Rotation.identity()):
        lib.quaternion_matrix(rotation.as_quat().tolist(), matrix)
        np.testing.assert_allclose([list(row) for row in matrix], rotation.as_matrix(), atol=1e-6)
        lib.quaternion_from_matrix(matrix, quaternion)
        assert (Rotation.from_quat(list(quaternion)) * rotation.inv()).magnitude() < 1e-5


@given(st.lists(st.floats(-0.125, 0.125, width=32), min_size=3, max_size=3))
def test_small_turns_are_of_the_sites_frame(core, vector):
    ffi, lib = core
    start = random_rotations(1, 5)[0]
    quaternion = ffi.new("float[4]", start.as_quat().tolist())
    lib.quaternion_turn(quaternion, vector)
    error = (Rotation.from_quat(list(quaternion)) * (Rotation.from_rotvec(vector) * start).inv()).magnitude()
    assert error < 1e-6 + np.linalg.norm(vector) ** 3 / 11.0  # 2 atan(t/2) = t - t^3/12


def test_the_limits_of_the_faults_are_those_of_the_hosts_shares():
    """The host shares its false alarms by the number of beacons; the board takes the share of sixteen."""
    source = (ROOT / "firmware/core/pose/pose_faults.c").read_text()
    written = {name: float(value) for name, value in re.findall(r"#define (\w+) +([\d.]+)f", source)}
    whole = norm.isf(OF_WHOLE * FALSE_ALARM)
    beacon, strength = chi2.isf(OF_SINGLE * FALSE_ALARM / 16, 3), chi2.isf(OF_STRENGTH * FALSE_ALARM / 16, 1)
    sensor = [chi2.isf(share * FALSE_ALARM, freedom) for share, freedom in zip(OF_SENSOR, (1, 3, 6), strict=True)]
    names = ("WHOLE_DEVIATE", "LIMIT_BEACON", "LIMIT_STRENGTH", "LIMIT_COMMON", "LIMIT_AXES", "LIMIT_SKEWED")
    assert [written[name] for name in names] == pytest.approx([whole, beacon, strength, *sensor], abs=0.01)
