"""Poses as robots have them: the frames of REP 105, and the covariance of REP 103, for ROS and Foxglove alike."""

from __future__ import annotations

import numpy as np

from goldfield.types import FloatArray, Pose

MAP, SENSOR = "map", "sensor"
"""The site's frame, and the board's."""


def covariance_of(pose: Pose) -> FloatArray:
    """Return the covariance of x, y, z and the rotations about the fixed axes x, y, z of the site's frame.

    It is in m and rad, of shape (6, 6). Between place and attitude it is 0: a `Pose` does not tell it. What is not
    known is 0 too, as ``geometry_msgs/PoseWithCovariance`` says it.
    """
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = pose.position_cov_m2
    covariance[3:, 3:] = pose.attitude_cov_rad2
    return np.where(np.isfinite(covariance), covariance, 0.0)
