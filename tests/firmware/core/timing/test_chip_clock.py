"""The chip clock against a simulated master, on one time line: the follower's own ticks."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

N, NOMINAL, MINIMUM, MAXIMUM, BLOCK = 1023, 16422, 16000, 16900, 31
MICROSECOND = 168


class Simulation:
    """A board that executes one block while two are planned ahead, as hal.h describes.

    Edges are times in the follower's ticks, captured in whole ticks and delivered within the block in which they fall.
    """

    def __init__(self, core, follow=True, chips=N):
        self.ffi, self.lib = core
        self.clock = self.ffi.new("chip_clock_t *")
        config = self.ffi.new("chip_clock_config_t *", [chips, NOMINAL, MINIMUM, MAXIMUM, follow])
        assert self.lib.chip_clock_init(self.clock, config)
        self.first = self.clock.chip
        self.starts = [0]  # Start of each absolute chip and the end of the last, ticks.
        self.planned = []
        self.block = 0
        for _ in range(2):
            self.plan()

    def plan(self):
        for _ in range(BLOCK):
            chip = self.lib.chip_clock_plan(self.clock)
            self.planned.append((chip.cycle, chip.code_chip, chip.period_ticks))
            self.starts.append(self.starts[-1] + chip.period_ticks)

    def run(self, blocks, edges):
        """Run blocks; edges: sorted times. Those before the present are ignored."""
        edges = [edge for edge in edges if edge >= self.starts[self.block * BLOCK]]
        position = 0
        for _ in range(blocks):
            end = self.starts[(self.block + 1) * BLOCK]
            while position < len(edges) and edges[position] < end:
                self.edge(edges[position])
                position += 1
            self.block += 1
            self.plan()

    def edge(self, time):
        tick = int(np.floor(time))
        chip = int(np.searchsorted(self.starts, tick, side="right")) - 1
        self.lib.chip_clock_edge(self.clock, (self.first + chip) % 2**32, tick - self.starts[chip])

    def now(self):
        return self.starts[self.block * BLOCK]

    def phase_errors(self, master_start, master_period, from_chip):
        """Ticks by which each chip begins later than the master's; a wrong label shows as whole chips."""
        starts = np.array(self.starts[from_chip:-1], dtype=float)
        labels = np.array([code_chip for _, code_chip, _ in self.planned[from_chip:]])
        difference = starts - (master_start + labels * master_period)
        cycle = N * master_period
        return difference - cycle * np.round(difference / cycle)


def edges_of(start, relative_ppm, cycles):
    period = NOMINAL * (1 + relative_ppm * 1e-6)
    return [start + cycle * N * period for cycle in range(cycles)], period


CYCLE_BLOCKS = N // BLOCK


@settings(max_examples=60)
@example(phase=0.5 / N, ppm=200.0)
@example(phase=0.5, ppm=-200.0)
@example(phase=0.999999, ppm=200.0)
@given(phase=st.floats(0, 1, exclude_max=True), ppm=st.floats(-200, 200))
def test_locks_within_five_cycles_and_stays_within_200_ns(core, phase, ppm):
    edges, period = edges_of(phase * N * NOMINAL, ppm, 12)
    simulation = Simulation(core)
    simulation.run(6 * CYCLE_BLOCKS, edges[:5])  # The fifth edge lies 4 to 5 cycles after the start.
    assert simulation.clock.locked
    locked_from = len(simulation.planned)
    simulation.run(5 * CYCLE_BLOCKS, edges[5:])
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == 0
    errors = simulation.phase_errors(edges[0], period, locked_from)
    assert abs(errors).max() < 0.2 * MICROSECOND
    assert abs(simulation.clock.phase_ticks) < 0.2 * MICROSECOND
    assert all(MINIMUM <= ticks <= MAXIMUM for _, _, ticks in simulation.planned)
    cycles = [cycle for cycle, code_chip, _ in simulation.planned[locked_from:] if code_chip == 0]
    assert cycles == list(range(cycles[0], cycles[0] + len(cycles)))


def test_not_locked_before_the_fifth_edge(core):
    edges, _ = edges_of(1000.0, 37, 8)
    simulation = Simulation(core)
    for count in range(5):
        assert not simulation.clock.locked, count
        simulation.run(CYCLE_BLOCKS, edges[count : count + 1])
    assert simulation.clock.locked


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32 - 1), ppm=st.floats(-200, 200))
def test_outliers_are_rejected_and_counted(core, seed, ppm):
    rng = np.random.default_rng(seed)
    edges, period = edges_of(5e6, ppm, 20)
    # Glitches anywhere but within the gate of a good edge; one in each of 10 cycles after lock.
    glitches = [edge + rng.uniform(500, N * NOMINAL - 20_000) for edge in edges[6:16]]
    simulation = Simulation(core)
    simulation.run(19 * CYCLE_BLOCKS, sorted(edges + glitches))
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == len(glitches)
    assert abs(simulation.phase_errors(edges[0], period, 7 * N)).max() < 0.2 * MICROSECOND


@pytest.mark.parametrize("ppm", [-40.0, 0.0, 15.0])
def test_all_edges_of_a_second_master_are_rejected_and_counted(core, ppm):
    """Which of the two is followed, their first edges decide: it stays so, and the count shows the other one."""
    edges, period = edges_of(5e6, 0.0, 40)
    others, other_period = edges_of(5e6 + 0.3 * N * NOMINAL, ppm, 40)
    simulation = Simulation(core)
    simulation.run(12 * CYCLE_BLOCKS, sorted(edges + others))
    assert simulation.clock.locked
    rejected, from_chip = simulation.clock.edges_rejected, len(simulation.planned)
    simulation.run(20 * CYCLE_BLOCKS, sorted(edges + others))
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected - rejected in (19, 20, 21)
    errors = [simulation.phase_errors(e[0], p, from_chip) for e, p in ((edges, period), (others, other_period))]
    assert min(abs(error).max() for error in errors) < 0.2 * MICROSECOND


def test_a_bouncing_wire_locks_from_the_start(core):
    edges, period = edges_of(3e6, -80, 12)
    bounced = sorted(edges + [edge + 5 * MICROSECOND for edge in edges])
    simulation = Simulation(core)
    simulation.run(11 * CYCLE_BLOCKS, bounced)
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == sum(edge < simulation.now() for edge in bounced) // 2
    assert abs(simulation.phase_errors(edges[0], period, 6 * N)).max() < 0.2 * MICROSECOND


def test_a_glitch_before_the_first_edge_costs_cycles_not_the_lock(core):
    edges, period = edges_of(9e6, 120, 14)
    simulation = Simulation(core)
    simulation.run(13 * CYCLE_BLOCKS, [1e6, *edges])
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected >= 1
    assert abs(simulation.phase_errors(edges[0], period, 8 * N)).max() < 0.2 * MICROSECOND


@pytest.mark.parametrize("ppm", [-200.0, 200.0, 3.3])
def test_missing_edges_cost_nothing(core, ppm):
    edges, period = edges_of(2e6, ppm, 40)
    kept = [edge for cycle, edge in enumerate(edges) if cycle < 6 or cycle % 7 == 0]
    simulation = Simulation(core)
    simulation.run(38 * CYCLE_BLOCKS, kept)
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == 0
    assert abs(simulation.phase_errors(edges[0], period, 6 * N)).max() < 0.2 * MICROSECOND


def test_hold_over_keeps_the_frequency_and_ends_after_100_cycles(core):
    edges, period = edges_of(2e6, 150, 300)
    simulation = Simulation(core)
    simulation.run(20 * CYCLE_BLOCKS, edges[:19])
    simulation.run(90 * CYCLE_BLOCKS, [])
    assert simulation.clock.locked
    assert abs(simulation.phase_errors(edges[0], period, 100 * N)).max() < 0.5 * MICROSECOND
    simulation.run(15 * CYCLE_BLOCKS, [])
    assert not simulation.clock.locked
    simulation.run(4 * CYCLE_BLOCKS, edges)  # The wire is back: three good edges lock again.
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == 0


def test_a_master_that_restarted_contests_the_hold_over(core):
    """From its first edge on, which the clock counts as rejected, until the clock has given up its lock."""
    _, lib = core
    edges, _ = edges_of(2e6, 20, 12)
    moved, _ = edges_of(edges[-1] + 20.4 * N * NOMINAL, 60, 4)
    simulation = Simulation(core)
    simulation.run(12 * CYCLE_BLOCKS, edges)
    first_edge, seen = moved[0], 0
    while simulation.clock.locked:
        before = simulation.now()
        simulation.run(1, moved)
        if simulation.clock.locked:
            contested = lib.chip_clock_contested(simulation.clock)
            assert contested == (simulation.now() > first_edge), (before - first_edge) / (N * NOMINAL)
            seen += contested
    assert 2 * CYCLE_BLOCKS - 1 <= seen <= 2 * CYCLE_BLOCKS + 1
    assert simulation.clock.edges_rejected == 3
    assert not lib.chip_clock_contested(simulation.clock)


def test_a_glitch_contests_hold_over_for_a_cycle_and_nothing_else(core):
    _, lib = core
    edges, _ = edges_of(2e6, 20, 40)
    simulation = Simulation(core)
    simulation.run(12 * CYCLE_BLOCKS, sorted([*edges[:12], edges[8] + 3e6, edges[10] + 9e6]))
    assert simulation.clock.edges_rejected == 2
    assert not lib.chip_clock_contested(simulation.clock)
    glitch, contested = edges[14] + 5e6, []
    for _ in range(6 * CYCLE_BLOCKS):
        simulation.run(1, [glitch])
        if lib.chip_clock_contested(simulation.clock):
            contested.append(simulation.block)
    assert CYCLE_BLOCKS - 2 <= len(contested) <= CYCLE_BLOCKS + 1
    assert contested == list(range(contested[0], contested[0] + len(contested)))
    assert simulation.starts[(contested[0] - 1) * BLOCK] <= glitch < simulation.starts[contested[0] * BLOCK]
    assert simulation.clock.locked


def test_edges_of_a_second_master_contest_nothing_while_the_own_come(core):
    _, lib = core
    edges, _ = edges_of(5e6, 0.0, 24)
    others, _ = edges_of(5e6 + 0.3 * N * NOMINAL, 15.0, 24)
    simulation = Simulation(core)
    simulation.run(8 * CYCLE_BLOCKS, edges)
    for _ in range(12 * CYCLE_BLOCKS):
        simulation.run(1, sorted(edges + others))
        assert not lib.chip_clock_contested(simulation.clock)
    assert simulation.clock.edges_rejected > 10


def test_follows_a_master_that_restarted(core):
    edges, _ = edges_of(2e6, 20, 8)
    moved, period = edges_of(edges[-1] + 7_654_321.0, 90, 16)
    simulation = Simulation(core)
    simulation.run(18 * CYCLE_BLOCKS, edges + moved)
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == 3
    assert abs(simulation.phase_errors(moved[0], period, 14 * N)).max() < 0.2 * MICROSECOND


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_capture_jitter_and_a_wandering_oscillator(core, seed):
    rng = np.random.default_rng(seed)
    rate = 50e-6 + np.cumsum(rng.normal(0, 0.02e-6, 40))  # 0.02 ppm random walk a cycle.
    true = 4e6 + np.concatenate([[0], np.cumsum(N * NOMINAL * (1 + rate))])
    captured = true + rng.uniform(-1, 1, len(true))  # One tick either way.
    simulation = Simulation(core)
    simulation.run(39 * CYCLE_BLOCKS, captured.tolist())
    assert simulation.clock.locked
    begins = [start for start, (_, chip, _) in zip(simulation.starts, simulation.planned, strict=False) if chip == 0]
    for begin in [b for b in begins if true[8] < b < true[-1]]:
        assert min(abs(begin - t) for t in true) < 0.2 * MICROSECOND


def test_counters_that_wrap_change_nothing(core):
    edges, period = edges_of(1e6, -130, 12)
    simulation = Simulation(core)
    clock = simulation.clock
    # A fresh clock shortly before every counter wraps: chips after 4.8 days, ticks after 25 s.
    simulation.first = clock.chip = 2**32 - 3000
    clock.position = 2**32 - 20_000_000
    clock.target = clock.position << 32
    clock.code_chip = clock.cycle = 0
    simulation.starts, simulation.planned = [0], []
    simulation.plan()
    simulation.plan()
    simulation.run(11 * CYCLE_BLOCKS, edges)
    assert clock.locked
    assert clock.chip < 2**31
    assert abs(simulation.phase_errors(edges[0], period, 6 * N)).max() < 0.2 * MICROSECOND


def test_a_master_runs_free_and_ignores_edges(core):
    simulation = Simulation(core, follow=False)
    simulation.run(3 * CYCLE_BLOCKS, [1e5, 2e6, 2e7])
    assert simulation.clock.locked
    assert simulation.clock.edges_rejected == 0
    assert {ticks for _, _, ticks in simulation.planned} == {NOMINAL}
    assert [chip for _, chip, _ in simulation.planned] == [i % N for i in range(len(simulation.planned))]
    assert [cycle for cycle, _, _ in simulation.planned] == [i // N for i in range(len(simulation.planned))]


def test_mean_period_is_exact(core):
    edges, period = edges_of(2e6, 61.0, 60)
    simulation = Simulation(core)
    simulation.run(58 * CYCLE_BLOCKS, edges)
    lengths = Counter(ticks for _, _, ticks in simulation.planned[30 * N :])
    assert set(lengths) <= {NOMINAL, NOMINAL + 1, NOMINAL + 2}  # 16423.0017, corrections of a tick.
    total = sum(ticks * count for ticks, count in lengths.items())
    assert total / sum(lengths.values()) == pytest.approx(period, rel=1e-7)


def test_past_plans_are_remembered_for_128_chips(core):
    ffi, lib = core
    simulation = Simulation(core)
    simulation.run(3 * CYCLE_BLOCKS, [])
    planned = ffi.new("chip_clock_chip_t *")
    head = simulation.clock.chip
    for chip in range(head - 128, head):
        assert lib.chip_clock_at(simulation.clock, chip, planned)
        assert (planned.cycle, planned.code_chip, planned.period_ticks) == simulation.planned[chip]
    before = (planned.cycle, planned.code_chip, planned.period_ticks)
    for chip in (head - 129, head, head + 1, head + 2**31):
        assert not lib.chip_clock_at(simulation.clock, chip, planned)
    assert (planned.cycle, planned.code_chip, planned.period_ticks) == before


def test_sync_message_numbers_the_cycles(core):
    ffi, lib = core
    edges, _ = edges_of(2e6, 10, 10)
    simulation = Simulation(core)
    simulation.run(6 * CYCLE_BLOCKS, edges[:6])
    lib.chip_clock_number_cycle(simulation.clock, 777)  # Edge 5 began cycle 777.
    simulation.run(2 * CYCLE_BLOCKS, edges[6:])
    index = max(i for i in range(len(simulation.planned) - BLOCK * 3) if simulation.planned[i][1] == 0)
    edge = round((simulation.starts[index] - edges[0]) / (edges[1] - edges[0]))
    assert simulation.planned[index][0] == 777 + edge - 5
    planned = ffi.new("chip_clock_chip_t *")
    assert lib.chip_clock_at(simulation.clock, simulation.clock.chip - 1, planned)
    assert planned.cycle == simulation.planned[-1][0]


def test_edges_of_unknown_chips_are_rejected(core):
    _, lib = core
    simulation = Simulation(core)
    for chip in (simulation.clock.chip, simulation.clock.chip + 5, simulation.clock.chip - 129):
        lib.chip_clock_edge(simulation.clock, chip % 2**32, 0)
    lib.chip_clock_edge(simulation.clock, 3, 16901)
    assert simulation.clock.edges_rejected == 4


@pytest.mark.parametrize(
    "config",
    [
        (30, 16422, 16000, 16900),
        (2048, 16422, 16000, 16900),
        (1023, 16422, 16300, 16900),
        (1023, 16422, 16000, 16500),
        (31, 0, 0, 0),
    ],
)
def test_impossible_configurations_are_refused(core, config):
    ffi, lib = core
    clock = ffi.new("chip_clock_t *")
    assert not lib.chip_clock_init(clock, ffi.new("chip_clock_config_t *", [*config, True]))


@pytest.mark.parametrize("chips", [31, 63, 127, 511, 2047])
def test_other_lengths_of_code_lock_too(core, chips):
    period = NOMINAL * (1 - 70e-6)
    edges = [1.3e6 + cycle * chips * period for cycle in range(12)]
    simulation = Simulation(core, chips=chips)
    simulation.run(10 * chips // BLOCK, edges)
    assert simulation.clock.locked
    assert abs(simulation.clock.phase_ticks) < 0.2 * MICROSECOND


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_random_edges_never_lead_to_lengths_out_of_bounds(core, seed):
    rng = np.random.default_rng(seed)
    simulation = Simulation(core)
    simulation.run(4 * CYCLE_BLOCKS, sorted(rng.uniform(0, 4 * N * NOMINAL, 400).tolist()))
    assert all(MINIMUM <= ticks <= MAXIMUM for _, _, ticks in simulation.planned)
    assert abs(simulation.clock.period / 2**32 / NOMINAL - 1) < 301e-6


@settings(max_examples=20)
@given(phase=st.floats(0, 1))
def test_slews_at_most_half_a_chip(core, phase):
    edges, _ = edges_of((100 + phase) * NOMINAL, 0, 4)
    simulation = Simulation(core)
    simulation.run(3 * CYCLE_BLOCKS, edges)
    # Half a chip in steps of 422 or 478 ticks is at most 20 chips, and one more with the rest.
    assert sum(ticks in (MINIMUM, MAXIMUM) for _, _, ticks in simulation.planned) <= 20


def drifting_edges(start, cycles, ppm, ppm_per_s, until=None):
    """Edges of a master whose rate drifts against the follower's, for good or until a cycle, in ticks of the latter."""
    index = np.arange(cycles)
    drifted = index if until is None else np.minimum(index, until)
    rate = 1e-6 * (ppm + 0.1 * ppm_per_s * drifted)
    return start + np.concatenate([[0.0], np.cumsum(N * NOMINAL * (1.0 + rate))])


HEARD = 60


def lock_lost_and_error(core, true, cycles, seed):
    """Return when the lock ended, cycles after the last edge heard, and the phase error at each later cycle, ticks."""
    rng = np.random.default_rng(seed)
    simulation = Simulation(core)
    heard = true[:HEARD] + rng.uniform(-0.5, 0.5, HEARD)
    simulation.run((HEARD + 1) * CYCLE_BLOCKS, heard.tolist())
    assert simulation.clock.locked
    lost = None
    for _ in range(cycles):
        simulation.run(CYCLE_BLOCKS, [])
        if lost is None and not simulation.clock.locked:
            lost = (simulation.now() - true[HEARD - 1]) / (N * NOMINAL)
    begins = np.array([s for s, (_, c, _) in zip(simulation.starts, simulation.planned, strict=False) if c == 0])
    near = np.abs(begins[:, None] - true[None, HEARD:]).argmin(axis=0)
    return lost, (begins[near] - true[HEARD:])[: cycles - 2]


@pytest.mark.parametrize("ends", [False, True])
@pytest.mark.parametrize("ppm_per_s", [0.2, -0.1])
def test_the_lock_ends_before_a_learnt_drift_can_move_the_phase_by_half_a_microsecond(core, ppm_per_s, ends):
    """Whether the drift goes on or ends with the last edge; the limit is that of the worse of the two."""
    true = drifting_edges(2e6, 140, 20.0, ppm_per_s, until=HEARD if ends else None)
    lost, error = lock_lost_and_error(core, true, 50, 3)
    allowed = 10.0 * np.sqrt(2.0 * 0.5 / abs(ppm_per_s))  # d t^2 / 2 = .5 us, in cycles
    assert 0.7 * allowed < lost < 1.4 * allowed
    assert abs(error[: int(lost)]).max() < 0.75 * MICROSECOND


@pytest.mark.parametrize("ppm_per_s", [0.2, -0.1])
def test_a_drift_that_goes_on_is_held_for_ten_seconds(core, ppm_per_s):
    true = drifting_edges(2e6, 180, -30.0, ppm_per_s)
    _, error = lock_lost_and_error(core, true, 100, 7)
    undone = 0.5 * abs(ppm_per_s) * 10.0**2 * MICROSECOND  # what the drift would move without
    assert abs(error).max() < 0.25 * undone
