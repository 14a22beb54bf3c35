"""Helpers for rotations against SciPy's."""

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.locate.rotations import matrix_of, quaternion_of, vector_of


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
