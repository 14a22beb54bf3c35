"""A crystal that drifts while a host board runs: edges of the sync wire go on without a step, at the new rate."""

import numpy as np
import pytest

from goldfield.errors import UserError
from hil_sim.rig import Rig
from hil_sim.scenario import load_scenario
from tests.hil_sim.rig.fakes import FakeBoards, small

TICK_S = 1.0 / 168e6
CYCLE_TICKS = 1023 * 16422


@pytest.fixture
def rig():
    with Rig(load_scenario("patent3"), "host") as rig:
        rig.advance(1.0)
        yield rig


def periods_s(rig, since_s):
    edges_s = rig.sync_edges_s()
    return np.diff(edges_s[edges_s > since_s])


@pytest.mark.parametrize("by_ppm", [40.0, -40.0])
def test_edges_go_on_without_a_step_at_the_new_rate(rig, by_ppm):
    master = rig.scenario.sync_master
    before_ppm = rig.scenario.beacons[master - 1].clock.crystal_ppm
    rig.drift(master, by_ppm)
    changed_s = rig.now_s
    rig.advance(1.0)
    whole, *after = periods_s(rig, changed_s - 0.1)
    assert after == pytest.approx([CYCLE_TICKS * TICK_S / (1.0 + 1e-6 * (before_ppm + by_ppm))] * len(after), abs=3e-12)
    earlier = periods_s(rig, 0.0)[0]
    assert min(earlier, after[0]) - 3e-12 <= whole <= max(earlier, after[0]) + 3e-12


def test_many_small_drifts_are_one_large_one(rig):
    """A change moves the clock by less than the hundredth part of a tick: the ticks under way keep their begin."""
    master = rig.scenario.sync_master
    for _ in range(100):
        rig.drift(master, 0.3)
        rig.drift(master, -0.3)
        rig.advance(0.005)
    edges_s = rig.sync_edges_s()
    period_s = np.diff(edges_s)[0]
    late_s = edges_s - edges_s[0] - period_s * np.arange(len(edges_s))
    assert np.abs(late_s).max() < 0.01 * TICK_S + 3e-12 * len(edges_s)


def test_a_board_that_is_switched_on_again_keeps_its_drift(rig):
    master = rig.scenario.sync_master
    before_ppm = rig.scenario.beacons[master - 1].clock.crystal_ppm
    rig.drift(master, 40.0)
    rig.power_cycle(master, 0.01)
    rig.advance(2.0)
    period_s = periods_s(rig, 2.5)[0]
    assert period_s == pytest.approx(CYCLE_TICKS * TICK_S / (1.0 + 1e-6 * (before_ppm + 40.0)), abs=3e-12)


def test_what_cannot_drift_is_refused(rig, tmp_path):
    with pytest.raises(UserError, match=r"the crystal of beacon \w+ cannot be off by \d+ ppm"):
        rig.drift(1, 1e6)
    with Rig(small(tmp_path), FakeBoards()) as other, pytest.raises(UserError, match="is no host board"):
        other.drift(1, 1.0)
