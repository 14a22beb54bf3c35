"""Smoothed poses: against a batch solution of the same blocks, and against the filter."""

import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield.field import FieldModel
from goldfield.track.blocks import BlockFilter, BlockSmoother
from goldfield.track.blocks.backward import Step, smoothed
from goldfield.track.blocks.bank import Bank, Start
from goldfield.track.blocks.equations import BlockEquations
from goldfield.track.blocks.state import added, onward
from goldfield.track.blocks.update import observed, reference
from goldfield.types import Status
from tests.bench.motion_trials import EARTH_T, circling, flight_poses
from tests.host.track.blocks.test_filter import ROOMS, SITES, figures, stream_of, streamed

AGILITY = np.array([[0.5, 1.0]])


def steps_of(stream, count):
    """Steps of a single filter, and the prior that it began with, with the forms of its blocks."""
    site = stream.site
    equations, bank = BlockEquations(site), Bank(FieldModel(site.beacons), AGILITY)
    forms = [equations.form(block) for block in stream.blocks()[:count]]
    period = 31 * site.chip_period_s
    position, rotation = flight_poses(stream.flight, 16 * site.chip_period_s)
    spread = np.diag(np.repeat([1e-3, 1e-3], 3) ** 2)
    bank.start(Start(position, rotation.as_matrix(), spread, EARTH_T, 1e-12 * np.eye(3)))
    prior = bank.output()
    steps = []
    for k, form in enumerate(forms):
        assert bank.update(form, period if k else 0.0)
        steps.append(Step(1, k * period, bank.output(), AGILITY[0], None))
    return prior, steps, forms


@pytest.mark.parametrize("around", ["what the filter expected", "the smoothed states"])
def test_smoothing_is_the_batch_solution(around):
    """All states of all blocks at once: prior, motion and blocks as one least squares.

    With the blocks linearised where the filter did it is the same but for rounding. Around the smoothed states the
    ambient field and the offset differ, which the sweep ties to a turn rate that the first blocks do not know yet.
    """
    stream = stream_of("one", 2e-8, 3, 0.12)
    prior, steps, forms = steps_of(stream, 18)
    model, period, size = FieldModel(stream.site.beacons), 31 * stream.site.chip_period_s, 18
    expected = [prior.motion, *(onward(step.known.motion, period)[0] for step in steps[:-1])]
    states = [estimate.motion for estimate in smoothed(steps)]
    scale = np.repeat([1e-3, 1e-3, 1e-1, 1e-1, 1e-7, 1e-7], 3)
    for _ in range(3):
        normal, right = np.zeros((size * len(states),) * 2), np.zeros(size * len(states))

        def add(rows, residual, root, normal=normal, right=right):
            jacobian = np.zeros((len(residual), len(right)))
            for place, part in rows:
                jacobian[:, size * place : size * (place + 1)] = root @ part * scale
            normal += jacobian.T @ jacobian
            right += jacobian.T @ (root @ residual)

        root = np.linalg.inv(np.linalg.cholesky(prior.covariance))
        add([(0, np.eye(size))], prior.motion.minus(states[0]), root)
        root = np.linalg.inv(np.linalg.cholesky(added(AGILITY[0], period)))
        for k in range(len(states) - 1):
            later, transition = onward(states[k], period)
            add([(k, -transition), (k + 1, np.eye(size))], later.minus(states[k + 1]), root)
        for k, form in enumerate(forms):
            at = states[k] if around == "the smoothed states" else expected[k]
            block = observed(form, reference(model, at))
            score = block.score - states[k].minus(at) @ block.seen
            add([(k, block.seen.T)], score, np.eye(len(score)))
        step = np.linalg.solve(normal, right).reshape(-1, size) * scale
        states = [state.moved(change) for state, change in zip(states, step, strict=True)]
    batch = np.linalg.inv(normal)
    most, spread = (0.02, 0.002) if around == "what the filter expected" else (np.repeat([0.1, 0.3], [12, 6]), 0.03)
    for k, (estimate, state) in enumerate(zip(smoothed(steps), states, strict=True)):
        covariance = batch[size * k : size * (k + 1), size * k : size * (k + 1)] * np.outer(scale, scale)
        deviation = np.sqrt(np.diag(covariance))
        assert np.all(np.abs(estimate.motion.minus(state) / deviation) < most)
        np.testing.assert_allclose(np.sqrt(np.diag(estimate.covariance)) / deviation, 1.0, atol=spread)


@pytest.mark.parametrize(("name", "noise_T", "gain"), [("one", 2e-7, 0.85), ("hand", 2e-8, 0.8)])
def test_smoothed_poses_are_more_accurate_and_say_so(name, noise_T, gain):
    stream = stream_of(name, noise_T, 30, 0.8)
    track = BlockFilter(stream.site)
    filtered = [track.update(block) for block in stream.blocks()]
    late = list(BlockSmoother(stream.site).poses(stream.blocks()))
    assert [pose.time_s for pose in late] == [pose.time_s for pose in filtered]
    assert [pose.status for pose in late] == [pose.status for pose in filtered]
    before, after = figures(stream, filtered[:-16]), figures(stream, late[:-16])
    assert after[0] < gain * before[0]
    assert 0.4 < after[2] < 1.8
    for one, other in zip(late[:-16], filtered, strict=False):
        assert np.trace(one.position_cov_m2) < np.trace(other.position_cov_m2)


def test_poses_are_late_by_the_lag_and_none_is_lost_between_tracks():
    rng = np.random.default_rng(31)
    stream = streamed(ROOMS[2e-7], circling(rng, 1.0, 1.0), 0.9, 2e-7, rng)
    blocks = stream.blocks()
    smoother, out = BlockSmoother(SITES[2e-7], 0.03), []
    for place, block in enumerate([*blocks[:60], *blocks[270:]]):
        for pose in smoother.update(block):
            assert place == 60 or 0.03 <= block.time_s - pose.time_s < 0.06
            out.append(pose)
    out += smoother.finish()
    assert [pose.time_s for pose in out] == [block.time_s for block in [*blocks[:60], *blocks[270:]]]
    assert {pose.status for pose in out} <= {Status.OK, Status.UNVERIFIED}
    with pytest.raises(UserError, match="the lag is 0 s; it must be above 0"):
        BlockSmoother(SITES[2e-7], 0.0)


@pytest.mark.parametrize("name", ["hand", "drone"])
@pytest.mark.parametrize("every", [2, 3, 10])
def test_lost_blocks_have_smoothed_poses_too(name, every):
    """Each of several sensors that share a CAN sends a part of its blocks."""
    stream = stream_of(name, 2e-8, 34, 0.8)
    blocks = stream.blocks()
    came = blocks[::every]
    late = list(BlockSmoother(stream.site).poses(came))
    np.testing.assert_allclose([pose.time_s for pose in late], [block.time_s for block in blocks[: len(late)]])
    assert [pose.epoch for pose in late] == [(31 * k + 30) // 1023 for k in range(len(late))]
    assert len(late) == every * (len(came) - 1) + 1
    settled = late[66:-16]
    rms_m, _, normal = figures(stream, settled)
    track = BlockFilter(stream.site)
    filtered = [track.update(block) for block in came]
    assert rms_m < figures(stream, filtered[66 // every :])[0]
    assert 0.3 < normal < 2.0


def test_a_longer_gap_has_no_smoothed_poses():
    stream = stream_of("drone", 2e-8, 34, 0.5)
    blocks = stream.blocks()
    for lost, bridged in ((14, True), (17, False)):  # 45 ms and 55 ms from end to end
        came = [*blocks[:60], *blocks[60 + lost :]]
        late = list(BlockSmoother(stream.site).poses(came))
        assert len(late) == len(blocks) if bridged else len(late) == len(came)
