"""The truth about a sensor's motion, which the simulator knows and no board does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_sim.world.motion import Motion


@dataclass(frozen=True, eq=False)
class Truth:
    """Where a sensor really was in the middle of a cycle.

    Attributes
    ----------
    cycle : int
        Number of the cycle; the sync wire's first edge starts cycle 0.
    time_s : float
        Virtual time of the cycle's middle.
    position_m : ndarray, shape (3,)
    orientation_xyzw : ndarray, shape (4,)
        Quaternion of the rotation R in ``B_site = R B_sensor``.
    """

    cycle: int
    time_s: float
    position_m: NDArray[np.float64]
    orientation_xyzw: NDArray[np.float64]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON object of a line of truth."""
        return {
            "cycle": self.cycle,
            "t_s": self.time_s,
            "position_m": self.position_m.tolist(),
            "orientation_xyzw": self.orientation_xyzw.tolist(),
        }


def truth_at(motion: Motion, cycle: int, time_s: float) -> Truth:
    """Return the truth of a cycle whose middle is at a virtual time."""
    position, rotation = motion.poses(np.array([time_s]))
    return Truth(cycle, time_s, position[0], rotation.as_quat(canonical=True)[0])
