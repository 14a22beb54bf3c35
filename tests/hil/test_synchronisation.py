"""Chip edges of all beacons, as an observer with a perfect clock sees them on the bridge pins."""

import numpy as np
import pytest

BRIDGE = (29, 30)  # PB13, PB14
CHIP_S = 16422 / 168e6


@pytest.fixture(scope="module")
def edges(recorded):
    """Edge times in seconds by beacon, from one second of a synchronised rig."""
    result = []
    for changes in recorded.pin_changes:
        bridge = changes[np.isin(changes["pin"], BRIDGE)]
        result.append(np.unique(bridge["time_ps"]) * 1e-12)
    return recorded.bench.scenario, result


def test_chip_edges_agree_within_a_microsecond(edges):
    _, times = edges
    master = times[0]
    start, stop = master[0], master[-1]
    number = np.concatenate([[0.0], np.cumsum(np.round(np.diff(master) / CHIP_S))])
    drift = np.polyfit(number, master, 1)  # the master's own chip length
    for beacon in times:
        inside = beacon[(beacon >= start) & (beacon <= stop)]
        phase = inside - np.polyval(drift, np.round((inside - drift[1]) / drift[0]))
        assert len(inside) > 3000
        assert np.abs(phase).max() < 1e-6


def test_edges_have_no_jitter_against_the_own_clock(edges):
    scenario, times = edges
    for beacon, edge in zip(scenario.beacons, times, strict=True):
        tick_s = 1.0 / (168e6 * (1.0 + beacon.clock.crystal_ppm * 1e-6))
        ticks = (edge - edge[0]) / tick_s
        assert np.abs(ticks - np.round(ticks)).max() < 0.01  # whole ticks: 60 ps
