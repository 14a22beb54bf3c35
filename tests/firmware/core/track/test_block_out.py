"""Taking beacons out of blocks and separating their fields: thresholds, and what must stay as it is."""

import numpy as np
import pytest

from tests.firmware.core.track.single import Bits, Kernel, cube, matrices

OTHER = 7.25
"""What stands in a block beside its columns."""


def made(core, gold_family, beacons=3):
    """A block of some beacons, with numbers of before beside its columns."""
    kernel = Kernel(core, cube(beacons), 0.02)
    kernel.fill(Bits(gold_family(10), beacons).words(700), np.random.default_rng(1).normal(size=(beacons + 1, 3)))
    for i in range(33):
        for j in range(33):
            if i > beacons or j > beacons:
                kernel.block.gram[i][j] = kernel.block.moment[i][j] = OTHER
        if i > beacons:
            kernel.block.sums_uT[i] = [OTHER] * 3
    return kernel


def beside(kernel, columns):
    """All numbers beside the columns."""
    squares = [kernel.matrix(of) for of in (kernel.block.gram, kernel.block.moment)]
    rest = np.concatenate([np.r_[a[columns:].ravel(), a[:, columns:].ravel()] for a in squares])
    return np.r_[rest, kernel.matrix(kernel.block.sums_uT)[columns:].ravel()]


def test_what_is_beside_the_columns_of_a_block_stays_as_it_is(core, gold_family):
    kernel = made(core, gold_family)
    kernel.lib.block_leave_out(kernel.block, 1)
    assert (beside(kernel, 4) == OTHER).all()
    assert kernel.lib.block_separate(kernel.block)
    assert (beside(kernel, 4) == OTHER).all()


def test_a_beacon_is_left_out_twice_as_once(core, gold_family):
    kernel = made(core, gold_family)
    kernel.lib.block_leave_out(kernel.block, 1)
    once = [*matrices(kernel), kernel.matrix(kernel.block.sums_uT)]
    kernel.lib.block_leave_out(kernel.block, 1)
    assert all(map(np.array_equal, once, [*matrices(kernel), kernel.matrix(kernel.block.sums_uT)]))


@pytest.mark.parametrize(("unexplained", "enough"), [(0.9e-4, False), (1.1e-4, True)])
def test_a_column_is_separated_that_others_leave_a_ten_thousandth_of(core, gold_family, unexplained, enough):
    """One of two columns explains the other but for 1 less the square of their correlation."""
    kernel = made(core, gold_family, beacons=1)
    correlation = np.sqrt(1.0 - unexplained)
    gram = 31.0 * np.array([[1.0, correlation], [correlation, 1.0]])
    for row, values in zip(kernel.block.gram, gram.tolist(), strict=False):
        row[0:2] = values
    assert kernel.lib.block_separate(kernel.block) == enough


def test_columns_of_zeros_are_passed_over_up_to_the_last_of_all(core, gold_family):
    """The ambient field's column is the last that a block of 32 beacons has."""
    kernel, used = made(core, gold_family, beacons=32), [0, 4, 9, 32]
    gram = np.zeros((33, 33))
    gram[np.ix_(used, used)] = matrices(kernel)[0][np.ix_(used, used)]
    fields = np.zeros((33, 3))
    fields[used] = np.random.default_rng(2).normal(size=(4, 3))
    for i, (row, sums) in enumerate(zip(gram.tolist(), (gram @ fields).tolist(), strict=True)):
        kernel.block.gram[i], kernel.block.sums_uT[i] = row, sums
    assert kernel.lib.block_separate(kernel.block)
    np.testing.assert_allclose(kernel.matrix(kernel.block.sums_uT), fields, atol=1e-6)
    inverse = np.zeros((33, 33))
    inverse[np.ix_(used, used)] = np.linalg.inv(gram[np.ix_(used, used)])
    np.testing.assert_allclose(matrices(kernel)[0], inverse, atol=1e-7)
