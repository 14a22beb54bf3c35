"""The bank of filters: at its bound on matched motion, quick to change its agility, gated."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.field import FieldModel
from goldfield.track.blocks.bank import AGILITIES, Bank, Start
from goldfield.track.blocks.equations import BlockEquations
from goldfield.track.blocks.state import Motion, added, onward
from goldfield.track.blocks.update import observed, reference, taken_by
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import EARTH_T, Flight, Room, flight_poses
from tests.host.track.blocks.flights import MIDDLE_M, still, streamed

NOISE_T = 2e-7
SITE = prigge_cube(NOISE_T)
ROOM, MODEL, EQUATIONS = Room(SITE), FieldModel(SITE.beacons), BlockEquations(SITE)
PERIOD_S = 31 * SITE.chip_period_s
STEP_S = 1e-3


def drawn(rng, acceleration, turning, seconds):
    """A path of white acceleration and white angular acceleration, drawn every millisecond."""
    count = round(seconds / STEP_S) + 10
    change = np.sqrt(STEP_S) * rng.normal(size=(2, count, 3)) * np.array([acceleration, turning])[:, None, None]
    velocity, rate = (
        0.3 * rng.normal(size=3) + change[0].cumsum(axis=0),
        0.5 * rng.normal(size=3) + change[1].cumsum(axis=0),
    )
    place = MIDDLE_M + rng.uniform(-0.3, 0.3, 3) + STEP_S * velocity.cumsum(axis=0)
    attitudes, attitude = [], Rotation.random(rng=rng)
    for step in rate:
        attitudes.append(attitude)
        attitude = Rotation.from_rotvec(STEP_S * step) * attitude

    def position(times):
        place_of, part = np.floor(times / STEP_S).astype(int), (times / STEP_S) % 1.0
        return place[place_of] + (STEP_S * part)[:, None] * velocity[place_of + 1]

    def rotation(times):
        place_of, part = np.floor(times / STEP_S).astype(int), (times / STEP_S) % 1.0
        before = Rotation.concatenate([attitudes[k] for k in place_of])
        return Rotation.from_rotvec((STEP_S * part)[:, None] * rate[place_of]) * before

    return Flight(position, rotation)


def motion_of(flight, time_s):
    """The true motion at a moment."""
    position, rotation = flight.poses(time_s + np.array([-1e-3, 0.0, 1e-3]))
    return Motion(
        position[1],
        rotation[1].as_matrix(),
        (position[2] - position[0]) / 2e-3,
        (rotation[2] * rotation[0].inv()).as_rotvec() / 2e-3,
        EARTH_T,
        np.zeros(3),
    )


def started(bank, flight, rng, sd=(0.01, 0.01)):
    """Begin a bank at the middle of the first block of a flight, off by chance."""
    position, rotation = flight_poses(flight, 16 * SITE.chip_period_s)
    deviation = np.repeat(sd, 3)
    error = deviation * rng.normal(size=6)
    attitude = Rotation.from_rotvec(error[3:]) * rotation
    bank.start(
        Start(position + error[:3], attitude.as_matrix(), np.diag(deviation**2), EARTH_T, (2e-6) ** 2 * np.eye(3))
    )


def one(motion):
    return Motion(*(np.array([part]) for part in vars(motion).values()))


def matched(seeds, agility, seconds):
    """Errors squared, bounds squared and normalised errors of a filter whose agility is the sensor's."""
    rows = []
    for seed in seeds:
        rng = np.random.default_rng([seed, 40])
        stream = streamed(ROOM, drawn(rng, *agility, seconds + 0.01), seconds, NOISE_T, rng)
        bank = Bank(MODEL, np.array([agility]))
        started(bank, stream.flight, rng)
        bound = bank.output().covariance
        for k, block in enumerate(stream.blocks()):
            form = EQUATIONS.form(block)
            truth = motion_of(stream.flight, block.time_s - form.end_s)
            if k:  # Riccati's recursion along the true path
                _, transition = onward(truth, PERIOD_S)
                bound = transition @ bound @ transition.T + added(np.array(agility), PERIOD_S)
            gain = taken_by(one(truth), bound[None], observed(form, reference(MODEL, truth))).gain[0]
            bound = bound - gain @ gain.T
            assert bank.update(form, PERIOD_S if k else 0.0)
            known = bank.output()
            error = truth.minus(known.motion)[:6]
            if block.time_s > 0.15:
                rows.append(
                    [
                        error[:3] @ error[:3],
                        np.trace(bound[:3, :3]),
                        error[3:] @ error[3:],
                        np.trace(bound[3:6, 3:6]),
                        error @ np.linalg.solve(known.covariance[:6, :6], error) / 6.0,
                    ]
                )
    return np.array(rows)


@pytest.mark.parametrize("agility", [(0.5, 1.0), (2.0, 4.0)])
def test_a_filter_of_the_right_agility_is_at_its_bound(agility):
    rows = matched(range(5), agility, 0.4)
    ratio = np.sqrt(rows[:, [0, 2]].mean(axis=0) / rows[:, [1, 3]].mean(axis=0))
    assert (ratio < 1.15).all()
    assert (ratio > 0.8).all()
    assert rows[:, 4].mean() == pytest.approx(1.0, abs=0.25)


def test_the_agility_is_found_and_lost_again():
    """A sensor that rests, is shaken, and rests."""
    rng = np.random.default_rng(41)
    place, attitude = MIDDLE_M, Rotation.random(rng=rng)

    def shaken(times):
        part = np.clip((times - 0.5) / 0.5, 0.0, 1.0)
        return 0.05 * np.sin(2 * np.pi * 2.5 * (times - 0.5)) * np.sin(np.pi * part) ** 2

    flight = Flight(
        lambda times: place + np.outer(shaken(times), [1.0, -0.5, 0.5]),
        lambda times: Rotation.from_rotvec(np.outer(5.0 * shaken(times), [0.0, 1.0, 0.0])) * attitude,
    )
    stream, bank, found = streamed(ROOM, flight, 1.6, NOISE_T, rng), Bank(MODEL), []
    started(bank, flight, rng)
    for k, block in enumerate(stream.blocks()):
        assert bank.update(EQUATIONS.form(block), PERIOD_S if k else 0.0)
        found.append(bank.agility[0])
    agility = np.array(found)
    assert agility[120:160].mean() < 0.8
    assert agility[200:300].max() > 1.5
    assert agility[-60:].mean() < 0.8


def test_a_block_of_something_else_is_refused_and_the_track_goes_on():
    rng = np.random.default_rng(42)
    stream, bank = streamed(ROOM, still(rng), 0.3, NOISE_T, rng), Bank(MODEL)
    started(bank, stream.flight, rng)
    blocks = stream.blocks()
    for block in blocks[:60]:
        assert bank.update(EQUATIONS.form(block), PERIOD_S)
    before, mismatch = bank.output(PERIOD_S), bank.mismatch
    blocks[60].data_T[:] += 1e-5 * np.sign(rng.normal(size=(31, 3)))
    assert not bank.update(EQUATIONS.form(blocks[60]), PERIOD_S)
    assert (bank.refused, bank.mismatch) == (1, mismatch)
    np.testing.assert_allclose(bank.output().motion.position_m, before.motion.position_m, atol=1e-4)
    assert np.trace(bank.output().covariance[:3, :3]) > 0.9 * np.trace(before.covariance[:3, :3])
    assert bank.update(EQUATIONS.form(blocks[61]), PERIOD_S)
    assert bank.refused == 0


def test_the_likelihood_prefers_the_place_where_the_sensor_is():
    rng = np.random.default_rng(43)
    stream = streamed(ROOM, still(rng), 0.1, NOISE_T, rng)
    banks = [Bank(MODEL), Bank(MODEL)]
    started(banks[0], stream.flight, rng)
    started(banks[1], Flight(lambda t: stream.flight.position(t) + 0.05, stream.flight.rotation), rng, (0.05, 0.01))
    for block in stream.blocks()[:8]:
        for bank in banks:
            bank.update(EQUATIONS.form(block), PERIOD_S)
    assert banks[0].mismatch < banks[1].mismatch


def test_agilities_rise():
    assert (np.diff(AGILITIES, axis=0) >= 0.0).all()
