"""What a sensor sends of its cycles, counted on host boards at several rates of CAN and serial, beside the budget."""

from __future__ import annotations

import pytest

from goldfield.link.budget import RATES, SHARE, Carrier, Link, load
from goldfield_protocol import FrameDecoder
from goldfield_protocol.messages import decode
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.rig import config as rig_config
from hil_sim.scenario import load_scenario
from tests.hil.rig_link import altered_boards
from tests.host.link.test_budget import can_bits

N, CHIP_S = 1023, 97.75e-6
SENSOR, CODES, SECONDS = 100, 8, 2.0
OF_CYCLES = ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", "FIELD")


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(str(ROOT / "hil_sim/scenarios/prigge8.toml"))


def of_cycles(frame):
    """Whether a frame is of the report of a cycle."""
    message = decode(frame.identifier, frame.data)
    return message is not None and message.node == SENSOR and message.name in OF_CYCLES


def bench(scenario):
    """Boards of which the sensor computes no pose: what it sends is its cycles, and a heartbeat now and then."""
    return Rig(scenario, altered_boards({0: {"pose": 0}}))


@pytest.mark.long
@pytest.mark.parametrize("rate", RATES[Link.CAN])
def test_can(scenario, monkeypatch, rate):
    """All that the budget says fits does come at that rate; the real stuff bits are fewer than the most."""
    monkeypatch.setattr(rig_config, "CAN_BITS_PER_SECOND", rate)
    with bench(scenario) as rig:
        rig.advance(2.5)
        rig.can_read()
        rig.advance(SECONDS)
        frames = [frame for frame in rig.can_read() if of_cycles(frame)]
        busy = rig.can_statistics()
    cycles = SECONDS / (N * CHIP_S)
    assert len(frames) == pytest.approx(cycles * (3 + CODES), abs=3 + CODES)
    taken = sum(can_bits(frame.identifier, frame.data) for frame in frames) / rate / SECONDS
    budget = load(Link.CAN, Carrier.CYCLES, CODES, N, CHIP_S, rate)
    assert budget < SHARE[Link.CAN]
    assert 0.75 * budget < taken <= budget * (1.0 + 1.0 / cycles)
    assert busy["errors"] == 0


@pytest.mark.long
def test_serial(scenario):
    """The bytes are those of the budget, at whatever rate they go."""
    decoder, sent, lengths = FrameDecoder(), bytearray(), 0
    with bench(scenario) as rig:
        rig.advance(2.5)
        rig.serial_read()
        rig.advance(SECONDS)
        sent += rig.serial_read()
    frames = [chunk for chunk in bytes(sent).split(b"\0")[1:-1] if chunk]
    for chunk in frames:
        (frame,) = decoder.feed(chunk + b"\0")
        lengths += (len(chunk) + 1) * of_cycles(frame)
    cycles = SECONDS / (N * CHIP_S)
    for rate in RATES[Link.SERIAL]:
        budget = load(Link.SERIAL, Carrier.CYCLES, CODES, N, CHIP_S, rate)
        assert 10 * lengths / rate / SECONDS == pytest.approx(budget, rel=1.5 / cycles)
