"""Quaternions against scipy's rotations in double precision."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation


def random_rotations(count, seed):
    return Rotation.random(count, random_state=np.random.default_rng(seed))


def apart(quaternion, rotation):
    """The angle between a quaternion, which is of length 1, and a rotation."""
    assert np.linalg.norm(list(quaternion)) == pytest.approx(1.0, abs=3e-7)
    return (Rotation.from_quat(list(quaternion)) * rotation.inv()).magnitude()


def test_matrix_and_back(core):
    ffi, lib = core
    matrix, quaternion = ffi.new("float[3][3]"), ffi.new("float[4]")
    halves = Rotation.from_rotvec(np.pi * np.vstack([np.eye(3), -np.eye(3)]))
    # Nearly half a turn about nearly an axis: no other component tells the attitude but with rounding a thousandfold.
    nearly = np.eye(3) + 1e-3 * np.array([0.5, -0.7, 0.6])
    nearly *= (np.pi - 1e-5) / np.linalg.norm(nearly, axis=1, keepdims=True)
    for rotation in (*random_rotations(200, 4), *halves, *Rotation.from_rotvec(nearly), Rotation.identity()):
        lib.quaternion_matrix(rotation.as_quat().tolist(), matrix)
        np.testing.assert_allclose([list(row) for row in matrix], rotation.as_matrix(), atol=1e-6)
        lib.quaternion_from_matrix(matrix, quaternion)
        assert apart(quaternion, rotation) < 1e-6


@given(st.lists(st.floats(-0.125, 0.125, width=32), min_size=3, max_size=3))
def test_small_turns_are_of_the_sites_frame(core, vector):
    ffi, lib = core
    start = random_rotations(1, 5)[0]
    quaternion = ffi.new("float[4]", start.as_quat().tolist())
    lib.quaternion_turn(quaternion, vector)
    error = apart(quaternion, Rotation.from_rotvec(vector) * start)
    assert error < 1e-6 + np.linalg.norm(vector) ** 3 / 11.0  # 2 atan(t/2) = t - t^3/12


def test_a_turn_of_any_length_is_one_by_twice_the_arc_tangent_of_its_half(core):
    ffi, lib = core
    rng = np.random.default_rng(6)
    for start, vector in zip(random_rotations(20, 7), 3.0 * rng.normal(size=(20, 3)), strict=True):
        quaternion = ffi.new("float[5]", [*start.as_quat().tolist(), 7.0])
        lib.quaternion_turn(quaternion, vector.tolist())
        *quaternion, behind = list(quaternion)
        assert behind == 7.0
        length = np.linalg.norm(vector)
        turn = Rotation.from_rotvec(2.0 * np.arctan(0.5 * length) * vector / length)
        assert apart(quaternion, turn * start) < 2e-6


def test_products(core):
    """The product may be one of the two."""
    ffi, lib = core
    for left, right in zip(random_rotations(20, 8), random_rotations(20, 9), strict=True):
        a, b = (ffi.new("float[4]", rotation.as_quat().tolist()) for rotation in (left, right))
        product = ffi.new("float[4]")
        lib.quaternion_multiply(a, b, product)
        assert apart(product, left * right) < 1e-6
        again = ffi.new("float[4]", list(b))
        lib.quaternion_multiply(a, again, again)
        assert list(again) == list(product)
        lib.quaternion_multiply(a, b, a)
        assert list(a) == list(product)


@pytest.mark.parametrize("length", [0.0, 1e-9, 1e-3, 0.5, 1.0, 1.5, 1.8, 1.9, 1.99, 2.0])
def test_turns_up_to_two_radians_are_exact_but_for_rounding(core, length):
    """Each component, before anything is normalised."""
    ffi, lib = core
    rng, quaternion = np.random.default_rng(10), ffi.new("float[4]")
    for way in rng.normal(size=(20, 3)):
        vector = (length * way / np.linalg.norm(way)).astype(np.float32)
        lib.quaternion_exp(vector.tolist(), quaternion)
        expected = Rotation.from_rotvec(vector.astype(float)).as_quat()
        assert list(quaternion) == pytest.approx(expected, abs=1.3e-7)


@pytest.mark.parametrize("length", [2.01, 3.0, 4.0, 4.2, 7.0, 1e2, 1e4, 1e6])
def test_longer_turns_are_as_exact_as_their_vector(core, length):
    ffi, lib = core
    rng, quaternion = np.random.default_rng(11), ffi.new("float[4]")
    for way in rng.normal(size=(20, 3)):
        vector = (length * way / np.linalg.norm(way)).astype(np.float32)
        lib.quaternion_exp(vector.tolist(), quaternion)
        assert apart(quaternion, Rotation.from_rotvec(vector.astype(float))) < 3e-7 * max(length, 2.0)
