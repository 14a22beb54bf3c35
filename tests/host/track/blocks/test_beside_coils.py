"""A track beside the wire of a coil, where its field is 4000 times the noise of a sample; coils by magpylib."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.track.blocks import BlockFilter
from goldfield.track.blocks.equations import BlockEquations
from goldfield.track.blocks.start import FARTHEST_M, Starter
from goldfield.types import Pose, Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Flight, Room
from tests.host.track.blocks.flights import streamed

BESIDE_M = np.array([0.144, 2.032, 0.022])
"""2.2 cm above the plane of a coil's wire and 2.5 cm outside it: 822 uT."""
NOISE_T = 2e-7
ROOM = Room(prigge_cube(NOISE_T))


def at_rest(position_m):
    attitude = Rotation.from_rotvec([-0.4, 0.99, -1.87])
    return Flight(
        lambda t: np.tile(position_m, (len(t), 1)),
        lambda t: Rotation.from_matrix(np.tile(attitude.as_matrix(), (len(t), 1, 1))),
    )


@pytest.mark.parametrize("seed", [0, 2])
@pytest.mark.parametrize("kernel", [True, False])
def test_a_track_beside_a_wire_goes_on_and_its_covariances_are_some(kernel, seed):
    """In single precision alone the covariance of each of these tracks became none."""
    stream = streamed(ROOM, at_rest(BESIDE_M), 0.4, NOISE_T, np.random.default_rng(seed))
    track = BlockFilter(stream.site, kernel=kernel)
    poses = [track.update(block) for block in stream.blocks()]
    known = [pose for pose in poses if pose.status is not Status.FAILED]
    assert len(known) > 20
    assert poses[-1].status is not Status.FAILED
    for pose in known:
        assert np.linalg.eigvalsh(pose.position_cov_m2)[0] > 0.0
        assert np.linalg.eigvalsh(pose.attitude_cov_rad2)[0] > 0.0
    moved, _ = stream.errors(known)
    for pose, error_m in zip(known, np.linalg.norm(moved, axis=1), strict=True):
        assert pose.status not in (Status.OK, Status.UNVERIFIED) or error_m < pose.protection_m


class Beside:
    """Locates a sensor at two places alike, at the first of them with some deviation."""

    def __init__(self, model, deviation_m, place_m=BESIDE_M):
        self.model, self.deviation_m, self.place_m = model, deviation_m, place_m

    def locate(self, fields):
        one = Pose(
            fields.epoch, fields.time_s, self.place_m, np.array([0.0, 0.0, 0.0, 1.0]), 1e-6 * np.eye(3),
            1e-4 * np.eye(3), 1.0, Status.AMBIGUOUS, fields.beacons,
        )  # fmt: skip
        far = np.diag([self.deviation_m**2, 1e-6, 1e-6])
        return replace(one, position_cov_m2=far, alternative=replace(one, position_m=BESIDE_M + 0.01))


@pytest.mark.parametrize(("deviation_m", "count"), [(0.99 * FARTHEST_M, 2), (1.01 * FARTHEST_M, 1), (1e98, 1)])
def test_no_track_begins_with_a_pose_that_is_nowhere(deviation_m, count):
    stream = streamed(ROOM, at_rest(BESIDE_M), 0.01, NOISE_T, np.random.default_rng(1))
    equations = BlockEquations(stream.site)
    starter = Starter(stream.site, equations)
    starter._locator = Beside(starter._locator.model, deviation_m)
    block = stream.blocks()[0]
    _, starts = starter.located(equations.form(block), 0, block.time_s)
    assert len(starts) == count
    assert starts[-1].position_m == pytest.approx(BESIDE_M + 0.01)


@pytest.mark.parametrize(("far_m", "count"), [(0.99 * FARTHEST_M, 2), (1.01 * FARTHEST_M, 1), (1e77, 1), (np.nan, 1)])
def test_no_track_begins_far_from_all_coils(far_m, count):
    """1e77 m, which codes that are interchanged gave, is beyond single precision: the track was not a number."""
    stream = streamed(ROOM, at_rest(BESIDE_M), 0.01, NOISE_T, np.random.default_rng(1))
    equations = BlockEquations(stream.site)
    starter = Starter(stream.site, equations)
    starter._locator = Beside(starter._locator.model, 1e-3, BESIDE_M + np.array([0.0, far_m, 0.0]))
    block = stream.blocks()[0]
    _, starts = starter.located(equations.form(block), 0, block.time_s)
    assert len(starts) == count
