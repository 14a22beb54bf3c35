"""Changes of the ambient field that say nothing, and those that do: both sides of each limit."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.track.blocks.bank import Estimate
from goldfield.track.blocks.evenness import CERTAIN, EVEN_T, Evenness
from goldfield.track.blocks.state import OFFSET, SIZE, TURN, Motion

EARTH_T = np.array([2e-5, 5e-6, -4e-5])
NORTH = EARTH_T / np.linalg.norm(EARTH_T)
ASIDE = np.cross(NORTH, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(NORTH, [0.0, 0.0, 1.0]))
BLOCK_S = 3e-3


def known(rotation=None, velocity=(0.0, 0.0, 0.0), offset=(0.0, 0.0, 0.0), turn_sd=0.0, offset_sd=0.0):
    covariance = np.zeros((SIZE, SIZE))
    covariance[TURN, TURN] = turn_sd**2 * np.eye(3)
    covariance[OFFSET, OFFSET] = offset_sd**2 * np.eye(3)
    turned = np.eye(3) if rotation is None else rotation
    nothing = np.zeros(3)
    return Estimate(Motion(nothing, turned, np.array(velocity), nothing, nothing, np.array(offset)), covariance)


def shown(change_T, first=None, then=None):
    """The evenness after a sudden change, shape (3,) in the site's frame."""
    first, then = first or known(), then or known()
    evenness = Evenness()
    evenness.update(first.motion.rotation.T @ EARTH_T + first.motion.offset_T, first, 0.0)
    evenness.update(then.motion.rotation.T @ (EARTH_T + change_T) + then.motion.offset_T, then, BLOCK_S)
    return evenness


@pytest.mark.parametrize("way", [NORTH, -NORTH, ASIDE])
def test_a_change_beyond_what_is_usual_is_a_share_of_the_whole_field(way):
    assert shown(0.99 * EVEN_T * way).share == 0.0
    found = shown(3.0 * EVEN_T * way)
    assert found.change_T == pytest.approx(2.0 * EVEN_T)
    assert found.share == pytest.approx(np.sqrt(8.0) * EVEN_T / np.linalg.norm(EARTH_T + 3.0 * EVEN_T * way))


def test_a_turn_of_the_sensor_is_no_change():
    turned = known(Rotation.from_rotvec([0.3, -0.9, 0.5]).as_matrix(), offset=(3e-6, 0.0, -2e-6))
    assert shown(np.zeros(3), known(offset=(3e-6, 0.0, -2e-6)), turned).change_T == 0.0


def test_an_uncertain_attitude_hides_a_change_across_the_field_and_none_along_it():
    vague = known(turn_sd=0.02)
    hidden_T = CERTAIN * 0.02 * np.linalg.norm(EARTH_T)
    change_T = 0.9 * (hidden_T + EVEN_T)
    assert shown(change_T * ASIDE, then=vague).change_T == 0.0
    assert shown(1.2 * (hidden_T + EVEN_T) * ASIDE, then=vague).change_T > 0.0
    assert shown(0.5 * hidden_T * ASIDE, then=vague).share == 0.0, "it may be all the attitude's"
    assert shown(change_T * ASIDE, then=vague).share > 0.0, "it may not"
    assert shown(change_T * NORTH, then=vague).change_T == pytest.approx(change_T - EVEN_T)


def test_an_unknown_offset_hides_changes_of_a_sensor_that_has_turned():
    half = Rotation.from_rotvec(np.pi * ASIDE).as_matrix()
    change_T = 3.0 * EVEN_T * NORTH
    assert shown(change_T, then=known(offset_sd=1e-6)).share > 0.0
    assert shown(change_T, then=known(half, offset_sd=2e-6)).share == 0.0


def test_what_a_track_begins_with_is_replaced_when_the_attitude_is_better_known():
    evenness = Evenness()
    error = Rotation.from_rotvec([0.1, 0.05, 0.0]).as_matrix()
    evenness.update(EARTH_T, known(error, turn_sd=0.1), 0.0)
    for _ in range(3):
        evenness.update(EARTH_T, known(turn_sd=0.001), BLOCK_S)
    assert evenness.share == 0.0
    evenness.update(EARTH_T + 2.0 * EVEN_T * ASIDE, known(turn_sd=0.001), BLOCK_S)
    assert evenness.share > 0.0


@pytest.mark.parametrize("usual_T_m", [3e-6, 2e-5])
@pytest.mark.parametrize(("slope", "said"), [(0.8, False), (3.0, True)])
def test_a_moving_sensor_may_see_other_fields_at_other_places(slope, said, usual_T_m):
    """Two metres at 1 m/s, along which the field changes by a part of what is usual, or by three times as much."""
    evenness, moving = Evenness(gradient_T_m=usual_T_m), known(velocity=(1.0, 0.0, 0.0))
    for place_m in np.arange(0.0, 2.0, BLOCK_S):
        evenness.update(EARTH_T + slope * usual_T_m * place_m * NORTH, moving, BLOCK_S)
    assert (evenness.share > 0.0) is said


def test_iron_that_stays_near_a_sensor_at_rest_stays_said():
    evenness = Evenness()
    evenness.update(EARTH_T, known(), 0.0)
    for _ in range(3000):
        evenness.update(EARTH_T + 1e-5 * NORTH, known(), BLOCK_S)
    assert evenness.change_T == pytest.approx(7e-6, abs=1e-6)
    evenness.forget()
    assert evenness.change_T == evenness.share == 0.0
