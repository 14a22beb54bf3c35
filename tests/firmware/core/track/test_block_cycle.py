"""A cycle's fields of a sensor in motion: residuals of its blocks summed, at the pose in its middle."""

import numpy as np
import pytest

from tests.firmware.core.track.dense import CHIP_S
from tests.firmware.core.track.single import BLOCK_S, Kernel, cube, some_state

CHIPS, LENGTH, BLOCKS = 1023, 31, 33
ROWS = [1, 4, 6]


class Cycle:
    """`block_cycle` of three of eight coils, and a motion that goes on at constant rates."""

    def __init__(self, core, seed=1):
        self.ffi, self.lib = core
        self.coils, rng = cube(8), np.random.default_rng(seed)
        self.kernel, self.state = Kernel(core, self.coils, 0.02), some_state(rng)
        self.left = rng.normal(size=(200, len(ROWS) + 1, 3))
        self.cycle, self.select = self.ffi.new("block_cycle_t *"), self.ffi.new("block_select_t *")
        self.select.count, self.select.rows[0 : len(ROWS)] = len(ROWS), ROWS
        self.clear()

    def clear(self):
        self.lib.block_cycle_clear(self.cycle, self.kernel.coils, self.select)

    def add(self, number, first=0):
        """Add a block of a number; block 0 begins at chip `first`. Returns whether a cycle is complete."""
        residual, predicted = self.ffi.new("block_residual_t *"), self.ffi.new("block_state_t *")
        for row, values in zip(residual.left_uT, self.left[number], strict=False):
            row[0:3] = values.tolist()
        self.kernel.put_state(predicted, self.state.ahead(number * BLOCK_S))
        chip = (first + LENGTH * number) % CHIPS
        return self.lib.block_cycle_add(self.cycle, number, chip, CHIP_S, residual, predicted)

    def middle(self, first):
        """The state in the middle of the cycle that begins in block 0 or, where `first` says so, in that."""
        begins = -first % CHIPS
        return self.state.ahead((begins + (CHIPS - 1) / 2 - (LENGTH - 1) / 2) * CHIP_S)

    def check(self, blocks, middle):
        """Compare the sums with those of some blocks, and what is made of them with the fields at the middle."""
        sums = self.left[blocks].sum(axis=0)
        ours = np.array([list(row) for row in self.cycle.residual_uT])[: len(sums)]
        np.testing.assert_allclose(ours, sums, atol=1e-5)
        fields = self.coils.field(middle.p)[ROWS]
        for column, field in enumerate(fields):
            separated = self.ffi.new("float[3]", [0.3, -0.2, 0.5])
            self.lib.block_cycle_field(self.cycle, column, separated)
            expected = middle.rotation.T @ (field + np.array([0.3, -0.2, 0.5]))
            np.testing.assert_allclose(list(separated), expected, atol=2e-6)


@pytest.mark.parametrize("first", [0, 1, 30, 993, 1022])
def test_a_cycle_is_that_of_33_blocks_from_code_chip_0_on(core, first):
    """The blocks begin anywhere in the code: the first one that counts has code chip 0 in it."""
    cycle = Cycle(core)
    begins = next(n for n in range(BLOCKS) if (chip := (first + LENGTH * n) % CHIPS) == 0 or chip > CHIPS - LENGTH)
    whole = [n for n in range(2 * BLOCKS + begins) if cycle.add(n, first)]
    assert whole == [begins + BLOCKS - 1, begins + 2 * BLOCKS - 1]


@pytest.mark.parametrize("first", [0, 993, 1010, 1022])
def test_sums_and_the_pose_in_the_middle(core, first):
    cycle = Cycle(core)
    assert [n for n in range(BLOCKS) if cycle.add(n, first)] == [BLOCKS - 1]
    cycle.check(range(BLOCKS), cycle.middle(first))


def test_the_next_cycle_has_its_own(core):
    cycle = Cycle(core)
    for number in range(2 * BLOCKS):
        cycle.add(number)
    middle = cycle.state.ahead((CHIPS + (CHIPS - 1) / 2 - (LENGTH - 1) / 2) * CHIP_S)
    cycle.check(range(BLOCKS, 2 * BLOCKS), middle)


@pytest.mark.parametrize("lost", [{20}, {0}, {32}, {20, 21}])
def test_a_block_that_was_lost_gives_up_the_cycle(core, lost):
    cycle = Cycle(core)
    numbers = [n for n in range(3 * BLOCKS) if n not in lost]
    assert [n for n in numbers if cycle.add(n)] == [2 * BLOCKS - 1, 3 * BLOCKS - 1]
    cycle.check(range(2 * BLOCKS, 3 * BLOCKS), cycle.state.ahead((2.5 * CHIPS - LENGTH / 2) * CHIP_S))


def test_a_track_that_starts_anew_amid_a_cycle_waits_for_the_next(core):
    cycle = Cycle(core)
    for number in range(20):
        cycle.add(number)
    cycle.clear()
    assert not any(list(row) != [0.0] * 3 for row in cycle.cycle.residual_uT)
    assert [n for n in range(20, 2 * BLOCKS) if cycle.add(n)] == [2 * BLOCKS - 1]
    cycle.check(range(BLOCKS, 2 * BLOCKS), cycle.state.ahead((1.5 * CHIPS - LENGTH / 2) * CHIP_S))


@pytest.mark.parametrize("lost", [{20, 33}, {32, 33}, {33, 60}])
def test_blocks_of_two_cycles_make_none(core, lost):
    """The block with code chip 0 was lost, too: so many blocks as a cycle has follow each other, but not of one."""
    cycle = Cycle(core)
    whole = [n for n in range(3 * BLOCKS) if n not in lost and cycle.add(n)]
    assert whole == [n for n in (BLOCKS - 1, 3 * BLOCKS - 1) if not lost & set(range(n - BLOCKS + 1, n + 1))]
