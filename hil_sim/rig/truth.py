"""The truth about a sensor's motion, which the simulator knows and no board does."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_sim.world.motion import Motion

COURSE_STEP_S = 3e-3
"""Longest time from row to row of a course: straight lines between them are 20 um off a shake of 100 mm at 2 Hz."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Where a sensor really was in the middle of a cycle, and how it got there if it moved.

    Attributes
    ----------
    cycle : int
        Number of the cycle; the sync wire's first edge starts cycle 0.
    time_s : float
        Virtual time of the cycle's middle.
    position_m : ndarray, shape (3,)
    orientation_xyzw : ndarray, shape (4,)
        Quaternion of the rotation R in ``B_site = R B_sensor``.
    course : ndarray, shape (n, 8)
        Time, position and quaternion from the begin of the cycle to its end; empty if the sensor stood still.
    """

    cycle: int
    time_s: float
    position_m: NDArray[np.float64]
    orientation_xyzw: NDArray[np.float64]
    course: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 8)))

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of a line of truth."""
        record: dict[str, Any] = {
            "cycle": self.cycle,
            "t_s": self.time_s,
            "position_m": self.position_m.tolist(),
            "orientation_xyzw": self.orientation_xyzw.tolist(),
        }
        return record | ({"course": self.course.tolist()} if len(self.course) else {})


def truth_at(motion: Motion, cycle: int, time_s: float, duration_s: float) -> Truth:
    """Return the truth of a cycle whose middle is at a virtual time, and which lasts so long."""
    rows = math.ceil(duration_s / COURSE_STEP_S) + 1
    times = time_s + duration_s * np.array([0.0, *np.linspace(-0.5, 0.5, rows)])
    position, rotation = motion.poses(times)
    orientation = rotation.as_quat(canonical=True)
    course = np.column_stack([times, position, orientation])[1:]
    moved = bool(np.ptp(course[:, 1:], axis=0).any())
    return Truth(cycle, time_s, position[0], orientation[0], course if moved else course[:0])
