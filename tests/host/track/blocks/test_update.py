"""The update of the block filter against dense linear algebra, and its fields against differences."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.track.blocks.equations import BlockEquations
from goldfield.track.blocks.state import (
    AMBIENT,
    OFFSET,
    POSITION,
    RATE,
    TURN,
    Motion,
    added,
    crosses,
    onward,
    rotation_vector,
)
from goldfield.track.blocks.update import UNEVEN_T_S, observed, reference, taken_by
from goldfield.types import Block
from tests.bench.locate_trials import magpylib_fields, prigge_cube

SITE = prigge_cube(2e-7)
MODEL, EQUATIONS = FieldModel(SITE.beacons), BlockEquations(SITE)
RNG = np.random.default_rng(3)
ROTATION = Rotation.random(rng=RNG)
MOTION = Motion(
    np.array([0.9, 1.2, 0.7]),
    ROTATION.as_matrix(),
    np.array([0.8, -0.5, 0.3]),
    np.array([0.4, 1.1, -0.7]),
    np.array([2e-5, 0.0, -4.5e-5]),
    np.array([3e-6, -1e-6, 2e-6]),
)
SCALE = np.repeat([1e-2, 2e-2, 0.3, 0.3, 2e-6, 2e-6], 3)


def samples(motion):
    """A block's samples around a motion, from magpylib's fields."""
    tau = (np.arange(31) - 15.0) * SITE.chip_period_s
    position = motion.position_m + tau[:, None] * motion.velocity_m_s
    attitude = Rotation.from_rotvec(np.outer(tau, motion.rate_rad_s)) * Rotation.from_matrix(motion.rotation)
    fields = np.einsum("tn,tnc->tc", EQUATIONS.columns[:31, :8], magpylib_fields(SITE, position)) + motion.ambient_T
    return attitude.inv().apply(fields) + motion.offset_T


def form(data):
    return EQUATIONS.form(Block(0, 0, 31 * SITE.chip_period_s, 31, data, True))


def several(motion):
    return Motion(*(np.array([part]) for part in vars(motion).values()))


def covariance(rng):
    root = rng.normal(size=(18, 18)) * SCALE[:, None]
    return root @ root.T / 18.0


def test_what_a_motion_expects_is_what_magpylib_gives():
    rest = reference(MODEL, MOTION).residual(form(samples(MOTION)))
    assert np.abs(rest).max() < 31 * 2e-10  # a hundredth of the noise at .2 mG: curvature within 3 ms


@pytest.mark.parametrize("axis", range(18))
def test_the_residual_changes_with_the_state_as_the_update_takes_it(axis):
    step = np.zeros(18)
    step[axis] = 1e-4 * SCALE[axis]
    block, around = form(samples(MOTION)), reference(MODEL, MOTION)
    ahead, behind = (reference(MODEL, MOTION.moved(sign * step)) for sign in (1.0, -1.0))
    turned = [other.residual(block) @ other.motion.rotation for other in (ahead, behind)]
    measured = (turned[1] - turned[0]) @ MOTION.rotation.T / 2e-4 / SCALE[axis]
    expected = _dense(block, around)[:, axis].reshape(-1, 3)
    np.testing.assert_allclose(measured, expected, atol=2e-3 * np.abs(expected).max())


def _dense(block, around):
    """Derivative of the sums, turned into the site's frame, by the 18 errors.

    How the fields of the beacons change within the block is taken to be known but for the motion; of the ambient field
    it is known how it changes with the field and the attitude, too.
    """
    by_place = np.zeros((9, 3, 18))
    by_place[:, :, POSITION], by_place[:, :, TURN] = around.jacobian[:, :, :3], around.jacobian[:, :, 3:6]
    by_place[8, :, AMBIENT], by_place[8, :, OFFSET] = np.eye(3), around.motion.rotation
    by_motion = np.zeros_like(by_place)
    by_motion[:, :, 6:12] = around.jacobian[:, :, :6]
    by_motion[8, :, AMBIENT] = -crosses(around.motion.rate_rad_s)
    by_motion[8, :, TURN] = crosses(around.slope_T_s[8])
    return np.einsum("ij,jck->ick", block.gram, by_place).reshape(27, 18) + np.einsum(
        "ij,jck->ick", block.moment, by_motion
    ).reshape(27, 18)


def test_an_update_is_the_one_of_dense_matrices_when_the_motion_is_known():
    """Without a turn, whose sweep has an uncertainty of its own."""
    rng, motion = np.random.default_rng(5), replace(MOTION, rate_rad_s=np.zeros(3))
    prior = covariance(rng)
    prior[6:12], prior[:, 6:12] = 0.0, 0.0
    block, around = form(samples(motion) + 2e-7 * rng.normal(size=(31, 3))), reference(MODEL, motion)
    update = taken_by(several(motion), prior[None], observed(block, around))
    slope, noise = _dense(block, around), np.kron(block.gram, 2e-7**2 * np.eye(3))
    gain = prior @ slope.T @ np.linalg.inv(slope @ prior @ slope.T + noise)
    np.testing.assert_allclose(update.change[0] / SCALE, gain @ around.residual(block).ravel() / SCALE, atol=1e-6)
    after = (prior - update.gain[0] @ update.gain[0].T) / np.outer(SCALE, SCALE)
    np.testing.assert_allclose(after, (prior - gain @ slope @ prior) / np.outer(SCALE, SCALE), atol=1e-6)


def test_the_turn_rate_is_told_as_well_as_by_dense_matrices():
    """The sums tell it by the sweep of the ambient field: nearly as well as anything that knows them can.

    That the sweep's own uncertainty is one factor, and not a matrix beside the noise, costs up to a quarter.
    """
    prior = np.diag(SCALE**2)
    prior[6:12, 6:12] = np.diag([0.3**2] * 3 + [4.0**2] * 3)
    site = prigge_cube(2e-8)
    around = reference(MODEL, MOTION)
    block = BlockEquations(site).form(Block(0, 0, 31 * site.chip_period_s, 31, samples(MOTION), True))
    update = taken_by(several(MOTION), prior[None], observed(block, around))
    uneven = UNEVEN_T_S * block.moment[:, -1]
    slope, noise = _dense(block, around), np.kron(2e-8**2 * block.gram + np.outer(uneven, uneven), np.eye(3))
    least = prior - prior @ slope.T @ np.linalg.solve(slope @ prior @ slope.T + noise, slope @ prior)
    after = prior - update.gain[0] @ update.gain[0].T
    for part in (POSITION, TURN, RATE):
        assert 0.99 < np.sqrt(np.trace(after[part, part]) / np.trace(least[part, part])) < 1.25
    assert np.sqrt(np.trace(after[RATE, RATE]) / np.trace(prior[RATE, RATE])) < 0.7


def test_an_unknown_motion_widens_what_a_block_says_and_its_surprise_stays_chi_square():
    rng, costs, errors = np.random.default_rng(6), [], []
    prior = covariance(rng) * np.outer(SCALE * 0 + 0.2, SCALE * 0 + 0.2)
    prior[6:12, 6:12] += np.diag([9.0] * 3 + [16.0] * 3)
    root, around = np.linalg.cholesky(prior), reference(MODEL, MOTION)
    for _ in range(300):
        truth = MOTION.moved(root @ rng.normal(size=18))
        block = form(samples(truth) + 2e-7 * rng.normal(size=(31, 3)))
        update = taken_by(several(MOTION), prior[None], observed(block, around))
        costs.append(update.surprise[0])
        after = prior - update.gain[0] @ update.gain[0].T
        error = truth.minus(MOTION.moved(update.change[0]))
        errors.append(error[:6] @ np.linalg.solve(after[:6, :6], error[:6]))
    # Twelve numbers tell; the ambient field is even here, so that three of them surprise less than they might.
    assert 9.0 < np.mean(costs) < 12.5
    assert np.mean(errors) == pytest.approx(6.0, abs=0.9)


def test_what_is_not_seen_is_not_believed_to_be_seen():
    one = form(samples(MOTION)).without(np.arange(1, 8))
    block = observed(one, reference(MODEL, MOTION))
    assert block.rank == 6
    assert block.seen.any(axis=0).sum() == 6
    update = taken_by(several(MOTION), np.diag(SCALE**2)[None], block)
    assert np.isfinite(update.change).all()
    assert 0.0 <= update.surprise[0] < 40.0


def test_errors_go_on_as_the_transition_says():
    rng = np.random.default_rng(7)
    error = 1e-5 * SCALE * rng.normal(size=18)
    seconds = 0.3
    later, transition = onward(MOTION, seconds)
    apart = MOTION.moved(error).after(seconds).minus(later)
    # J_l to the second order in the turn, .4 rad
    np.testing.assert_allclose(apart / SCALE, transition @ error / SCALE, atol=3e-7)


def test_noise_adds_up_over_time():
    agility = np.array([[0.5, 1.0]])
    still = Motion(*(np.zeros_like(part) if part.shape == (3,) else part for part in vars(MOTION).values()))
    _, transition = onward(still, 0.2)
    once = added(agility, 0.2)[0]
    twice = transition @ once @ transition.T + once
    np.testing.assert_allclose(twice, added(agility, 0.4)[0], rtol=1e-12, atol=1e-30)


def test_rotation_vectors_come_back():
    vectors = np.array([[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0], [0.02, -0.01, 0.3], [1.0, -1.5, 0.4]])
    turns = Rotation.from_rotvec(vectors).as_matrix()
    np.testing.assert_allclose(rotation_vector(turns), vectors, atol=1e-12)
