"""What the tests of the block filter share."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.core.track.dense import State, sums
from tests.firmware.core.track.single import BLOCK_S, Bits, Kernel, cube, matrices


class Flight:
    """A sensor in motion and its filter in C: a hand's motion of 1 Hz, .16 m and .3 rad to each side.

    With swept it takes the sweep of the ambient field too, as in the host; without, it is that of the sensor.
    """

    def __init__(self, core, family, count=8, noise=0.02, seed=1, swept=False):
        self.coils, self.bits, self.noise = cube(count), Bits(family(10), count), noise
        self.kernel, self.swept = Kernel(core, self.coils, noise), swept
        self.update = self.kernel.lib.block_filter_update_swept if swept else self.kernel.lib.block_filter_update
        self.rng = np.random.default_rng(seed)
        self.pose = self.kernel.ffi.new("block_pose_t *")
        self.number = 0

    def truth(self, time_s):
        """The state at a time; velocity and turn rate by differences."""

        def place(t):
            turn = 2.0 * np.pi * np.array([t, 1.1 * t + 1.0, 0.9 * t + 2.0])
            return np.array([1.0, 1.1, 0.9]) + 0.16 * np.sin(turn), Rotation.from_rotvec(0.3 * np.cos(turn))

        (p, r), (before, _), (after, _) = place(time_s), place(time_s - 1e-4), place(time_s + 1e-4)
        w = (place(time_s + 1e-4)[1] * place(time_s - 1e-4)[1].inv()).as_rotvec() / 2e-4
        e, b = np.array([20.0, 5.0, -40.0]), np.array([0.3, -0.2, 0.1])
        return State(p, r.as_matrix(), (after - before) / 2e-4, w, e, b)

    def start(self):
        """Start a few millimetres beside the truth at block 0."""
        truth, start = self.truth(0.0), self.kernel.ffi.new("block_start_t *")
        start.position_m = (truth.p + 0.003).tolist()
        turned = Rotation.from_rotvec([0.004, -0.003, 0.002]) * Rotation.from_matrix(truth.rotation)
        start.quaternion = turned.as_quat().tolist()
        start.position_cov_m2 = (1e-5 * np.eye(3)).tolist()
        start.attitude_cov_rad2 = (1e-5 * np.eye(3)).tolist()
        start.ambient_uT = (truth.rotation.T @ truth.e + truth.b).tolist()
        start.ambient_sd_uT = 0.01
        self.kernel.lib.block_filter_start(self.kernel.filter, start)

    def data(self):
        """Go on to the next block and return its sums, as the model has them, with noise."""
        self.number += 1
        self.kernel.fill(self.bits.words(31 * self.number), np.zeros((0, 3)))
        gram, moment = matrices(self.kernel)
        values, vectors = np.linalg.eigh(gram)
        noise = vectors @ (np.sqrt(np.maximum(values, 0.0))[:, None] * self.rng.normal(0.0, self.noise, (len(gram), 3)))
        return sums(self.coils, self.truth(self.number * BLOCK_S), gram, moment) + noise

    def put(self, data):
        """Give the filter sums; return whether they were taken."""
        self.kernel.fill(self.bits.words(31 * self.number), data)
        return self.update(self.kernel.filter, self.kernel.block, BLOCK_S)

    def step(self):
        """Do the next block."""
        return self.put(self.data())

    def output(self, seconds=0.0):
        """The pose so long after the middle of the last block, its covariance, and the errors of position and turn."""
        self.kernel.lib.block_filter_output(self.kernel.filter, seconds, self.pose)
        state, truth = self.kernel.state(self.pose.state), self.truth(self.number * BLOCK_S + seconds)
        return state, self.kernel.matrix(self.pose.covariance), truth.minus(state)[:6]


@pytest.fixture
def fly(core, gold_family):
    """Make a `Flight`."""
    return lambda **settings: Flight(core, gold_family, **settings)
