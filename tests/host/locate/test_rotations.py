"""Helpers for rotations against SciPy's."""

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.locate.rotations import quaternion_of


def test_quaternions_of_any_rotation():
    rng = np.random.default_rng(1)
    halves = np.pi * np.vstack([np.eye(3), -np.eye(3), rng.normal(size=(9, 3))])
    halves /= np.linalg.norm(halves, axis=1, keepdims=True) / np.pi
    turns = Rotation.concatenate([Rotation.random(300, rng=rng), Rotation.from_rotvec(halves), Rotation.identity(1)])
    for turn in turns:
        found = quaternion_of(turn.as_matrix())
        assert found[3] >= 0.0
        assert abs(found @ found - 1.0) < 1e-15
        np.testing.assert_allclose(Rotation.from_quat(found).as_matrix(), turn.as_matrix(), rtol=0, atol=2e-15)
