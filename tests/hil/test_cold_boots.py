"""Cold boots of three boards with slow instructions: all run, the sensor locks, nothing is counted."""

import pytest

from tests.bench.cold_boots import boot

SLOWEST = 2.5


@pytest.mark.parametrize("seed", [7, pytest.param(8, marks=pytest.mark.slow)])
def test_a_cold_boot_locks_and_counts_nothing(seed):
    assert boot(seed, SLOWEST)[0] == []


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1000, 1200))
def test_two_hundred_cold_boots(seed):
    assert boot(seed, SLOWEST)[0] == []
