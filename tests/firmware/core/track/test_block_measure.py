"""What a block tells, by its rows alone: A'A and A'y against the dense calculation in double precision."""

from dataclasses import replace

import numpy as np
import pytest

from tests.firmware.core.track import dense
from tests.firmware.core.track.single import Bits, Kernel, cube, some_state


class Case:
    """A block of some beacons, and a reference beside the truth."""

    def __init__(self, core, gold_family, beacons=8, seed=1, noise=0.02):
        rng = np.random.default_rng(seed)
        self.coils, chip, bits = cube(beacons), int(rng.integers(1023)), Bits(gold_family(10), beacons)
        self.kernel, self.noise = Kernel(core, self.coils, noise), noise
        self.gram, self.moment = dense.products(bits.columns(chip))
        self.reference = some_state(rng)
        self.words, self.truth = (
            bits.words(chip),
            self.reference.moved(np.repeat([0.05, 0.05, 0.3, 0.5, 2.0, 2.0], 3) * rng.normal(size=18)),
        )
        self.data = dense.sums(self.coils, self.truth, self.gram, self.moment)
        self.kernel.fill(self.words, self.data)
        self.measure = self.kernel.ffi.addressof(self.kernel.filter.measure)
        self.kernel.put_state(self.measure.reference, self.reference)
        for fields in (self.measure.model, self.measure.sum, self.measure.moment):
            for field in fields:  # What a block before left is not used.
                field.field_uT, field.gradient = [np.nan] * 3, [np.nan] * 5

    def leave_out(self, column):
        """Leave a beacon out, here by the block's own calculation, in the truth by numpy's."""
        self.kernel.lib.block_leave_out(self.kernel.block, column)
        share = self.gram[:, column] / self.gram[column, column]
        kept = [i for i in range(len(self.gram)) if i != column]
        self.data = (self.data - np.outer(share, self.data[column]))[kept]
        self.moment = (self.moment - np.outer(share, self.moment[column]))[np.ix_(kept, kept)]
        self.gram = (self.gram - np.outer(share, self.gram[column]))[np.ix_(kept, kept)]
        coils = (self.coils.centre, self.coils.axis, self.coils.k, self.coils.radius)
        self.coils = dense.Coils(*(values[kept[:-1]] for values in coils))

    def hold(self, place, known=False):
        """Take the slopes at the place of a state."""
        self.measure.held, self.measure.known = True, known
        self.measure.place.position_m, self.measure.place.ambient_uT = place.p.tolist(), place.e.tolist()

    def single(self):
        """Information and right side, and how many rows tell something."""
        self.kernel.lib.block_measure(self.kernel.block, self.kernel.coils, self.measure)
        rows = self.kernel.matrix(self.measure.rows)
        return rows[:, :18].T @ rows[:, :18], rows[:, :18].T @ rows[:, 18], self.measure.rank

    def dense(self, place=None):
        """The same, with the slopes of the place of a state, else of the reference."""
        place = self.reference if place is None else replace(self.reference, p=place.p, e=place.e)
        data = self.data + self.gram @ (
            dense.still_part(self.coils, place) - dense.still_part(self.coils, self.reference)
        )
        y, rows = dense.measured(self.coils, place, self.gram, self.moment, data, self.noise)
        return rows[:9].T @ rows[:9], rows[:9].T @ y[:9]


def same(ours, truth, most=2e-5):
    """Compare information and right side, in the units of what they tell at most of each number."""
    information, right = truth
    size = np.sqrt(np.diag(information))
    assert np.abs((ours[0] - information) / np.outer(size, size)).max() < most
    assert np.abs((ours[1] - right) / size).max() < most * np.sqrt(right @ np.linalg.pinv(information) @ right)


@pytest.mark.parametrize(("beacons", "most"), [(3, 5e-3), (8, 2e-5), (16, 2e-5)])
def test_a_block_tells_what_its_whitened_rows_tell(core, gold_family, beacons, most):
    case = Case(core, gold_family, beacons)
    ours = case.single()
    same(ours, case.dense(), most)
    assert ours[2] == 9


@pytest.mark.parametrize(("beacons", "strength", "rank"), [(1, 0.0, 3), (1, 1.0, 6), (2, 1.0, 9)])
def test_few_beacons_tell_as_much_as_they_have_numbers(core, gold_family, beacons, strength, rank):
    case = Case(core, gold_family, beacons, seed=2)
    for coil in case.kernel.coils:
        coil.k_uT_m3 *= strength
    ours = case.single()
    assert ours[2] == rank
    rows = case.kernel.matrix(case.measure.rows)
    assert (np.abs(rows).max(axis=1) > 0.0).sum() == rank


def test_what_is_eliminated_first_has_no_column_in_the_rows_that_follow(core, gold_family):
    case = Case(core, gold_family)
    case.single()
    rows, order = case.kernel.matrix(case.measure.rows), [12, 13, 14, 0, 1, 2, 3, 4, 5]
    assert not np.tril(rows[:, order], -1).any()
    assert (np.diag(rows[:, order]) > 0.0).all()


def test_what_a_beacon_tells_that_is_ten_thousand_times_weaker_is_not_seen(core, gold_family):
    """In single precision it is rounding: the one beside it tells its three numbers alone."""
    for seed in range(1, 11):
        case = Case(core, gold_family, 2, seed)
        case.kernel.coils[1].k_uT_m3 *= 1e-4
        assert case.single()[2] == 6
        assert not case.kernel.matrix(case.measure.rows)[6:].any()


@pytest.mark.parametrize("held", [False, True])
def test_what_is_beside_the_columns_of_a_block_does_not_count(core, gold_family, held):
    case = Case(core, gold_family)
    for i in range(33):
        for j in range(33):
            if max(i, j) > 8:
                case.kernel.block.gram[i][j] = case.kernel.block.moment[i][j] = np.nan
        if i > 8:
            case.kernel.block.sums_uT[i] = [np.nan] * 3
    if held:
        case.hold(case.reference)
    same(case.single(), case.dense())


def test_a_block_of_nothing_tells_nothing(core, gold_family):
    case = Case(core, gold_family)
    case.single()
    for i in range(9):
        case.kernel.block.gram[i] = case.kernel.block.moment[i] = [0.0] * 33
        case.kernel.block.sums_uT[i] = [0.0] * 3
    information, right, rank = case.single()
    assert rank == 0
    assert not information.any()
    assert not right.any()


def test_slopes_of_another_place(core, gold_family):
    """Fields are those at the reference, slopes those of the place; a model that is known is not made again."""
    case = Case(core, gold_family)
    place = case.reference.moved(np.repeat([0.1, 0.0, 0.0, 0.0, 5.0, 0.0], 3) * np.tile([1.0, -1.0, 0.5], 6))
    case.hold(place)
    same(case.single(), case.dense(place))
    case.hold(replace(place, p=np.full(3, np.nan)), known=True)
    same(case.single(), case.dense(place))
    case.measure.held = False
    same(case.single(), case.dense())
    assert np.float32(case.reference.p).tolist() == list(case.measure.place.position_m)
    assert np.float32(case.reference.e).tolist() == list(case.measure.place.ambient_uT)


def test_a_block_that_a_beacon_is_left_out_of(core, gold_family):
    case = Case(core, gold_family)
    case.leave_out(3)
    same(case.single(), case.dense())
