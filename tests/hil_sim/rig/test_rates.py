"""A rig whose bus has another bit rate than its boards, for a while."""

from __future__ import annotations

import pytest

from goldfield.errors import UserError
from hil_sim import scenario
from hil_sim.rig import Rig
from tests.hil_sim.rig.fakes import write_scenario


@pytest.fixture
def bench(tmp_path):
    path = write_scenario(tmp_path)
    path.write_text(path.read_text() + "[links]\ncan_bit_s = 250000\nserial_baud = 460800\n")
    return scenario.load(path)


def senders(rig: Rig, seconds: float) -> set[int]:
    """The boards of which a frame was on the bus in a time."""
    rig.can_read()
    rig.advance(seconds)
    return {frame.board for frame in rig.can_read()}


@pytest.mark.parametrize("boards", ["host", "emulated"])
def test_boards_have_a_part_in_a_bus_of_their_own_rate_alone(bench, boards):
    with Rig(bench, boards) as rig:
        rig.advance(0.1)
        everybody = senders(rig, 0.5)
        assert everybody == {0, 1, 2, 3}
        rig.can_rate(500_000)
        rig.advance(0.01)  # what was on the bus ends
        assert senders(rig, 0.5) == set()
        rig.can_rate(250_000)
        assert senders(rig, 0.5) == everybody


@pytest.mark.parametrize("bit_s", [0, 1_100_000])
def test_a_rate_that_no_bus_has_is_refused(bench, bit_s):
    with Rig(bench, "host") as rig, pytest.raises(UserError, match=f"not {bit_s}"):
        rig.can_rate(bit_s)
