"""Blocks of chips: the products of their columns, beacons left out, and fields separated, against NumPy."""

import numpy as np
import pytest

from tests.firmware.core.track.dense import CHIP_S, products
from tests.firmware.core.track.single import Bits, Kernel, cube, matrices


def filled(core, gold_family, beacons, chip=1000, chips=31, seed=1):
    bits, kernel = Bits(gold_family(10), beacons), Kernel(core, cube(beacons), 0.02)
    data = np.random.default_rng(seed).normal(size=(beacons + 1, 3))
    kernel.fill(bits.words(chip, chips), data, chips)
    return kernel, *products(bits.columns(chip, chips)), np.float32(data).astype(float)


@pytest.mark.parametrize("beacons", [1, 2, 8, 31, 32])
@pytest.mark.parametrize("chips", [1, 11, 31, 32])
def test_products_of_the_columns(core, gold_family, beacons, chips):
    for chip in (0, 17, 1010):  # the last runs into the next cycle
        kernel, gram, moment, _ = filled(core, gold_family, beacons, chip, chips)
        ours, ours_moment = matrices(kernel)
        assert np.array_equal(ours, gram)
        np.testing.assert_allclose(ours_moment, moment, atol=1e-6 * CHIP_S * 240)


def test_bits_behind_the_last_chip_do_not_count(core, gold_family):
    kernel, gram, _, _ = filled(core, gold_family, 3, chips=11)
    words = [word | 0xFFFFF800 for word in Bits(gold_family(10), 3).words(1000, 11)]
    kernel.fill(words, np.zeros((0, 3)), 11)
    assert np.array_equal(matrices(kernel)[0], gram)


def test_nothing_is_left_of_what_stood_in_the_block_before(core, gold_family):
    """The diagonals too, which block_separate turns into variances."""
    kernel, gram, moment, data = filled(core, gold_family, 3)
    for row in range(4):
        kernel.block.gram[row][0:4] = kernel.block.moment[row][0:4] = [np.nan] * 4
    kernel.fill(Bits(gold_family(10), 3).words(1000), data)
    ours, ours_moment = matrices(kernel)
    assert np.array_equal(ours, gram)
    np.testing.assert_allclose(ours_moment, moment, atol=1e-6 * CHIP_S * 240)


@pytest.mark.parametrize("out", [[0], [7], [2, 5, 3]])
def test_a_field_that_is_unknown_is_eliminated(core, gold_family, out):
    kernel, gram, moment, data = filled(core, gold_family, 8)
    for column in out:
        kernel.lib.block_leave_out(kernel.block, column)
    kept = [i for i in range(9) if i not in out]
    share = gram[np.ix_(kept, out)] @ np.linalg.inv(gram[np.ix_(out, out)])
    ours, ours_moment = matrices(kernel)
    ours_sums = kernel.matrix(kernel.block.sums_uT)[:9]
    for mine, whole in ((ours, gram), (ours_moment, moment)):
        np.testing.assert_allclose(
            mine[np.ix_(kept, kept)],
            whole[np.ix_(kept, kept)] - share @ whole[np.ix_(out, kept)],
            atol=3e-6 * np.abs(whole).max(),
        )
        assert not mine[out].any()
        assert not mine[:, out].any()
    np.testing.assert_allclose(ours_sums[kept], data[kept] - share @ data[out], atol=1e-5)
    assert not ours_sums[out].any()


@pytest.mark.parametrize("beacons", [1, 3, 8, 16])
def test_separated_fields_and_their_covariance(core, gold_family, beacons):
    kernel, gram, _, data = filled(core, gold_family, beacons)
    assert kernel.lib.block_separate(kernel.block)
    inverse = np.linalg.inv(gram)
    size = np.abs(inverse).max()
    np.testing.assert_allclose(matrices(kernel)[0], inverse, atol=1e-5 * size)
    fields = kernel.matrix(kernel.block.sums_uT)[: beacons + 1]
    np.testing.assert_allclose(fields, inverse @ data, atol=2e-5 * size * np.abs(data).max())


def test_a_beacon_left_out_has_no_field_and_leaves_the_others_as_they_are(core, gold_family):
    kernel, gram, _, data = filled(core, gold_family, 8)
    kernel.lib.block_leave_out(kernel.block, 4)
    assert kernel.lib.block_separate(kernel.block)
    fields = kernel.matrix(kernel.block.sums_uT)[:9]
    expected = np.linalg.solve(gram, data)
    expected[4] = 0.0
    np.testing.assert_allclose(fields, expected, atol=1e-5)


def test_columns_that_are_not_independent_are_refused(core, gold_family):
    kernel, *_ = filled(core, gold_family, 31)  # 32 columns of 31 chips
    assert not kernel.lib.block_separate(kernel.block)
    words = Bits(gold_family(10), 3).words(0)
    kernel.fill([*words, words[1]], np.zeros((5, 3)))  # two beacons with one code
    assert not kernel.lib.block_separate(kernel.block)
    kernel.fill(words, np.zeros((4, 3)))
    assert kernel.lib.block_separate(kernel.block)
