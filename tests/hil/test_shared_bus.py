"""Four sensors on one CAN, each with blocks of 8 codes, which take twice the bus: what comes of each of them."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.link.blocks import BLOCK_CHIPS
from goldfield.link.budget import block_rate_Hz
from goldfield.link.line import FASTEST, Link
from goldfield.link.requests import set_request
from goldfield_protocol.parameters import PARAMETERS, Kind
from hil_sim.bench import SimulatedBench
from tests.bench.rate_shared import ask_for_blocks, listen, nodes_of, shared, shared_scenario

SENSORS, CODES, SECONDS = 4, 8, 1.0


@pytest.fixture
def bench(tmp_path):
    """Host boards: nine emulated ones would take minutes, and it is their common services that are tested."""
    made = SimulatedBench(shared_scenario(SENSORS, tmp_path / "shared.toml"), "host", tmp_path, "can")
    yield made
    made.close()


def test_each_sends_its_part_and_every_cycle(bench):
    seen, busy = shared(bench, SENSORS, CODES, SECONDS)
    site = bench.site
    expected_Hz = block_rate_Hz(FASTEST[Link.CAN], CODES, site.chips, site.chip_period_s, SENSORS)
    assert 0.6 < busy < 0.78  # frames have fewer stuff bits than they could have; beacons come on top
    for found in seen.values():
        assert len(found.blocks) / SECONDS == pytest.approx(expected_Hz, rel=0.03)
        assert len(found.cycles) >= round(SECONDS / site.cycle_s) - 1  # one may be on its way at each end
        assert found.late_ms(bench, "blocks")[1] < 15.0
        assert found.late_ms(bench, "cycles")[1] < 15.0
        assert not found.counters
        steps = np.diff([number for number, _ in found.blocks]) // BLOCK_CHIPS
        assert set(steps) <= {2, 3, 4, 5, 6}  # one of 2.8 goes, and a report of a cycle costs 3.1 blocks
        assert 0 <= found.lost - sum(steps - 1) <= 6 - 1  # those before the first one count, too


def test_what_one_gives_up_the_others_take(bench):
    first, second, *_ = nodes_of(bench, SENSORS)
    codes = list(bench.site.codes)
    for node in (first, second):
        ask_for_blocks(bench, node, codes)
    bench.rig.advance(0.5)
    seen, _ = listen(bench, [first, second], codes, 0.5)
    both = [len(found.blocks) for found in seen.values()]
    assert both == pytest.approx([0.5 * 248.0] * 2, abs=4)
    bench.rig.can_write(*set_request(second, PARAMETERS["blocks"].first, 0, Kind.UNSIGNED))
    bench.rig.advance(0.8)
    seen, _ = listen(bench, [first, second], codes, 0.5)
    alone = [len(found.blocks) for found in seen.values()]
    assert alone == pytest.approx([0.5 * 330.0, 0.0], abs=2)
