"""What a live sensor is asked for blocks by: sums, chips or nothing, by the link and the number of codes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.link.blocks import BlockAssembler
from goldfield.link.chip_blocks import ChipBlockAssembler
from goldfield.sensor import dialogue as dialogues
from goldfield.sensor import session as sessions
from goldfield.sensor.session import Session
from goldfield.types import Block
from goldfield_protocol import encode
from goldfield_protocol.parameters import PARAMETERS
from tests.host.fake_sensor import NODE, SITE, heartbeat
from tests.host.virtual_link import VirtualLink

BLOCKS, STREAM = PARAMETERS["blocks"].first, PARAMETERS["stream"].first
SERIAL, CAN = 1, 2
ROOM = sites.load(SITE)
CALIBRATION = {PARAMETERS[f"zero_{axis}"].first: 2040.0 + i for i, axis in enumerate("xyz")} | {
    PARAMETERS["calibration"].identifier(i): float(value) for i, value in enumerate((1e-7 * np.eye(3)).ravel())
}


def room(beacons):
    """The site with so many beacons; what they are does not matter here."""
    one = ROOM.beacons[0]
    return dataclasses.replace(
        ROOM, beacons=tuple(dataclasses.replace(one, id=f"c{i}", code=2 + i) for i in range(beacons))
    )


@pytest.fixture
def started(monkeypatch):
    def make(beacons, link_bit, *, blocks=True, before=None):
        link = VirtualLink({28: 10, BLOCKS: 0, STREAM: 0, **CALIBRATION, **(before or {})})
        link.link_bit = link_bit
        monkeypatch.setattr(sessions, "time", link)
        monkeypatch.setattr(dialogues, "time", link)
        link.deliver(heartbeat())
        session = Session(link, "virtual", room(beacons), NODE, blocks=blocks)
        session.start(session.block_parameters)
        return link, session

    return make


@pytest.mark.parametrize(
    ("beacons", "link_bit", "blocks", "stream"),
    [
        (8, SERIAL, SERIAL, 0),
        (8, CAN, CAN, 0),
        (12, CAN, CAN, 0),
        (13, CAN, 0, 0),
        (32, SERIAL, SERIAL, 0),
        (33, SERIAL, 0, 1),
    ],
)
def test_the_sensor_is_asked_for_what_the_link_carries(started, capsys, beacons, link_bit, blocks, stream):
    link, session = started(beacons, link_bit)
    assert (link.parameters[BLOCKS], link.parameters[STREAM]) == (blocks, stream)
    assert isinstance(session.blocks, ChipBlockAssembler if stream else BlockAssembler)
    said = capsys.readouterr().err
    assert ("sums of" in said) is (not blocks)
    if stream:
        assert "the sensor sends every chip" in said
    elif not blocks:
        assert "the sensor sends whole cycles, 10 a second: sums of 13 codes" in said
    session.end()
    session.dialogue.ask(BLOCKS)  # what was sent before is through
    assert (link.parameters[BLOCKS], link.parameters[STREAM]) == (0, 0)


def test_a_sensor_that_streamed_before_goes_on(started):
    link, session = started(33, SERIAL, before={STREAM: 1})
    session.end()
    session.dialogue.ask(BLOCKS)
    assert link.parameters[STREAM] == 1


def test_nothing_is_asked_where_no_blocks_are_read(started):
    link, session = started(8, SERIAL, blocks=False)
    assert (link.parameters[BLOCKS], session.blocks) == (0, None)


def test_streamed_chips_come_as_blocks_in_the_sensors_own_calibration(started):
    link, session = started(33, SERIAL)
    time_s = 511.5 * 97.75e-6
    link.deliver(encode("EPOCH", {"cycle": 0, "time": time_s}, node=NODE))
    for chip in range(62):
        signals = {"x": 8 * chip, "y": 8, "z": -32768 if chip == 40 else 0, "cycle_low": 1}
        link.deliver(encode("CHIP", signals, node=NODE, index=chip), after_s=1e-4 * chip)
    events = session.events()
    blocks = []
    while len(blocks) < 2:
        event = next(events)
        blocks += [event] if isinstance(event, Block) else []
    assert [(block.cycle, block.chip, block.sampled) for block in blocks] == [(1, 0, True), (1, 31, True)]
    assert np.allclose(blocks[0].data_T[:, 0], 1e-7 * (np.arange(31) + 8.0), rtol=1e-5)
    assert np.allclose(blocks[0].data_T[:, 1], 1e-7 * (1 + 7.0), rtol=1e-5)
    assert np.argwhere(np.isnan(blocks[1].data_T)).tolist() == [[9, 2]]
