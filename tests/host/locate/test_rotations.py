"""Helpers for rotations against SciPy's."""

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.locate.rotations import matrix_of, orthonormal, quaternion_of, quaternions_of, skew, turned, vector_of


def rotations():
    """Return rotations of every kind: any, by half a turn, by nearly nothing, and none."""
    rng = np.random.default_rng(1)
    halves = np.pi * np.vstack([np.eye(3), -np.eye(3), rng.normal(size=(9, 3))])
    halves /= np.linalg.norm(halves, axis=1, keepdims=True) / np.pi
    small = rng.normal(size=(8, 3)) * np.logspace(-12.0, -1.0, 8)[:, None]
    parts = [Rotation.random(300, rng=rng), Rotation.from_rotvec(halves), Rotation.from_rotvec(small)]
    return Rotation.concatenate([*parts, Rotation.identity(1)])


def test_quaternions_of_any_rotation():
    for turn in rotations():
        found = quaternion_of(turn.as_matrix())
        assert found[3] >= 0.0
        assert abs(found @ found - 1.0) < 1e-15
        np.testing.assert_allclose(Rotation.from_quat(found).as_matrix(), turn.as_matrix(), rtol=0, atol=2e-15)


def test_matrices_of_any_quaternion():
    for turn in rotations():
        for length in (1.0, -1.0, 3.0):
            np.testing.assert_allclose(matrix_of(length * turn.as_quat()), turn.as_matrix(), rtol=0, atol=2e-15)


def test_vectors_of_any_rotation():
    for turn in rotations():
        found = vector_of(turn.as_matrix())
        assert np.linalg.norm(found) < np.pi + 1e-12
        np.testing.assert_allclose(found, turn.as_rotvec(), rtol=0, atol=1e-14 if turn.magnitude() < 3.14 else 7.0)
        np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), turn.as_matrix(), rtol=0, atol=3e-15)


def test_many_quaternions_are_each_as_alone():
    turns = rotations()
    found = quaternions_of(turns.as_matrix())
    np.testing.assert_array_equal(found, [quaternion_of(turn.as_matrix()) for turn in turns])


def test_the_matrix_of_a_cross_product():
    rng = np.random.default_rng(2)
    first, second = rng.normal(size=(2, 5, 4, 3))
    np.testing.assert_allclose((skew(first) @ second[..., None])[..., 0], np.cross(first, second), atol=1e-15)


def test_turns_by_any_angle():
    """Also about where a series takes the place of the sine."""
    rng = np.random.default_rng(3)
    angle = np.concatenate([np.geomspace(1e-12, 3.0, 60), 1e-4 * np.linspace(0.9, 1.2, 20), [0.0]])
    vector = rng.normal(size=(len(angle), 3))
    vector *= (angle / np.linalg.norm(vector, axis=1))[:, None]
    before = Rotation.random(len(angle), rng=rng)
    expected = (Rotation.from_rotvec(vector) * before).as_matrix()
    np.testing.assert_allclose(turned(before.as_matrix(), vector), expected, rtol=0, atol=1e-15)


def test_rounding_is_removed_from_rotations():
    """One of Newton's steps leaves the square of what is off, and does not turn the rotation."""
    rng = np.random.default_rng(4)
    true = Rotation.random(20, rng=rng).as_matrix()
    off = rng.normal(size=(20, 3, 3))
    stretched = true + 1e-5 * true @ (off + off.swapaxes(1, 2))
    np.testing.assert_allclose(orthonormal(stretched), true, rtol=0, atol=1e-8)
    assert np.abs(stretched - true).max() > 1e-5
