"""The simulator's coil and driver against the reference circuit of docs/hardware.md in ngspice.

Where the two differ by more than a bound, docs/hardware.md says so under "Where the plant is kinder".
"""

from __future__ import annotations

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hil_sim import clib
from tests.hil_sim.world import reference_circuit as reference
from tests.hil_sim.world.reference_circuit import CHIP_S, CHIPS, SENSE_V_PER_A, START_S, STORIES, Trace, plant

pytestmark = pytest.mark.skipif(shutil.which("ngspice") is None, reason=reference.SKIP)

BURST_S = 12e-6
"""The sensor's conversions of a chip take so long; they end at the chip's end."""


@pytest.fixture(scope="module")
def lib():
    return clib.load("build/libgf_rig.so", ["world/coil.h", "world/noise.h"])


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Return a function that plays a story by name, once."""

    @cache
    def play(name: str) -> Trace:
        return reference.spice(STORIES[name], tmp_path_factory.mktemp("spice"))

    return play


def window(start_s: float, end_s: float) -> np.ndarray:
    return np.linspace(start_s, end_s, 4001)


def difference(lib, trace: Trace, name: str, times_s: np.ndarray) -> np.ndarray:
    return trace.at("current_A", times_s) - plant(lib, STORIES[name], times_s)


def test_the_current_at_chip_ends_is_the_plants_within_a_thousandth(lib, played):
    trace = played("chips")
    for chip in range(4):
        end = START_S + (chip + 1) * CHIP_S
        apart = difference(lib, trace, "chips", window(end - BURST_S, end - 1e-7))
        assert abs(apart.mean()) < 0.010  # 0.1 % of 10 A
        assert np.abs(apart).max() < 0.015  # with the ripple of the hold


def test_the_sense_tells_the_current(played):
    trace = played("chips")
    times = window(START_S + CHIP_S - BURST_S, START_S + CHIP_S - 1e-7)
    told = (trace.at("sense_V", times).mean() - 1.65) / SENSE_V_PER_A
    assert told == pytest.approx(trace.at("current_A", times).mean(), rel=2e-3)


@pytest.mark.parametrize("name", ["chips", "sag"])
def test_a_reversal_passes_zero_with_the_plant(lib, played, name):
    """Dead time and the 0.1 Ohm of transistors and shunt are the difference, at full and at sagging supply."""
    trace, story = played(name), STORIES[name]
    reversal = START_S + CHIP_S
    times = window(reversal, reversal + 45e-6)
    ours = plant(lib, story, times)
    zero = times[np.argmax(ours <= 0.0)]
    assert trace.first("current_A", 0.0, reversal, rising=False) == pytest.approx(zero, abs=0.5e-6)
    half = times[np.argmax(ours <= -5.0)]
    assert trace.first("current_A", -5.0, reversal, rising=False) == pytest.approx(half, abs=0.5e-6)


def test_the_edges_keep_near_the_plant(lib, played):
    trace = played("chips")
    apart = np.abs(difference(lib, trace, "chips", window(START_S, START_S + 4 * CHIP_S - 1e-7)))
    assert apart.max() < 0.6
    settled = window(START_S + CHIP_S + 40e-6, START_S + 2 * CHIP_S - 1e-7)
    assert np.abs(difference(lib, trace, "chips", settled)).max() < 0.025


def test_no_half_bridge_shoots_through(played):
    """Without dead time the transistors' 200 A are passed and the latch trips.

    What charges the transistors' capacitances shows some 50 A in a shunt for nanoseconds, and a body diode that is
    still conducting when the other transistor comes on shows some 90 A.
    """
    for name in ("chips", "lower", "zero"):
        trace = played(name)
        assert max(trace.shunt_a_V.max(), trace.shunt_b_V.max()) < 1.2  # 120 A
        assert trace.fault_V.min() > 3.0


@pytest.mark.parametrize(("name", "change_s"), [("disabled", 60e-6), ("zero", 60e-6)])
def test_a_bridge_told_off_runs_the_current_down_against_the_supply(lib, played, name, change_s):
    trace = played(name)
    times = window(change_s, change_s + 16e-6)
    assert np.abs(difference(lib, trace, name, times)).max() < 0.4
    after = window(change_s + 30e-6, STORIES[name].until_s)
    assert np.abs(trace.at("current_A", after)).max() < 0.01
    assert trace.fault_V.min() > 3.0


def test_the_fly_back_fills_the_high_supply_by_the_coils_energy(played):
    trace = played("disabled")
    before, after = trace.at("high_supply_V", np.array([59.9e-6, 90e-6]))
    rise = 0.5 * 1.9e-4 * 10.0**2 / (470e-6 * 120.0)
    assert after - before == pytest.approx(rise, rel=0.25)


def test_a_lower_set_point_is_reached_at_full_supply(lib, played):
    trace = played("lower")
    assert np.abs(difference(lib, trace, "lower", window(60e-6, 68e-6))).max() < 0.4
    assert trace.at("current_A", window(90e-6, 100e-6)).mean() == pytest.approx(5.0, abs=0.02)


def test_full_scale_is_held_and_is_no_fault(lib, played):
    trace = played("full scale")
    assert np.abs(difference(lib, trace, "full scale", window(90e-6, 110e-6)).mean()) < 0.016
    assert trace.fault_V.min() > 3.0


def test_a_runaway_set_point_trips_at_eighteen_amperes_and_stays_off(played):
    trace = played("runaway")
    tripped = trace.first("fault_V", 1.65, 5e-6, rising=False)
    reached = trace.first("current_A", 18.0, 5e-6, rising=True)
    assert 0.0 < tripped - reached < 1.5e-6
    assert trace.current_A.max() < 19.0
    assert np.abs(trace.at("current_A", window(107e-6, 110e-6))).max() < 0.1
    assert trace.at("fault_V", window(80e-6, 110e-6)).max() < 0.1


def test_the_enable_clears_the_trip(played):
    trace = played("cleared")
    assert trace.at("fault_V", window(50e-6, 59e-6)).max() < 0.1
    assert trace.at("fault_V", window(80e-6, 110e-6)).min() > 3.0
    assert trace.at("current_A", window(100e-6, 110e-6)).mean() == pytest.approx(10.0, abs=0.02)


def test_a_shorted_coil_trips_below_the_transistors_limit(played):
    trace = played("shorted")
    tripped = trace.first("fault_V", 1.65, START_S, rising=False)
    assert tripped - START_S < 2e-6
    assert np.abs(trace.current_A).max() < 0.5 * 200.0  # IRFP260N: 200 A pulsed
    assert np.abs(trace.at("current_A", window(tripped + 4e-6, 30e-6))).max() < 0.1


def test_an_open_coil_takes_no_current_and_is_no_fault_to_the_driver(lib, played):
    trace = played("open")
    assert np.abs(trace.current_A).max() < 0.01
    assert trace.at("sense_V", window(30e-6, 60e-6)) == pytest.approx(1.65, abs=0.01)
    assert trace.fault_V.min() > 3.0


def test_a_gap_in_the_netlist_is_told(tmp_path):
    with pytest.raises(RuntimeError, match="ngspice gave up"):
        reference.spice(reference.Story(CHIPS.inputs, 1e-6, inductance_H=float("nan")), Path(tmp_path))
