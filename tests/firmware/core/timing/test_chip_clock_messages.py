"""The chip clock following messages that the master's clock dates, on one time line: the follower's own ticks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.firmware.core.timing.test_chip_clock import BLOCK, CYCLE_BLOCKS, MICROSECOND, NOMINAL, N, Simulation


class Follower(Simulation):
    """Messages are times of the follower's clock with the master's ticks since its cycle began at that moment.

    They are marked in the block in which they fall and taken some blocks later.
    """

    def __init__(self, core, **options):
        super().__init__(core, **options)
        self.lib.chip_clock_forget(self.clock, self.ffi.addressof(self.lib, "chip_clock_link"))
        self.waiting = []  # Block, mark, master's ticks.

    def serve(self, blocks, messages):
        """Run blocks; messages: sorted (time, master_ticks, blocks to the follow-up). Returns how many counted."""
        taken = 0
        messages = [m for m in messages if m[0] >= self.starts[self.block * BLOCK]]
        for _ in range(blocks):
            end = self.starts[(self.block + 1) * BLOCK]
            while messages and messages[0][0] < end:
                time, ticks, late = messages.pop(0)
                self.waiting.append((self.block + late, self.mark(time), ticks))
            self.block += 1
            for _, mark, ticks in [w for w in self.waiting if w[0] < self.block]:
                taken += self.lib.chip_clock_message(self.clock, mark, ticks)
            self.waiting = [w for w in self.waiting if w[0] >= self.block]
            self.plan()
        return taken

    def mark(self, time):
        tick = int(np.floor(time))
        chip = int(np.searchsorted(self.starts, tick, side="right")) - 1
        mark = self.ffi.new("chip_clock_mark_t *")
        assert self.lib.chip_clock_mark(self.clock, (self.first + chip) % 2**32, tick - self.starts[chip], mark)
        return mark


def messages_of(start, relative_ppm, cycles, *, seed, jitter=0.0, span=0.1, late=3, lost=0.0):
    """A SYNC in each cycle, anywhere in its first part (span); jitter in ticks, uniform, either way."""
    random = np.random.default_rng(seed)
    rate = 1 + relative_ppm * 1e-6
    result = []
    for cycle in range(cycles):
        since = random.uniform(0, span * N * NOMINAL)  # Master's ticks.
        time = start + (cycle * N * NOMINAL + since) * rate + random.uniform(-jitter, jitter)
        if random.uniform() >= lost:
            result.append((time, int(since), int(random.integers(late))))
    return result, NOMINAL * rate


@settings(max_examples=12)
@given(phase=st.floats(0, 1, exclude_max=True), ppm=st.floats(-200, 200), seed=st.integers(0, 2**32 - 1))
def test_locks_whenever_sync_and_follow_up_come(core, phase, ppm, seed):
    start = phase * N * NOMINAL
    messages, period = messages_of(start, ppm, 20, seed=seed, jitter=20)
    simulation = Follower(core)
    simulation.serve(8 * CYCLE_BLOCKS, messages)
    assert simulation.clock.locked
    locked_from = len(simulation.planned)
    assert simulation.serve(10 * CYCLE_BLOCKS, messages) >= 9
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == 0
    assert abs(simulation.phase_errors(start, period, locked_from)).max() < 0.3 * MICROSECOND


@settings(max_examples=3)
@given(seed=st.integers(0, 2**32 - 1))
def test_jitter_is_averaged_and_the_oscillator_followed(core, seed):
    """Uniform jitter of +-35 ticks (20 rms), a random walk of the rate of 0.02 ppm a cycle: the figures in sync.h."""
    random = np.random.default_rng(seed)
    cycles = 150
    rate = 50e-6 + np.cumsum(random.normal(0, 0.02e-6, cycles))
    begins = 4e6 + np.concatenate([[0], np.cumsum(N * NOMINAL * (1 + rate))])
    messages = []
    for cycle in range(cycles):
        since = random.uniform(0, 0.05 * N * NOMINAL)
        time = begins[cycle] + since * (1 + rate[cycle]) + random.uniform(-35, 35)
        messages.append((time, int(since), 1))
    simulation = Follower(core)
    simulation.serve((cycles - 2) * CYCLE_BLOCKS, messages)
    assert simulation.clock.locked
    own = [start for start, (_, chip, _) in zip(simulation.starts, simulation.planned, strict=False) if chip == 0]
    errors = [min(begins - t, key=abs) for t in own if begins[30] < t < begins[-3]]
    assert len(errors) > 100
    assert np.sqrt(np.mean(np.square(errors))) < 15  # Alpha 0.23 of the variance makes 9.6; the walk adds to it.


@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_sync_may_be_late_by_nearly_a_cycle(core, ppm):
    messages, period = messages_of(3e6, ppm, 20, seed=7, span=0.9)
    simulation = Follower(core)
    simulation.serve(18 * CYCLE_BLOCKS, messages)
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == 0
    assert abs(simulation.phase_errors(3e6, period, 8 * N)).max() < 0.1 * MICROSECOND


def test_lost_messages_cost_nothing(core):
    messages, period = messages_of(3e6, -130, 60, seed=1, jitter=10, lost=0.4)
    simulation = Follower(core)
    simulation.serve(58 * CYCLE_BLOCKS, messages)
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == 0
    assert abs(simulation.phase_errors(3e6, period, 20 * N)).max() < 0.2 * MICROSECOND


def test_a_second_master_is_rejected_and_a_new_one_followed_when_the_first_is_gone(core):
    first, period = messages_of(2e6, 40, 20, seed=2)
    second, other = messages_of(2e6 + 700.25 * NOMINAL, -60, 40, seed=3)
    simulation = Follower(core)
    simulation.serve(18 * CYCLE_BLOCKS, sorted(first + second))
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected >= 10
    assert abs(simulation.phase_errors(2e6, period, 8 * N)).max() < 0.2 * MICROSECOND
    simulation.serve(12 * CYCLE_BLOCKS, [m for m in second if m[0] > first[-1][0]])
    assert simulation.clock.locked
    assert abs(simulation.phase_errors(2e6 + 700.25 * NOMINAL, other, 27 * N)).max() < 0.2 * MICROSECOND


def test_a_stamp_that_is_late_by_an_interrupt_is_rejected(core):
    messages, period = messages_of(3e6, 10, 30, seed=4)
    late = [
        (time + 20 * MICROSECOND * (i in (10, 15, 16)), ticks, blocks)
        for i, (time, ticks, blocks) in enumerate(messages)
    ]
    simulation = Follower(core)
    simulation.serve(28 * CYCLE_BLOCKS, late)
    assert simulation.clock.edges_rejected == 3
    assert simulation.clock.locked
    assert abs(simulation.phase_errors(3e6, period, 8 * N)).max() < 0.2 * MICROSECOND


def test_phase_is_that_of_the_chips_executed(core):
    messages, _ = messages_of(3e6, 90, 20, seed=5)
    simulation = Follower(core)
    simulation.serve(15 * CYCLE_BLOCKS, messages)
    before = simulation.clock.phase_ticks
    assert abs(before) <= 2  # No jitter but rounding.
    simulation.serve(2 * CYCLE_BLOCKS, [(time + 50, ticks, late) for time, ticks, late in messages])
    assert simulation.clock.phase_ticks == pytest.approx(50 * (1 - 62 / 272), abs=4)


def test_messages_from_before_the_cycle_and_of_the_far_past(core):
    """SYNC may be through before its cycle begins, and a time beyond 0.4 s is nonsense."""
    period = NOMINAL * (1 - 30e-6)
    messages = [(3e6 + cycle * N * period - 40_000 * (1 - 30e-6), -40_000, 1) for cycle in range(20)]
    simulation = Follower(core)
    simulation.serve(18 * CYCLE_BLOCKS, messages)
    assert simulation.clock.locked
    assert abs(simulation.phase_errors(3e6, period, 8 * N)).max() < 0.2 * MICROSECOND
    mark = simulation.mark(simulation.now())
    for ticks in (2**26 + 1, -(2**26) - 1, 2**31 - 1, -(2**31)):
        assert not simulation.lib.chip_clock_message(simulation.clock, mark, ticks)
    assert simulation.clock.edges_rejected == 4
    assert simulation.clock.locked


def test_an_edge_that_is_still_to_come_is_not_long_ago(core):
    """Each message tells of a cycle that begins 65 ms later, and from the ninth on a stranger of another one, too."""
    ahead, span = 11_000_000, N * NOMINAL
    own = [(3e6 + cycle * span - ahead, -ahead, 1) for cycle in range(1, 16)]
    others = [(3e6 + (cycle + 0.25) * span, 0, 1) for cycle in range(8, 16)]
    messages = sorted(own + others)
    simulation = Follower(core)
    to_come = 0
    for _ in range(14 * CYCLE_BLOCKS):
        simulation.serve(1, messages)
        clock = simulation.clock
        if clock.locked:
            to_come += clock.edge_cycle == (clock.cycle + 1) % 2**32
            assert simulation.lib.chip_clock_quality(clock, 168).age_us < 250_000
            assert not simulation.lib.chip_clock_contested(clock)
    assert to_come > 100
    assert simulation.clock.edges_rejected >= 5


def test_a_mark_in_a_forgotten_chip_is_refused(core):
    simulation = Follower(core)
    simulation.serve(6, [])
    mark = simulation.ffi.new("chip_clock_mark_t *")
    for chip, ticks in (
        (simulation.clock.chip, 0),
        (simulation.clock.chip - 129, 0),
        (simulation.clock.chip - 5, 33801),
    ):
        assert not simulation.lib.chip_clock_mark(simulation.clock, chip % 2**32, ticks, mark)
    assert simulation.lib.chip_clock_mark(simulation.clock, simulation.clock.chip - 128, 33800, mark)


def test_a_master_takes_no_messages(core):
    simulation = Follower(core, follow=False)
    simulation.serve(3, [])
    assert not simulation.lib.chip_clock_message(simulation.clock, simulation.mark(simulation.now()), 5)
    assert simulation.clock.edges_rejected == 0
