"""A fresh chip without processor."""

from collections.abc import Iterator

import pytest

from hil_sim.emulator.bench import Bench
from tests.hil_sim.emulator.flash_bench import unlock


@pytest.fixture
def chip() -> Iterator[Bench]:
    """Out of reset, on its internal oscillator; every violation the test did not expect fails it."""
    bench = Bench()
    yield bench
    report = bench.report
    bench.close()
    assert not report


@pytest.fixture
def fast_chip() -> Iterator[Bench]:
    """Return a chip at 168 MHz with all peripheral clocks on."""
    bench = Bench()
    bench.full_speed()
    yield bench
    report = bench.report
    bench.close()
    assert not report


@pytest.fixture
def open_chip(chip: Bench) -> Bench:
    """Return a chip whose FLASH_CR is unlocked."""
    unlock(chip)
    return chip
