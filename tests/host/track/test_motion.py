"""State, its errors and its process noise; derivatives against differences."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.track.motion import RATE, TURN, Agility, Observation, State, turn_jacobian, turn_matrix
from tests.bench.locate_trials import prigge_cube


def some_state():
    return State(
        np.array([0.9, 1.2, 0.8]),
        Rotation.from_rotvec([0.3, -0.2, 1.1]).as_matrix(),
        np.array([0.5, -0.4, 0.7]),
        np.array([0.9, 1.4, -0.6]),
        np.array([2e-5, 0.0, -4.5e-5]),
    )


@pytest.mark.parametrize("size", [0.0, 1e-9, 9.9e-4, 1.1e-3, 0.4, 3.0])
def test_turns_and_their_jacobian(size):
    vector = size * np.array([0.48, -0.6, 0.64])
    np.testing.assert_allclose(turn_matrix(vector), Rotation.from_rotvec(vector).as_matrix(), atol=1e-14)
    mean, _ = quad_vec(lambda part: Rotation.from_rotvec(part * vector).as_matrix(), 0.0, 1.0)
    np.testing.assert_allclose(turn_jacobian(vector), mean, atol=1e-12)


def test_moved_and_minus_are_inverse():
    error = np.random.default_rng(1).normal(size=15) * np.repeat([0.1, 0.5, 1.0, 1.0, 1e-5], 3)
    np.testing.assert_allclose(some_state().moved(error).minus(some_state()), error, atol=1e-12)


@pytest.mark.parametrize("seconds", [0.1, -0.07, 1.0])
def test_a_state_goes_on_as_its_transition_says(seconds):
    state = some_state()
    later = state.after(seconds)
    np.testing.assert_allclose(later.position_m, state.position_m + seconds * state.velocity_m_s)
    turn = Rotation.from_rotvec(seconds * state.rate_rad_s).as_matrix()
    np.testing.assert_allclose(later.rotation, turn @ state.rotation, atol=1e-14)
    step = 1e-5
    columns = [
        (state.moved(step * e).after(seconds).minus(later) - state.moved(-step * e).after(seconds).minus(later))
        / 2
        / step
        for e in np.eye(15)
    ]
    np.testing.assert_allclose(np.transpose(columns), state.transition(seconds), atol=1e-8)


def test_process_noise_is_the_integrated_random_walk():
    agility = Agility(acceleration=0.7, angular_acceleration=1.3, ambient=2e-6)
    dt = 0.3
    root = agility.noise_root(dt)
    covariance = root @ root.T
    rates = dt * np.array([[dt**2 / 3, dt / 2], [dt / 2, 1.0]])
    np.testing.assert_allclose(covariance[np.ix_([0, 6], [0, 6])], 0.7**2 * rates)
    np.testing.assert_allclose(covariance[np.ix_([4, 10], [4, 10])], 1.3**2 * rates)
    assert covariance[14, 14] == pytest.approx(4e-12 * dt)
    assert covariance[0, 1] == covariance[0, 4] == covariance[6, 14] == 0.0
    parts = [Agility(0.7, 1.3, 2e-6).noise_root(dt / 2)] * 2
    half = np.eye(15)
    half[:6, 6:12] = dt / 2 * np.eye(6)
    twice = half @ parts[0] @ parts[0].T @ half.T + parts[1] @ parts[1].T
    np.testing.assert_allclose(twice, covariance, atol=1e-16)


def test_the_jacobian_of_an_observation():
    rng = np.random.default_rng(2)
    model = FieldModel(prigge_cube().beacons)
    times = np.array([-0.04, 0.01, 0.045])
    seen = rng.normal(size=(3, 5, 27)) * 1e9
    observation = Observation(model, times, seen, rng.normal(size=(3, 5)), 15)
    state = some_state()
    _, jacobian = observation.residual(state)
    for column, size in enumerate(np.repeat([1e-5, 1e-5, 1e-4, 1e-4, 1e-9], 3)):
        error = np.zeros(15)
        error[column] = size
        ahead, behind = (observation.residual(state.moved(sign * error))[0] for sign in (1.0, -1.0))
        slope = (behind - ahead) / 2 / size
        np.testing.assert_allclose(jacobian[:, column], slope, atol=1e-6 * np.abs(slope).max())
    assert np.abs(jacobian[:, TURN]).max() > 0
    assert np.abs(jacobian[:, RATE]).max() > 0
