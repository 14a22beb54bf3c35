"""What ``make hold-over-figures`` measures, for two seeds and until the lock ends."""

import pytest

from hil_sim.clib import load
from tests.bench.hold_over_figures import RATES, held
from tests.firmware.core.timing.test_clock_error import CYCLE_S


@pytest.mark.parametrize("course", ["goes on", "ends then"])
@pytest.mark.parametrize("ppm_per_s", RATES.values())
def test_the_lock_ends_before_a_learnt_drift_can_move_an_edge_by_half_a_microsecond(ppm_per_s, course):
    core = load("libgf_core.so", ("core/timing/chip_clock.h",))
    for seed in range(2):
        errors, locked_s = held(core, seed, ppm_per_s, course, 40)
        assert locked_s == pytest.approx((2.0 * 0.5 / ppm_per_s) ** 0.5, abs=2 * CYCLE_S)
        assert errors[: round(locked_s / CYCLE_S), 0].max() < 0.5
        assert (errors[:, 0] < errors[:, 1]).all()


@pytest.mark.parametrize("ppm_per_s", RATES.values())
def test_a_drift_that_begins_when_the_wire_is_lost_is_seen_by_nobody(ppm_per_s):
    core = load("libgf_core.so", ("core/timing/chip_clock.h",))
    errors, locked_s = held(core, 0, ppm_per_s, "begins then", 105)
    assert locked_s == pytest.approx(100 * CYCLE_S, abs=2 * CYCLE_S)
    assert errors[99, 0] == pytest.approx(0.5 * ppm_per_s * locked_s**2, rel=0.1)
