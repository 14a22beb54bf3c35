"""What a sensor sends of its cycles, counted on host boards at several rates of CAN and serial, beside the budget."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest

from goldfield.access.epoch import EpochSeparator
from goldfield.link.budget import SHARE, Carrier, load
from goldfield.link.line import RATES, Line, Link
from goldfield.locate import locate
from goldfield.types import Status
from goldfield_protocol import FrameDecoder, encode, encode_frame
from goldfield_protocol.messages import decode
from goldfield_protocol.parameters import COUNTERS
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from hil_sim.bench import SimulatedBench
from hil_sim.clib import ROOT
from hil_sim.rig import Rig
from hil_sim.scenario import SCENARIOS, Links, load_scenario
from tests.hil.bound import check_at_the_bound
from tests.hil.rig_link import altered_boards
from tests.host.link.test_budget import can_bits

N, CHIP_S = 1023, 97.75e-6
SENSOR, CODES, SECONDS, CYCLES = 100, 8, 2.0, 20
(EPOCHS_DROPPED,) = (counter.index for counter in COUNTERS if counter.identifier == "epochs_dropped")
OF_CYCLES = ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", "FIELD")


@pytest.fixture(scope="module")
def scenario():
    return load_scenario(str(ROOT / "hil_sim/scenarios/prigge8.toml"))


def of_cycles(frame):
    """Whether a frame is of the report of a cycle."""
    message = decode(frame.identifier, frame.data)
    return message is not None and message.node == SENSOR and message.name in OF_CYCLES


def bench(scenario, **rates):
    """Boards of which the sensor computes no pose: what it sends is its cycles, and a heartbeat now and then."""
    return Rig(replace(scenario, links=Links(**rates)), altered_boards({0: {"pose": 0}}))


@pytest.mark.long
@pytest.mark.parametrize("rate", RATES[Link.CAN])
def test_can(scenario, rate):
    """All that the budget says fits does come at that rate; the real stuff bits are fewer than the most."""
    with bench(scenario, can_bit_s=rate) as rig:
        rig.advance(2.5)
        rig.can_read()
        rig.advance(SECONDS)
        frames = [frame for frame in rig.can_read() if of_cycles(frame)]
        busy = rig.can_statistics()
    cycles = SECONDS / (N * CHIP_S)
    assert len(frames) == pytest.approx(cycles * (3 + CODES), abs=3 + CODES)
    taken = sum(can_bits(frame.identifier, frame.data) for frame in frames) / rate / SECONDS
    budget = load(Line(Link.CAN, rate), Carrier.CYCLES, CODES, N, CHIP_S)
    assert budget < SHARE[Link.CAN]
    assert 0.75 * budget < taken <= budget * (1.0 + 1.0 / cycles)
    assert busy["errors"] == 0


@pytest.mark.long
@pytest.mark.parametrize(("link", "bit_s", "baud"), [("can", 500_000, 2_000_000), ("can", 125_000, 115_200)])
def test_poses_of_what_comes_at_lower_rates(tmp_path, link, bit_s, baud):
    judge_poses(tmp_path, link, bit_s, baud)


@pytest.mark.long
@pytest.mark.parametrize("baud", SERIAL_RATES[1:])
def test_poses_of_what_comes_over_slower_lines(tmp_path, baud):
    judge_poses(tmp_path, "serial", 1_000_000, baud)


def judge_poses(tmp_path, link, bit_s, baud):
    """Every cycle comes whole, and its pose is at the bound: 8 codes take 15 % of the slowest line, and 14 % of CAN."""
    path = tmp_path / "prigge8.toml"
    links = f"\n[links]\ncan_bit_s = {bit_s}\nserial_baud = {baud}\n"
    path.write_text((SCENARIOS / "prigge8.toml").read_text() + links)
    bench = SimulatedBench(str(path), "host", tmp_path, link)
    reports = bench.reports(CYCLES)
    poses = [locate(bench.site, EpochSeparator(bench.site).fields(report)) for report in reports]
    truth = bench.truth()
    bench.close()
    assert all(r.complete and r.locked for r in reports)
    assert [pose.epoch for pose in poses] == list(range(poses[0].epoch, poses[0].epoch + CYCLES))
    assert all(pose.status is Status.OK for pose in poses)
    check_at_the_bound(bench.site, poses, truth)


@pytest.mark.long
def test_a_link_that_is_too_slow_for_blocks_costs_blocks_and_nothing_else(scenario):
    """Blocks of 8 codes, on both links, are five times what the slowest ones carry."""
    slow = replace(scenario, links=Links(CAN_RATES[-1], SERIAL_RATES[-1]))
    with Rig(slow, altered_boards({0: {"pose": 0, "blocks": 3}})) as rig:
        rig.advance(2.5)
        rig.can_read()
        rig.serial_read()
        before = rig.can_statistics()["busy_ps"]
        rig.advance(5.0)
        busy = (rig.can_statistics()["busy_ps"] - before) / 5e12
        decoder = FrameDecoder()
        lines = {
            "can": [decode(frame.identifier, frame.data) for frame in rig.can_read()],
            "serial": [decode(frame.identifier, frame.data) for frame in decoder.feed(rig.serial_read())],
        }
    assert 0.6 < busy < 0.95  # three quarters for the sensor, and the beacons
    for messages in lines.values():
        names = Counter(m.name for m in messages if m is not None and m.node == SENSOR)
        assert names["HEARTBEAT"] in (4, 5)
        assert names["EPOCH"] == pytest.approx(50, abs=1)
        assert names["BLOCK"] > 0
        assert names["FIELD"] == pytest.approx(CODES * names["EPOCH"], abs=CODES)
        assert names["RESET_REPORT"] == 0
        counters = {m.index for m in messages if m is not None and m.name == "COUNTER" and m.node == SENSOR}
        assert not counters


@pytest.mark.long
def test_a_link_that_is_too_slow_for_cycles_costs_whole_cycles(scenario):
    """64 codes of degree 9 are nearly twice what either link carries; a question on serial is answered all the same."""
    slow = replace(scenario, degree=9, links=Links(CAN_RATES[-1], SERIAL_RATES[-1]))
    with Rig(slow, altered_boards({0: {"pose": 0, "code_count": 64, "code_list": list(range(64))}})) as rig:
        rig.advance(2.5)
        rig.can_read()
        decoder = FrameDecoder()
        decoder.feed(rig.serial_read())
        rig.advance(5.0)
        rig.serial_write(encode_frame(*encode("PARAM_GET", {"reserved": 0}, node=SENSOR, index=59)))
        rig.advance(0.5)
        lines = [
            [decode(frame.identifier, frame.data) for frame in rig.can_read()],
            [decode(frame.identifier, frame.data) for frame in decoder.feed(rig.serial_read())],
        ]
    assert decoder.bad_crc == decoder.overlong == 0
    for messages, answers in zip(lines, ([], [59]), strict=True):
        own = [m for m in messages if m is not None and m.node == SENSOR]
        names = Counter(m.name for m in own)
        assert 40 < names["EPOCH"] < 80  # of 110
        assert names["FIELD"] == pytest.approx(64 * names["EPOCH"], abs=64)
        assert names["HEARTBEAT"] in (5, 6)
        assert names["RESET_REPORT"] == 0
        assert [m.index for m in own if m.name == "PARAM_VALUE"] == answers
        assert {m.index for m in own if m.name == "COUNTER"} == {EPOCHS_DROPPED}


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
        budget = load(Line(Link.SERIAL, rate), Carrier.CYCLES, CODES, N, CHIP_S)
        assert 10 * lengths / rate / SECONDS == pytest.approx(budget, rel=1.5 / cycles)
