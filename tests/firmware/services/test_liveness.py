"""The watchdog is fed only while every part that a role needs has moved; what stands still is noted."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
BEACON, SENSOR, ANCHOR = 0, 1, 3
CRYSTAL, SLOW = 0, 2
BLOCKS, CURRENTS, SAMPLES, LINK = range(4)
NEEDED = {BEACON: (BLOCKS, CURRENTS, LINK), SENSOR: (BLOCKS, SAMPLES, LINK), ANCHOR: (BLOCKS, CURRENTS, SAMPLES, LINK)}
TURN_US, PERIOD_US, PATIENCE_US, GOOD_BLOCKS = 3000, 15_000, 100_000, 4

STUB = """
#include "services/liveness.h"
static liveness_t liveness;
static uint64_t now_us;
static uint32_t fed, stalled, overruns;
static hal_clock_t clock_now;
uint64_t hal_microseconds(hal_t *hal) { (void)hal; return now_us; }
hal_clock_t hal_clock(const hal_t *hal) { (void)hal; return clock_now; }
void hal_counters(const hal_t *hal, hal_counters_t *c) {
    (void)hal;
    *c = (hal_counters_t){.converter_overruns = overruns};
}
void hal_watchdog_kick(hal_t *hal) { (void)hal; fed++; }
void hal_note_stalled(hal_t *hal, uint32_t parts) { (void)hal; stalled = parts; }
void start(unsigned role, unsigned clock) {
    now_us = fed = stalled = overruns = 0;
    clock_now = (hal_clock_t)clock;
    liveness_start(&liveness, NULL, (hal_role_t)role);
}
void moved(unsigned part) { liveness_moved(&liveness, (liveness_part_t)part); }
void overrun(void) { overruns++; }
void step(uint64_t us) { now_us += us; if (liveness_due(&liveness, now_us)) liveness_step(&liveness, now_us); }
unsigned get_fed(void) { return fed; }
unsigned get_stalled(void) { return stalled; }
"""


class Bench:
    """A liveness on a board that does nothing by itself."""

    def __init__(self, library: ctypes.CDLL, role: int, clock: int = CRYSTAL) -> None:
        self._library, self.role = library, role
        library.start(role, clock)

    def turn(self, *still: int, us: int = TURN_US, overrun: bool = False) -> None:
        """Run a turn of main in which all parts moved but some."""
        for part in range(4):
            if part not in still:
                self._library.moved(part)
        if overrun:
            self._library.overrun()
        self._library.step(ctypes.c_uint64(us))

    @property
    def fed(self) -> int:
        return int(self._library.get_fed())

    @property
    def stalled(self) -> int:
        return int(self._library.get_stalled())


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    directory = tmp_path_factory.mktemp("liveness")
    stub, made = directory / "stub.c", directory / "liveness.so"
    stub.write_text(STUB)
    flags = ["-std=c11", "-O1", "-shared", "-fPIC", f"-I{ROOT / 'firmware'}"]
    source = str(ROOT / "firmware/services/liveness.c")
    subprocess.run(["gcc", *flags, str(stub), source, "-o", str(made)], check=True)
    return ctypes.CDLL(str(made))


@pytest.fixture(params=[BEACON, SENSOR, ANCHOR])
def bench(library: ctypes.CDLL, request: pytest.FixtureRequest) -> Iterator[Bench]:
    return Bench(library, request.param)


def test_a_board_that_moves_is_fed_all_the_time(bench: Bench) -> None:
    for _ in range(200):
        bench.turn()
    assert bench.fed == 200 * TURN_US // (PERIOD_US + TURN_US)
    assert bench.stalled == 0


@pytest.mark.parametrize("part", [BLOCKS, CURRENTS, SAMPLES, LINK])
def test_a_part_that_stands_still_starves_the_watchdog_if_the_role_has_it(bench: Bench, part: int) -> None:
    while bench.fed < 2:
        bench.turn()
    before = bench.fed
    for _ in range(PATIENCE_US // TURN_US):
        bench.turn(part)
    needed = part in NEEDED[bench.role]
    assert (bench.fed == before) is needed
    assert bench.stalled == 0  # not yet
    for _ in range(2):
        bench.turn(part)
    assert bench.stalled == (1 << part if needed else 0)
    for _ in range(GOOD_BLOCKS + PERIOD_US // TURN_US):
        bench.turn()
    assert bench.fed > before
    assert bench.stalled == 0


def test_several_parts_are_noted_together(library: ctypes.CDLL) -> None:
    bench = Bench(library, ANCHOR)
    for _ in range(50):
        bench.turn(BLOCKS, CURRENTS)
    assert (bench.fed, bench.stalled) == (0, 1 << BLOCKS | 1 << CURRENTS)


@pytest.mark.parametrize(("period", "fed"), [(2, False), (GOOD_BLOCKS + 1, True)])
def test_samples_count_only_between_overruns(library: ctypes.CDLL, period: int, fed: bool) -> None:
    """A dead converter is started again every other block, and overruns each time."""
    bench = Bench(library, SENSOR)
    for turn in range(300):
        bench.turn(overrun=turn % period == 0)
    assert (bench.fed > 0) is fed
    assert (bench.stalled == 1 << SAMPLES) is not fed


def test_a_clock_that_stands_still_starves_the_watchdog(library: ctypes.CDLL) -> None:
    bench = Bench(library, BEACON)
    for _ in range(100):
        bench.turn(us=0)
    assert bench.fed == 0


def test_without_a_chip_engine_the_link_alone_counts(library: ctypes.CDLL) -> None:
    bench = Bench(library, BEACON, SLOW)
    for _ in range(60):
        bench.turn(BLOCKS, CURRENTS, SAMPLES)
    assert bench.fed == 60 * TURN_US // (PERIOD_US + TURN_US)
    before = bench.fed
    for _ in range(100):
        bench.turn(BLOCKS, CURRENTS, SAMPLES, LINK)
    assert bench.fed <= before + 1
    assert bench.stalled == 1 << LINK
