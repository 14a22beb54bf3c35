"""What a live sensor is asked for blocks by: sums, chips or nothing, by the link and the number of codes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.errors import SystemFailure
from goldfield.link.blocks import BlockAssembler
from goldfield.link.chip_blocks import ChipBlockAssembler
from goldfield.link.line import FASTEST, Line, Link
from goldfield.sensor.session import Session
from goldfield.types import Block
from goldfield_protocol import encode
from goldfield_protocol.parameters import PARAMETERS
from tests.host.fake_sensor import NODE, SITE, heartbeat
from tests.host.virtual_link import VirtualLink, told_by

BLOCKS, STREAM = PARAMETERS["blocks"].first, PARAMETERS["stream"].first
POSE_BLOCKS = PARAMETERS["pose_blocks"].first
SERIAL, CAN = 1, 2
LINES = {SERIAL: FASTEST[Link.SERIAL], CAN: FASTEST[Link.CAN]}
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
    def make(beacons, link_bit, *, blocks=True, before=None, others=(), poses=0, bit_rate=None):
        link = VirtualLink({28: 10, BLOCKS: 0, STREAM: 0, POSE_BLOCKS: 0, **CALIBRATION, **(before or {})})
        link.line = LINES[link_bit] if bit_rate is None else Line(LINES[link_bit].link, bit_rate)
        told_by(link, monkeypatch)
        for other in others:
            link.deliver(other)
        link.deliver(heartbeat())
        session = Session(link, "virtual", room(beacons), NODE, blocks=blocks, poses=bool(poses))
        session.start({POSE_BLOCKS: poses} if poses else session.block_parameters)
        return link, session

    return make


@pytest.mark.parametrize(
    ("beacons", "link_bit", "blocks", "stream"),
    [
        (8, SERIAL, SERIAL, 0),
        (8, CAN, CAN, 0),
        (12, CAN, CAN, 0),
        (13, CAN, CAN, 0),
        (61, CAN, 0, 0),
        (32, SERIAL, SERIAL, 0),
        (33, SERIAL, 0, 1),
    ],
)
def test_the_sensor_is_asked_for_what_the_link_carries(started, capsys, beacons, link_bit, blocks, stream):
    link, session = started(beacons, link_bit)
    assert (link.parameters[BLOCKS], link.parameters[STREAM]) == (blocks, stream)
    assert isinstance(session.blocks, ChipBlockAssembler if stream else BlockAssembler)
    said = capsys.readouterr().err
    assert ("sums of" in said) is (not blocks or beacons == 13)
    if stream:
        assert "the sensor sends every chip" in said
    elif not blocks:
        assert "the sensor sends whole cycles, 10 a second: sums of 61 codes" in said
    elif beacons == 13:
        assert "the sensor sends sums of 13 codes 323 times a second, not 330" in said
    session.end()
    session.dialogue.ask(BLOCKS)  # what was sent before is through
    assert (link.parameters[BLOCKS], link.parameters[STREAM]) == (0, 0)


@pytest.mark.parametrize(
    ("link_bit", "bit_rate", "blocks", "said"),
    [
        (CAN, 500_000, CAN, "sums of 8 codes 248 times a second, not 330, at most 75 % of CAN at 500 kbit/s"),
        (CAN, 125_000, CAN, "sums of 8 codes 53 times a second, not 330, at most 75 % of CAN at 125 kbit/s"),
        (SERIAL, 921_600, SERIAL, ""),
        (SERIAL, 115_200, 0, "whole cycles, 10 a second: sums of 8 codes"),
    ],
)
def test_a_slower_link_carries_less_and_it_is_said(started, capsys, link_bit, bit_rate, blocks, said):
    link, session = started(8, link_bit, bit_rate=bit_rate)
    assert (link.parameters[BLOCKS], link.parameters[STREAM]) == (blocks, 0)
    assert isinstance(session.blocks, BlockAssembler)
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("late", [115_200, 2_000_000])
def test_the_rate_counts_that_is_known_when_the_sensor_is_found(monkeypatch, late):
    """That of a serial line is found by its frames: what was chosen before, for another one, is not asked for."""
    link = VirtualLink({28: 10, BLOCKS: 0, STREAM: 0, **CALIBRATION})
    told_by(link, monkeypatch)
    link.deliver(heartbeat())
    link.line = Line(Link.SERIAL, 2_000_000 if late < 2_000_000 else 115_200)
    session = Session(link, "virtual", room(33), NODE, blocks=True)
    before = session.block_parameters
    link.line = Line(Link.SERIAL, late)
    session.start(before)
    assert link.parameters[STREAM] == (late == 2_000_000)
    assert isinstance(session.blocks, ChipBlockAssembler) is (late == 2_000_000)


@pytest.mark.parametrize(
    ("bit_rate", "beacons", "strongest", "reported"),
    [
        (125_000, 55, None, None),
        (125_000, 56, None, None),
        (125_000, 8, 55, 55),
        (125_000, 8, 56, 55),
        (250_000, 8, 64, 64),
    ],
)
def test_no_more_codes_than_fit_are_asked_for(monkeypatch, capsys, bit_rate, beacons, strongest, reported):
    chooses = PARAMETERS["strongest"].first
    link = VirtualLink({28: 10, chooses: 0})
    link.line = Line(Link.CAN, bit_rate)
    told_by(link, monkeypatch)
    link.deliver(heartbeat())
    Session(link, "virtual", room(beacons), NODE, strongest=strongest).start()
    assert link.parameters[chooses] == (reported or 0)
    told = capsys.readouterr().err
    assert ("56 codes a cycle do not fit into 75 % of CAN at 125 kbit/s" in told) is (56 in (beacons, strongest))
    assert ("strongest=55" in told) is (beacons == 56)


@pytest.mark.parametrize(("bit_rate", "one_fits"), [(250_000, False), (500_000, True)])
def test_a_link_that_carries_no_code_at_all_is_told(monkeypatch, capsys, bit_rate, one_fits):
    """Degree 5: a cycle takes 3 ms, the three messages before its fields 1.9 ms at 250 kbit/s, 1 ms at 500 kbit/s."""
    chooses = PARAMETERS["strongest"].first
    link = VirtualLink({28: 5, chooses: 0})
    link.line = Line(Link.CAN, bit_rate)
    told_by(link, monkeypatch)
    link.deliver(heartbeat())
    Session(link, "virtual", dataclasses.replace(room(8), degree=5), NODE, strongest=8).start()
    told = capsys.readouterr().err
    assert "8 codes a cycle do not fit into 75 % of CAN" in told
    assert ("nor does one: let the boards speak faster" in told) is not one_fits
    assert ("the sensor reports " in told) is one_fits
    assert (link.parameters[chooses] < 8) is one_fits


def motion(node, name="BLOCK", index=62):
    """What another sensor on the bus sends of its motion."""
    return encode(
        name,
        dict.fromkeys("xyz", 0.0) | {"cycle_low": 1} | ({"block_low": 1} if name == "BLOCK" else {}),
        node=node,
        index=index,
    )


def test_sensors_that_share_the_bus_are_said_and_counted_once(started, capsys):
    others = [motion(7), motion(8, "POSE_POSITION"), motion(9, "POSE_POSITION", 0), motion(7), motion(NODE)]
    link, session = started(8, CAN, others=others)
    assert link.parameters[BLOCKS] == CAN
    assert capsys.readouterr().err.count("161 times a second, not 330, with those of 3 sensors") == 1
    for other in (motion(7), motion(10), motion(10)):
        link.deliver(other)
    with pytest.raises(SystemFailure):
        next(session.events())
    assert capsys.readouterr().err.count("118 times a second, not 330, with those of 4 sensors") == 1


def test_no_blocks_are_asked_of_a_bus_that_would_carry_too_few(started, capsys):
    link, _ = started(8, CAN, others=[motion(node) for node in range(20, 32)])
    assert link.parameters[BLOCKS] == 0
    assert "the sensor sends whole cycles, 10 a second: sums of 8 codes of 13 sensors" in capsys.readouterr().err
    link, _ = started(8, CAN, others=[motion(node) for node in range(20, 31)])
    assert link.parameters[BLOCKS] == CAN


@pytest.mark.parametrize(("others", "every", "said"), [(2, 1, False), (3, 1, True), (3, 2, False)])
def test_fewer_poses_of_a_sensor_that_shares_the_bus_are_said(started, capsys, others, every, said):
    link, _ = started(8, CAN, blocks=False, others=[motion(20 + i) for i in range(others)], poses=every)
    assert link.parameters[POSE_BLOCKS] == every
    told = "the sensor sends 255 poses a second, not 330: 4 sensors share CAN at 1 Mbit/s"
    assert (told in capsys.readouterr().err) is said


@pytest.mark.parametrize(("link_bit", "bit_rate", "said"), [(SERIAL, 921_600, False), (SERIAL, 115_200, True)])
def test_fewer_poses_on_a_slow_link_are_said(started, capsys, link_bit, bit_rate, said):
    link, _ = started(8, link_bit, blocks=False, poses=1, bit_rate=bit_rate)
    assert link.parameters[POSE_BLOCKS] == 1
    told = capsys.readouterr().err
    assert ("poses a second, not 330: more do not fit on serial at 115,200 baud" in told) is said


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
