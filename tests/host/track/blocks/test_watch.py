"""What the last blocks leave: bent fields are told after as many blocks as they need, poses and chance are not."""

import numpy as np
import pytest

from goldfield.field import FieldModel
from goldfield.track.blocks.consider import Considered
from goldfield.track.blocks.equations import BlockEquations
from goldfield.track.blocks.state import Motion
from goldfield.track.blocks.update import reference
from goldfield.track.blocks.watch import Watch
from goldfield.types import Block
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room

NOISE_T = 2e-7
SITE = prigge_cube(NOISE_T)
CODES = Room(SITE).codes.astype(float)
EQUATIONS = BlockEquations(SITE)
CONSIDERED = Considered(SITE, EQUATIONS.cycle)
NOTHING = np.zeros(3)
MOTION = Motion(np.array([0.9, 1.2, 0.7]), np.eye(3), NOTHING, NOTHING, np.array([2e-5, 5e-6, -4e-5]), NOTHING)
AROUND = reference(FieldModel(SITE.beacons), MOTION)
NONE = np.empty(0, dtype=np.intp)
BENT = np.array([[2.0, 0.3, 0.0], [0.3, -1.0, 0.5], [0.0, 0.5, -1.0]]) / 2.0


def watched(field_T, blocks, seed=1, out=NONE, watch=None):
    """A watch to which blocks have been shown that leave a field of each beacon, shape (8, 3), and noise."""
    rng, watch = np.random.default_rng(seed), watch or Watch(CONSIDERED)
    for number in range(blocks):
        place = (31 * number + np.arange(31)) % 1023
        samples = CODES[place] @ field_T + 3e-5 + NOISE_T * rng.normal(size=(31, 3))
        form = EQUATIONS.form(Block(0, int(place[0]), 0.0, 31, samples, True))
        watch.add(form, np.zeros(8), AROUND, out)
    return watch


def test_noise_is_no_alarm_and_hardly_widens():
    shares = [watched(np.zeros((8, 3)), 32, seed).share for seed in range(60)]
    assert not any(watched(np.zeros((8, 3)), 32, seed).alarm for seed in range(60))
    assert np.mean(np.array(shares) > 0.0) < 0.35
    assert max(shares) < 0.03


@pytest.mark.parametrize(
    ("part", "blocks", "said"), [(0.25, 4, True), (0.09, 4, False), (0.09, 32, True), (0.02, 32, False)]
)
def test_bent_fields_are_told_sooner_the_more_they_are_bent(part, blocks, said):
    field = part * AROUND.field_T[:-1] @ BENT
    assert [watched(field, blocks, seed).alarm for seed in range(5)] == 5 * [said]


def test_bent_fields_widen_by_about_as_much():
    shares = [watched(0.09 * AROUND.field_T[:-1] @ BENT, 32, seed).share for seed in range(5)]
    assert min(shares) > 0.03
    assert max(shares) < 0.15


def test_an_error_of_the_pose_is_no_contradiction():
    moved = np.concatenate([[0.02, -0.01, 0.03], [0.02, 0.03, -0.01]])
    assert not watched(AROUND.jacobian[:-1, :, :6] @ moved, 32).alarm


def test_a_beacon_that_is_left_out_contradicts_nothing_as_soon_as_there_are_blocks_without_it():
    wrong = np.zeros((8, 3))
    wrong[2] = 2e-7
    watch = watched(wrong, 32)
    assert watch.alarm
    watched(wrong, 3, out=np.array([2]), watch=watch)
    assert watch.alarm, "nothing has been tested yet"
    watched(wrong, 1, out=np.array([2]), watch=watch)
    assert not watch.alarm
