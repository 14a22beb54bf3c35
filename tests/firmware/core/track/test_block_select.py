"""Which beacons a track uses where there are many, and what the others cost: by their fields, and against all."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.firmware.core.track.conftest import Flight
from tests.firmware.core.track.dense import CHIP_S, Coils, State, still_part
from tests.firmware.core.track.single import BLOCK_S, Kernel, cube, matrices, some_state

END_S = 15 * CHIP_S
SELECTED, GUESTS, CYCLE_BLOCKS = 16, 2, 33
STRONG = SELECTED - GUESTS


def bit_rows(mask):
    return {i for i in range(32) if mask >> i & 1}


class Chooser:
    """`block_select` by itself."""

    def __init__(self, core, coils):
        self.ffi, self.lib = core
        self.kernel, self.count = Kernel(core, coils, 0.02), len(coils.k)
        self.select = self.ffi.new("block_select_t *")

    def choose(self, position, out=0, hold=False):
        """Return the rows that have columns, and the strong ones."""
        self.lib.block_select(self.select, self.kernel.coils, self.count, list(position), out, hold)
        rows = list(self.select.rows)[: self.select.count]
        assert rows == sorted(set(rows))
        return set(rows), bit_rows(self.select.strong)


@pytest.mark.parametrize("count", [SELECTED, 31])
def test_few_beacons_all_have_columns(core, count):
    """Beside fifteen that are never believed, too; and one that is believed again has its column at once."""
    chooser, never = Chooser(core, cube(count)), (1 << count) - (1 << SELECTED)
    for out in (0, 1, 0, 5, 0xFFFF):
        assert chooser.choose([1.0, 1.1, 0.9], never | out)[0] == set(range(count))
    assert len(Chooser(core, cube(SELECTED + 1)).choose([1.0, 1.1, 0.9])[0]) == SELECTED


def test_the_strongest_and_in_turn_each_of_the_others(core):
    coils, position = cube(32), np.array([0.7, 1.2, 0.9])
    chooser, strength = Chooser(core, coils), np.linalg.norm(coils.field(position), axis=1)
    expected, guests = set(np.argsort(-strength)[:STRONG].tolist()), []
    for _ in range(18):
        rows, strong = chooser.choose(position)
        assert strong == expected
        assert len(rows) == SELECTED
        assert strong < rows
        guests.append(rows - strong)
    assert guests[::2] == guests[1::2]
    assert sorted(row for pair in guests[::2] for row in pair) == sorted(set(range(32)) - expected)
    held = [chooser.choose(position, hold=True)[0] - expected for _ in range(5)]
    assert held == [guests[-1]] * 5
    assert chooser.choose(position)[0] - expected == guests[0]


def test_those_not_believed_have_columns_beside_the_others(core):
    coils, position = cube(32), np.array([0.7, 1.2, 0.9])
    chooser, strength = Chooser(core, coils), np.linalg.norm(coils.field(position), axis=1)
    order = np.argsort(-strength).tolist()
    out = {order[0], order[-1]}
    rows, strong = chooser.choose(position, sum(1 << row for row in out))
    assert strong == set(order[1 : STRONG + 1])
    assert len(rows) == SELECTED + 2
    assert out < rows
    assert chooser.choose(position, 0xFFFF)[0] == set(range(32))  # 16 are believed, as many as may be.


@pytest.mark.parametrize("hold", [False, True])
def test_others_are_taken_for_guests_of_which_one_is_not_believed_any_more(core, hold):
    chooser, position = Chooser(core, cube(32)), [0.7, 1.2, 0.9]
    rows, strong = chooser.choose(position)
    gone = min(rows - strong)
    after, strong = chooser.choose(position, 1 << gone, hold)
    assert gone in after
    assert len(after - strong - {gone}) == GUESTS


def test_a_position_that_is_no_number_chooses_as_many(core):
    rows, strong = Chooser(core, cube(20)).choose([np.nan] * 3)
    assert len(strong) == STRONG
    assert len(rows) == SELECTED


@pytest.mark.parametrize(("stronger", "changes"), [(1.19, False), (1.21, True)])
def test_one_of_the_strongest_stays_until_another_is_stronger_by_a_fifth(core, stronger, changes):
    coils, position = cube(32), np.array([0.7, 1.2, 0.9])
    strength = np.linalg.norm(coils.field(position), axis=1)
    order = np.argsort(-strength)
    last, first = order[STRONG - 1], order[STRONG]
    chooser = Chooser(core, coils)
    chooser.choose(position)
    chooser.kernel.coils[int(first)].k_uT_m3 *= stronger * strength[last] / strength[first]
    assert (int(first) in chooser.choose(position)[1]) == changes
    assert (int(last) in chooser.choose(position)[1]) != changes


def test_the_signals_of_the_rest_are_taken_from_the_sums(core, gold_family):
    """Sums of all beacons at rest become those that the selected ones alone would have.

    The selection before had two columns more, which are of the rest now.
    """
    flight, rng = Flight(core, gold_family, count=32), np.random.default_rng(4)
    words = flight.bits.words(310)
    state = replace(some_state(rng), v=np.zeros(3), w=np.zeros(3))
    flight.kernel.fill(words, np.zeros((0, 3)))
    gram, _ = matrices(flight.kernel)
    fields = still_part(flight.coils, state)
    chooser = Chooser(core, flight.coils)
    assert {30, 31} < chooser.choose(state.p, 3 << 30)[0]
    assert not {30, 31} & chooser.choose(state.p)[0]
    rows = [*list(chooser.select.rows)[: chooser.select.count], 32]
    block = Kernel(core, flight.coils, 0.02)
    block.fill([words[i] for i in rows[:-1]], (gram @ fields)[rows])
    at = core[0].new("block_state_t *")
    block.put_state(at, state)
    core[1].block_select_reduce(chooser.select, chooser.kernel.coils, 32, words, 31, at, block.block)
    left = np.array([list(row) for row in block.block.sums_uT])[: len(rows)]
    np.testing.assert_allclose(left, gram[np.ix_(rows, rows)] @ fields[rows], atol=2e-3)
    assert np.abs((gram @ fields)[rows] - left).max() > 1.0


class Both(Flight):
    """A flight through a site of 32 beacons with a filter that uses all of them and one that selects."""

    def __init__(self, core, family, coils, speed, noise=0.02, seed=1, survey_m=0.0):
        super().__init__(core, family, count=len(coils.k), noise=noise, seed=seed)
        self.coils, self.speed = coils, speed
        wrong = coils.centre + survey_m * np.random.default_rng(seed).normal(size=coils.centre.shape)
        declared = replace(coils, centre=wrong)
        self.kernel = Kernel(core, declared, noise)
        self.update = self.kernel.lib.block_filter_update
        self.chosen, self.own = Chooser(core, declared), Kernel(core, declared, noise)
        self.used = self.own.ffi.new("loop_t[32]")
        self.sets, self.strong = [], []

    def truth(self, time_s):
        state = super().truth(time_s)
        drift = np.array([self.speed, 0.0, 0.0])
        return State(state.p + time_s * drift, state.rotation, state.v + drift, state.w, state.e, state.b)

    def start(self):
        super().start()
        ffi = self.own.ffi
        ffi.memmove(self.own.filter, self.kernel.filter, ffi.sizeof("block_filter_t"))
        self._select(self.truth(0.0).p)

    def _select(self, position):
        rows, strong = self.chosen.choose(position)
        self.sets.append(rows)
        self.strong.append(strong)
        for column, row in enumerate(sorted(rows)):
            self.used[column] = self.own.coils[row]
        self.own.lib.block_filter_coils(self.own.filter, self.used, len(rows))

    def step(self):
        """Give the next block to both; return whether the selection changed, and the errors of both poses."""
        data, lib = self.data(), self.own.lib
        words = self.bits.words(31 * self.number)
        assert self.put(data)
        predicted = self.own.ffi.new("block_state_t *", self.own.filter.filters[self.own.filter.best].state)
        lib.block_state_advance(predicted, BLOCK_S, self.own.ffi.new("float[3][3]"))
        if changed := self.number % CYCLE_BLOCKS == 0:
            self._select(list(predicted.position_m))
        rows = sorted(self.sets[-1])
        self.own.fill([words[i] for i in rows], data[[*rows, len(words)]])
        lib.block_select_reduce(self.chosen.select, self.own.coils, len(words), words, 31, predicted, self.own.block)
        assert lib.block_filter_update(self.own.filter, self.own.block, BLOCK_S)
        _, covariance, error = self.output(END_S)
        lib.block_filter_output(self.own.filter, END_S, self.pose)
        truth = self.truth(self.number * BLOCK_S + END_S)
        own = truth.minus(self.own.state(self.pose.state))[:6]
        return changed, error, own, covariance, self.own.matrix(self.pose.covariance)


def hall():
    """32 coils along a hall of 14 m, 3 m wide and 2.6 m high, 13 A m^2, axes in all directions."""
    x, y, z = np.meshgrid(2.0 * np.arange(8), [-0.4, 2.6], [0.0, 2.6], indexing="ij")
    centre = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    return Coils(
        centre, Rotation.random(32, random_state=9).apply([0.0, 0.0, 1.0]), np.full(32, 1.3), np.full(32, 0.149)
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("site", "speed", "noise", "most"),
    [(cube, 0.0, 0.02, 1.2), (cube, 0.0, 0.2, 1.2), (hall, 2.0, 0.02, 1.05), (hall, 2.0, 0.2, 1.05)],
)
def test_what_sixteen_of_thirty_two_cost(core, gold_family, site, speed, noise, most):
    """Errors of position and attitude over those with all of them; the covariance stays true."""
    coils = cube(32) if site is cube else site()
    whole, own, nees = [], [], []
    for seed in (1, 2):
        both = Both(core, gold_family, coils, speed, noise, seed)
        both.start()
        for _ in range(12 * CYCLE_BLOCKS):
            _, error, own_error, _, covariance = both.step()
            if both.number > 2 * CYCLE_BLOCKS:
                whole.append(error)
                own.append(own_error)
                nees.append(own_error @ np.linalg.solve(covariance, own_error) / 6.0)
        assert len(set.union(*both.sets)) > SELECTED
    rms = [
        np.sqrt(np.square(errors).reshape(-1, 2, 3).sum(axis=2).mean(axis=0)) for errors in map(np.array, (whole, own))
    ]
    print(
        f"{site.__name__} {10 * noise:g} mG: all {1e3 * rms[0][0]:.2f} mm {np.degrees(rms[0][1]):.3f} deg, "
        f"16 of 32 {1e3 * rms[1][0]:.2f} mm {np.degrees(rms[1][1]):.3f} deg, NEES {np.mean(nees):.2f}"
    )
    assert np.all(rms[1] < most * rms[0])
    assert 0.6 < np.mean(nees) < 1.5


@pytest.mark.long
def test_no_jump_when_the_selection_changes(core, gold_family):
    """Where all beacons are off by 3 mm, too: a step of the error at a change is like any other."""
    both = Both(core, gold_family, hall(), 4.0, survey_m=0.003)
    both.start()
    steps, before = {False: [], True: []}, None
    for _ in range(10 * CYCLE_BLOCKS):
        changed, _, error, _, covariance = both.step()
        if both.number > CYCLE_BLOCKS:
            steps[changed].append(np.abs((error - before) / np.sqrt(np.diag(covariance))).max())
        before = error
    assert len(both.strong[0] - both.strong[-1]) >= 4
    mean = {changed: np.mean(values) for changed, values in steps.items()}
    print(f"mean step, standard deviations: at a change {mean[True]:.2f}, else {mean[False]:.2f}")
    assert mean[True] < 1.25 * mean[False]
    assert max(steps[True]) < max(steps[False])
