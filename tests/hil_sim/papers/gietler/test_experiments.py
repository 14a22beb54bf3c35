"""Tracking three emitters: Jacobian, convergence from a poor guess, and the extended model beside copper."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field.conductor import Parts
from goldfield.track.motion import State
from hil_sim.papers.gietler import conductors, experiments
from hil_sim.papers.gietler.tracker import EmitterBody, EmitterObservation, Noise, PlainFilter, euler_axes, euler_matrix
from hil_sim.world import emitter_world as world


def test_jacobian_is_the_derivative() -> None:
    rng = np.random.default_rng(1)
    current, moment = (rng.normal(size=(3, 4, 3)) + 1.0j * rng.normal(size=(3, 4, 3)) for _ in range(2))
    body = EmitterBody(world.OFFSET_M, world.MOMENT_A_M2, Parts(0.02 * rng.normal(size=(4, 3)), current, moment))
    rotation = Rotation.from_rotvec([0.3, 0.8, -0.4]).as_matrix()
    state = State(np.array([0.2, -0.2, 0.3]), rotation, np.zeros(3), np.zeros(3), np.zeros(3))
    observation = EmitterObservation(body, np.zeros((3, 3), dtype=complex), np.array([1.0, 2.0, 3.0]))
    _, jacobian = observation.residual(state)
    step = 1e-6
    for unknown in range(6):
        error = np.zeros(15)
        error[unknown] = step
        ahead, behind = (observation.residual(state.moved(sign * error))[0] for sign in (1.0, -1.0))
        numeric = (behind - ahead) / (2.0 * step)  # of the expected numbers
        assert np.abs(numeric - jacobian[:, unknown]).max() < 1e-6 * np.abs(jacobian).max()
    assert not jacobian[:, 6:].any()


def test_base_model_is_the_worlds_dipole() -> None:
    path = world.Path(np.array([[0.3, 0.1, -0.2]]), np.array([[0.4, -0.3, 1.1]]))
    fields = world.measured(path, None, 0.0, np.random.default_rng(0))[0]
    state = State(path.position_m[0], path.rotation[0], np.zeros(3), np.zeros(3), np.zeros(3))
    seen, _ = EmitterBody(world.OFFSET_M, world.MOMENT_A_M2).seen(state)
    assert np.abs(seen - fields).max() < 1e-12 * np.abs(fields).max()


def test_euler_angles_are_those_of_the_paper() -> None:
    angles, step = np.array([0.3, -0.4, 1.2]), 1e-6
    matrix = euler_matrix(angles)
    assert np.abs(matrix - Rotation.from_euler("xyz", angles).as_matrix()).max() < 1e-15
    for axis in range(3):
        ahead = euler_matrix(angles + step * np.eye(3)[axis])
        turn = Rotation.from_matrix(ahead @ matrix.T).as_rotvec() / step
        assert np.abs(turn - euler_axes(angles)[:, axis]).max() < 1e-5


@pytest.mark.parametrize("noise", [1e-5, 1e-3])
def test_iterated_filter_converges_where_the_plain_one_fails(noise: float) -> None:
    runs = [experiments.from_poor_guess(noise, seed) for seed in (1, 2)]
    assert all(experiments.converged(run["iterated"]) for run in runs)
    assert not any(experiments.converged(run["plain"]) for run in runs)
    # ... unless it is told of more noise than there is.
    assert all(experiments.converged(run["plain, noise widened"]) for run in runs)


def test_filters_agree_from_a_good_guess() -> None:
    """The plain filter is a fair one: near the truth it tracks as well."""
    rng = np.random.default_rng(5)
    path = world.brownian(experiments.START, 5.0, rng)
    fields = world.measured(path, None, 1e-4, rng)
    body, noise = EmitterBody(world.OFFSET_M, world.MOMENT_A_M2), Noise(1e-4, 0.0)
    deviations = np.array([0.01, 0.02, 0.02, 0.1])
    plain = PlainFilter(body, experiments.START, deviations, experiments.AGILITY, noise)
    track = experiments.follow(path, fields, plain)
    assert experiments.converged(track)


@pytest.mark.slow
def test_ninety_five_per_cent_of_two_hundred_runs_converge() -> None:
    runs = [experiments.from_poor_guess(1e-4, seed) for seed in range(200)]
    assert sum(experiments.converged(run["iterated"]) for run in runs) >= 190
    assert sum(experiments.converged(run["plain"]) for run in runs) < 100


def test_extended_model_tracks_beside_copper_where_the_base_model_fails() -> None:
    truth = conductors.true_conductor("sphere", "copper", 1e4)
    models = experiments.models("sphere", "copper", 1e4)
    _, tracks = experiments.beside_conductor(truth, models, 1e-4, seed=3)
    assert tracks["extended"].rms(experiments.NEAR_M)[0] < 0.01
    assert tracks["base"].rms(experiments.NEAR_M)[0] > 0.03
    assert tracks["base, mistrusted"].rms(experiments.NEAR_M)[0] > 0.03


def test_brownian_path_has_the_stated_covariance() -> None:
    rng = np.random.default_rng(9)
    still = np.zeros((4, 3))
    ends = np.array([world.brownian(still, 2.0, rng).position_m[-1] for _ in range(400)])
    expected = world.VELOCITY_SIGMA * np.sqrt(2.0**3 / 3.0)
    assert ends.std() == pytest.approx(expected, rel=0.08)
