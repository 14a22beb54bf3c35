"""The pose of each cycle in time: at once if all is sound; what is wrong is reviewed meanwhile, for later cycles."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from hil_sim.clib import ROOT
from tests.firmware.core.pose.test_pose import (
    AMBIGUOUS,
    BEACON,
    INCONSISTENT,
    LEFT_OUT,
    NEGATED,
    NOBODY,
    OK,
    STRENGTH,
    UNVERIFIED,
    Sensor,
    fields_at,
    position_of,
    with_fault,
    wrong_ok,
)

SIGMA_T = 2e-8 / np.sqrt(1023)  # 0.2 mG a sample
PENDING = 14
CYCLES = 20  # POSE_LIVE_CYCLES
SPARE = 20  # Steps of a review for which a cycle leaves time: it takes 50 to 60.


@pytest.fixture(scope="module")
def cube():
    return sites.load(ROOT / "host/sites/prigge8.toml")


class Live(Sensor):
    """A board that locates cycle after cycle."""

    def __init__(self, core, site):
        super().__init__(core, site)
        self.live = self.ffi.new("pose_live_t *")
        self.pose = self.ffi.new("pose_t *")
        self.pose.status = 4
        self.lib.pose_live_forget(self.live)

    def cycle(self, fields, sigma_T=SIGMA_T, spare=SPARE):
        """(status, reason, left out, position, tracked) of one cycle; then so many steps of a review."""
        table = self.ffi.new("pose_field_t[]", [(f.tolist(), float(sigma_T)) for f in fields])
        self.lib.pose_live_begin(self.live, self.site, table, self.pose)
        while not self.lib.pose_live_step(self.live, self.pose):
            pass
        for _ in range(spare):
            self.lib.pose_live_spare(self.live)
        return self.pose.status, self.pose.reason, self.pose.left_out


def flight(site, count, seed):
    """Positions and attitudes on a circle of 0.6 m at 1 m/s, with the fields and the noise."""
    rng = np.random.default_rng(seed)
    angle = 0.1 * np.arange(count) / 0.6 + rng.uniform(0.0, 6.0)
    position = np.array([1.065, 1.065, 0.89]) + 0.6 * np.column_stack([np.cos(angle), np.sin(angle), 0.2 + 0.0 * angle])
    turn = Rotation.from_rotvec(np.outer(0.1 * np.arange(count), [0.6, 0.0, 0.8])) * Rotation.random(random_state=rng)
    clean = fields_at(site, position, turn, 0.0, rng)
    return position, turn, clean, rng.normal(0.0, SIGMA_T, clean.shape)


@pytest.mark.parametrize("kind", ["dead", "reversed", "strong", "moved"])
def test_a_faulty_beacon_is_left_out_from_the_first_review_on(core, cube, kind):
    """Every cycle is answered; before the review inconsistent, then located without the beacon, in motion too."""
    position, turn, clean, noise = flight(cube, 30, 41)
    board, right, answers = Live(core, cube), 0, []
    for e in range(30):
        faulty = with_fault(cube, kind, 3, position[e], turn[e], clean[e]) + noise[e]
        answers.append(board.cycle(faulty))
        assert not wrong_ok(board.pose, position[e])
        right += answers[-1] == (OK, LEFT_OUT, 3) and bool(np.linalg.norm(position_of(board.pose) - position[e]) < 0.05)
    assert answers[0] == (INCONSISTENT, PENDING, NOBODY)
    first = next(e for e, answer in enumerate(answers) if answer[2] == 3)
    print(f"{kind}: left out from cycle {first} on, right in {right} of 30")
    assert first <= 4
    assert right >= 30 - first - 2
    assert all(answer[2] in (3, NOBODY) for answer in answers)


def test_a_fault_that_goes_to_another_beacon_never_leaves_out_the_wrong_one(core, cube):
    position, turn, clean, noise = flight(cube, 40, 42)
    board, answers = Live(core, cube), []
    for e in range(40):
        row = 3 if e < 20 else 6
        answers.append(board.cycle(with_fault(cube, "reversed", row, position[e], turn[e], clean[e]) + noise[e]))
        assert answers[-1][2] in (row, NOBODY)
        assert not wrong_ok(board.pose, position[e])
    assert answers[20][:2] == (INCONSISTENT, PENDING)
    assert [answer[2] for answer in answers[26:]] == [6] * 14


def test_a_fault_that_ends_is_forgiven_at_once(core, cube):
    position, turn, clean, noise = flight(cube, 12, 43)
    board = Live(core, cube)
    for e in range(8):
        board.cycle(with_fault(cube, "dead", 3, position[e], turn[e], clean[e]) + noise[e])
    assert board.pose.left_out == 3
    for e in range(8, 12):
        assert board.cycle(clean[e] + noise[e])[0] in (OK, UNVERIFIED)
        assert (board.pose.left_out, board.pose.used, board.pose.tracked) == (NOBODY, 8, True)


@pytest.mark.parametrize(("age", "left_out"), [(CYCLES - 1, 3), (CYCLES, NOBODY)])
def test_both_sides_of_the_age_of_a_verdict(core, cube, age, left_out):
    position, turn, clean, noise = flight(cube, 8, 44)
    board = Live(core, cube)
    faulty = [with_fault(cube, "dead", 3, position[e], turn[e], clean[e]) + noise[e] for e in range(8)]
    for e in range(7):
        board.cycle(faulty[e], spare=100)
    assert board.pose.left_out == 3
    assert not board.live.reviewing
    board.live.age = age
    board.cycle(faulty[7], spare=0)
    assert board.pose.left_out == left_out
    assert (board.pose.reason == PENDING) == (left_out == NOBODY)


def test_a_review_counts_from_the_cycle_whose_fields_it_had(core, cube):
    position, turn, clean, noise = flight(cube, 8, 44)
    board = Live(core, cube)
    for e in range(5):
        board.cycle(with_fault(cube, "dead", 3, position[e], turn[e], clean[e]) + noise[e], spare=0)
    assert board.live.reviewing
    while board.lib.pose_live_spare(board.live):
        pass
    assert (board.live.verdict.row, board.live.age) == (3, 4)


@pytest.mark.parametrize(("factor", "reason"), [(-1.0, NEGATED), (1.2, STRENGTH)])
def test_a_fault_of_the_whole_sensor_is_named_after_its_review(core, cube, factor, reason):
    _, _, clean, noise = flight(cube, 8, 45)
    board = Live(core, cube)
    answers = [board.cycle(factor * clean[e] + noise[e]) for e in range(8)]
    assert answers[0] == (INCONSISTENT, PENDING, NOBODY)
    assert answers[5:] == [(INCONSISTENT, reason, NOBODY)] * 3


def test_as_the_pose_that_is_explained_at_once(core, cube):
    """Where both leave out the beacon they agree; the review is that pose, of its own cycle."""
    position, turn, clean, noise = flight(cube, 20, 46)
    board, alone = Live(core, cube), Sensor(core, cube)
    for e in range(20):
        faulty = with_fault(cube, "moved", 5, position[e], turn[e], clean[e]) + noise[e]
        status, _, left_out = board.cycle(faulty, spare=100)
        whole = alone.locate(faulty, SIGMA_T)
        reviewed = board.live.reviewed
        assert (reviewed.status, reviewed.reason, reviewed.left_out) == (whole.status, whole.reason, whole.left_out)
        if e > 0 and left_out == whole.left_out == 5:
            assert status == whole.status
            assert np.linalg.norm(position_of(board.pose) - position_of(whole)) < 1e-4
    assert left_out == 5


def test_without_a_clear_suspect_nobody_is_left_out(core, cube):
    """A beacon of five a little strong, where it might be another: the verdict of a clear cycle does not help it."""
    position, turn, clean, noise = flight(cube, 12, 47)
    clean[:, [2, 4, 7]] = np.nan
    board = Live(core, cube)
    for e in range(6):
        board.cycle(with_fault(cube, "reversed", 3, position[e], turn[e], clean[e]) + noise[e], spare=100)
    assert board.pose.left_out == 3
    alone, seen = Sensor(core, cube), []
    for e in range(6, 12):
        for strong in np.geomspace(1.002, 1.2, 20):
            fields = clean[e] + noise[e]
            fields[3] += (strong - 1.0) * clean[e][3]
            whole = alone.locate(fields, SIGMA_T)
            status, reason, left_out = board.cycle(fields, spare=0)
            if (whole.status, whole.reason) == (INCONSISTENT, BEACON):
                seen.append(reason)
                assert (status, left_out) == (INCONSISTENT, NOBODY)
    print(f"{len(seen)} of 120 were not clear, {seen.count(BEACON)} of them told at once")
    assert len(seen) >= 5
    assert set(seen) <= {BEACON, PENDING}


def test_two_faulty_beacons_are_never_ok(core, cube):
    position, turn, clean, noise = flight(cube, 24, 48)
    board = Live(core, cube)
    for e in range(24):
        fields = with_fault(cube, "reversed", 3, position[e], turn[e], clean[e])
        fields[6] *= -1.0
        status, _, left_out = board.cycle(fields + noise[e])
        assert (status, left_out) == (INCONSISTENT, NOBODY)


def test_of_four_beacons_none_is_left_out_by_a_verdict(core, cube):
    """A verdict of eight beacons that comes to cycles of four."""
    position, turn, clean, noise = flight(cube, 8, 49)
    board = Live(core, cube)
    for e in range(8):
        fields = with_fault(cube, "reversed", 3, position[e], turn[e], clean[e]) + noise[e]
        if e >= 6:
            fields[[1, 2, 4, 7]] = np.nan
        board.cycle(fields, spare=100 if e < 6 else 0)
        assert not wrong_ok(board.pose, position[e])
        assert board.pose.left_out == (3 if 0 < e < 6 else NOBODY)
    assert board.pose.used == 4
    assert board.pose.status in (INCONSISTENT, AMBIGUOUS)


def test_what_changes_is_forgotten(core, cube):
    position, turn, clean, noise = flight(cube, 4, 50)
    board = Live(core, cube)
    faulty = [with_fault(cube, "dead", 3, position[e], turn[e], clean[e]) + noise[e] for e in range(4)]
    for e in range(2):
        board.cycle(faulty[e], spare=100)
    assert board.pose.left_out == 3
    board.lib.pose_live_forget(board.live)
    assert not board.lib.pose_live_spare(board.live)
    assert board.cycle(faulty[2]) == (INCONSISTENT, PENDING, NOBODY)


def test_what_is_at_work(core, cube):
    """A pose from its beginning to its last step, a review from the end of a pose that was alarmed, and never else."""
    position, turn, clean, noise = flight(cube, 2, 51)
    board, busy = Live(core, cube), []
    table = board.ffi.new("pose_field_t[]", [(f.tolist(), SIGMA_T) for f in clean[0] + noise[0]])
    board.lib.pose_live_begin(board.live, board.site, table, board.pose)
    busy.append(board.live.busy)
    while not board.lib.pose_live_step(board.live, board.pose):
        busy.append(board.live.busy)
    assert all(busy)
    assert (board.live.busy, board.live.reviewing) == (False, False)
    board.cycle(with_fault(cube, "dead", 3, position[1], turn[1], clean[1]) + noise[1], spare=0)
    assert (board.live.busy, board.live.reviewing) == (False, True)
    board.live.busy = True
    board.lib.pose_live_forget(board.live)
    assert (board.live.busy, board.live.reviewing) == (False, False)
