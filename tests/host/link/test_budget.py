"""The budget of the links: lengths against frames that are laid out bit by bit, the page, and what is chosen."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from goldfield.link.budget import (
    LEAST_HZ,
    LINK_BITS,
    MOST_CODES_ON_CAN,
    SHARE,
    Carrier,
    block_rate_Hz,
    block_s,
    choose,
    cycles_of_strongest,
    load,
    main,
    message_s,
    most_reported,
    pose_rate_Hz,
    rate_table,
    reported_text,
    shared_table,
    table,
)
from goldfield.link.line import FASTEST, RATES, Line, Link
from goldfield_protocol import encode_frame
from goldfield_protocol.messages import database
from goldfield_protocol.parameters import PARAMETERS
from goldfield_protocol.rates import CAN_RATES

FIRMWARE = Path(__file__).parents[3] / "firmware"
CAN_FRAME_S = 160e-6
FRAMING = Path(__file__).parents[3] / "protocol" / "framing.md"
NAMES = [message.name for message in database().messages]
N, CHIP_S = 1023, 97.75e-6
CAN, SERIAL = FASTEST[Link.CAN], FASTEST[Link.SERIAL]


def can_bits(identifier: int, data: bytes) -> int:
    """Bits of a frame with a 29-bit identifier, and of the pause behind it (ISO 11898-1, 10.4 and 10.5)."""
    base, extension = identifier >> 18, identifier & 0x3FFFF
    text = f"0{base:011b}11{extension:018b}000{len(data):04b}" + "".join(f"{byte:08b}" for byte in data)
    crc = 0
    for bit in text:
        turn = int(bit) ^ crc >> 14
        crc = (crc << 1 & 0x7FFF) ^ (0x4599 if turn else 0)
    text += f"{crc:015b}"
    sent, run, last = 0, 0, ""
    for bit in text:
        sent += 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            sent += 1
            last, run = ("1" if bit == "0" else "0"), 1
    return sent + 1 + 2 + 7 + 3


@pytest.mark.parametrize("name", NAMES)
def test_no_frame_is_longer(name):
    message = database().get_message_by_name(name)
    rng = np.random.default_rng(message.frame_id % 997)
    longest = 0
    for _ in range(200):
        data = bytes(rng.choice([0, 0xFF, *rng.integers(0, 256, 2)], message.length).tolist())
        identifier = message.frame_id | int(rng.integers(0, 4096)) << 12 | int(rng.integers(0, 4096))
        assert len(encode_frame(identifier, data)) * 10 / 2e6 == pytest.approx(message_s(SERIAL, name))
        longest = max(longest, can_bits(identifier, data))
    assert 0.85 * message_s(CAN, name) < longest * 1e-6 <= message_s(CAN, name)


def test_the_table_of_the_page():
    text = FRAMING.read_text(encoding="utf-8")
    assert table() in text, "write it: python -m goldfield.link.budget"
    assert shared_table() in text, "write it: python -m goldfield.link.budget"


def test_the_table_by_hand():
    """Eight codes: nine frames of 160 us, or of 16 bytes of 5 us, in 31 chips, and eleven in a cycle."""
    cycle_s = N * CHIP_S
    for link, frame_s in ((Link.CAN, 160e-6), (Link.SERIAL, 80e-6)):
        assert block_s(FASTEST[link], 8) == pytest.approx(9 * frame_s)
        expected = 9 * frame_s / (31 * CHIP_S) + 11 * frame_s / cycle_s
        assert load(FASTEST[link], Carrier.BLOCKS, 8, N, CHIP_S) == pytest.approx(expected)
        assert load(FASTEST[link], Carrier.CYCLES, 8, N, CHIP_S) == pytest.approx(11 * frame_s / cycle_s)
    streamed = 80e-6 / CHIP_S + 11 * 80e-6 / cycle_s
    assert load(SERIAL, Carrier.CHIPS, 8, N, CHIP_S) == pytest.approx(streamed)


@pytest.mark.parametrize(
    ("link", "codes", "carrier"),
    [
        (Link.CAN, 1, Carrier.BLOCKS),
        (Link.CAN, 12, Carrier.BLOCKS),
        (Link.CAN, 64, Carrier.CYCLES),
        (Link.SERIAL, 32, Carrier.BLOCKS),
        (Link.SERIAL, 33, Carrier.CHIPS),
        (Link.SERIAL, 64, Carrier.CHIPS),
    ],
)
def test_what_is_chosen(link, codes, carrier):
    choice = choose(FASTEST[link], codes, N, CHIP_S)
    assert choice.carrier is carrier
    assert choice.load == load(FASTEST[link], carrier, codes, N, CHIP_S) <= SHARE[link]
    wanted = {
        Carrier.BLOCKS: {PARAMETERS["blocks"].first: LINK_BITS[link]},
        Carrier.CHIPS: {PARAMETERS["stream"].first: 1},
        Carrier.CYCLES: {},
    }
    assert choice.parameters == wanted[carrier]


@pytest.mark.parametrize(
    ("codes", "sensors", "reduced"),
    [(12, 1, False), (13, 1, True), (60, 1, True), (5, 2, False), (6, 2, True), (3, 3, False), (4, 3, True)],
)
def test_some_blocks_are_left_out_where_can_does_not_carry_all(codes, sensors, reduced):
    choice = choose(CAN, codes, N, CHIP_S, sensors)
    rate_Hz = block_rate_Hz(CAN, codes, N, CHIP_S, sensors)
    full_Hz = 1.0 / (31 * CHIP_S)
    assert (choice.carrier, choice.reduced, rate_Hz < full_Hz) == (Carrier.BLOCKS, reduced, reduced)
    assert choice.parameters == {PARAMETERS["blocks"].first: LINK_BITS[Link.CAN]}
    taken = sensors * (load(CAN, Carrier.CYCLES, codes, N, CHIP_S) + rate_Hz * block_s(CAN, codes))
    assert taken == pytest.approx(SHARE[Link.CAN]) if reduced else taken == pytest.approx(choice.load)
    assert (f"{rate_Hz:.0f} times a second, not 330" in choice.text) is reduced
    assert (f"{sensors} sensors" in choice.text) is (sensors > 1)


@pytest.mark.parametrize(
    ("codes", "sensors", "carrier"),
    [(8, 12, Carrier.BLOCKS), (8, 13, Carrier.CYCLES), (60, 1, Carrier.BLOCKS), (61, 1, Carrier.CYCLES)],
)
def test_too_few_blocks_are_not_asked_for(codes, sensors, carrier):
    choice = choose(CAN, codes, N, CHIP_S, sensors)
    assert choice.carrier is carrier
    assert (block_rate_Hz(CAN, codes, N, CHIP_S, sensors) >= LEAST_HZ) is (carrier is Carrier.BLOCKS)
    assert ("whole cycles" in choice.text) is (carrier is Carrier.CYCLES)


def test_sensors_that_send_their_own_poses_divide_the_bus():
    pose_s, cycle_s = 4 * CAN_FRAME_S, N * CHIP_S
    for sensors in (1, 3, 4, 8):
        rate_Hz = pose_rate_Hz(CAN, 8, N, CHIP_S, sensors)
        taken = sensors * (rate_Hz * pose_s + 15 * CAN_FRAME_S / cycle_s)
        if sensors < 4:
            assert rate_Hz == pytest.approx(1.0 / (31 * CHIP_S))
            assert taken < SHARE[Link.CAN]
        else:
            assert taken == pytest.approx(SHARE[Link.CAN])


def test_the_share_is_the_firmwares():
    def constants(path):
        text = (FIRMWARE / path).read_text(encoding="utf-8")
        return {name: int(value) for name, value in re.findall(r"#define (\w+) +\(?(\d+)u?", text)}

    share, queue = constants("core/link/bus_share.h"), constants("services/node.h")["NODE_QUEUE_MESSAGES"]
    poses = constants("services/pose_report.h")["POSE_REPORT_MESSAGES"]
    assert share["BUS_SHARE_PERCENT"] == 100.0 * SHARE[Link.CAN]
    assert share["BUS_SHARE_MESSAGE_BITS"] == pytest.approx(CAN_RATES[0] * message_s(CAN, "BLOCK_SUM"))
    assert (queue - 1 - constants("services/blocks.h")["BLOCKS_REPORT_BESIDE"] - poses) // 2 == MOST_CODES_ON_CAN
    assert share["BUS_SHARE_CREDIT_BITS"] >= (1 + MOST_CODES_ON_CAN) * share["BUS_SHARE_MESSAGE_BITS"]


def test_every_choice_is_told_in_one_sentence():
    for link in Link:
        for codes in (1, 2, 8, 20, 64):
            text = choose(FASTEST[link], codes, N, CHIP_S).text
            assert "%" in text
            assert not text.endswith(".")
            assert len(text) < 160


def test_what_it_prints(capsys):
    main([])
    assert capsys.readouterr().out == f"{table()}\n{shared_table()}\n{rate_table()}"
    main(["--codes", "8", "--sensors", "3"])
    told = capsys.readouterr().out
    for rate in RATES[Link.SERIAL]:
        assert f"serial: {choose(Line(Link.SERIAL, rate), 8, N, CHIP_S).text}\n" in told
    for line in (Line(Link.CAN, rate) for rate in RATES[Link.CAN]):
        poses = f"(--on-sensor): {pose_rate_Hz(line, 8, N, CHIP_S, 3):.0f} a second\n"
        assert f"CAN: {choose(line, 8, N, CHIP_S, 3).text}\n  poses of the sensors themselves {poses}" in told


@pytest.mark.parametrize("link", Link)
def test_a_sensor_that_chooses_takes_the_cycles_of_k_codes(link):
    choice = cycles_of_strongest(FASTEST[link], 16, 1023, 97.75e-6)
    assert choice.carrier is Carrier.CYCLES
    assert choice.load == load(FASTEST[link], Carrier.CYCLES, 16, 1023, 97.75e-6)
    assert not choice.parameters


LINES = [Line(link, rate) for link, rates in RATES.items() for rate in rates]


@pytest.mark.parametrize("line", LINES, ids=str)
def test_the_most_codes_that_fit_are_found_at_every_rate(line):
    """Both sides of the limit, for one sensor and several; what is wanted is never exceeded."""
    link, fastest = line.link, FASTEST[line.link]
    assert load(line, Carrier.CHIPS, 8, N, CHIP_S) == pytest.approx(
        load(fastest, Carrier.CHIPS, 8, N, CHIP_S) * fastest.bit_rate / line.bit_rate
    )
    for sensors in (1, 2, 7, 30, 300):
        most = most_reported(line, 64, N, CHIP_S, sensors)
        if most:
            assert sensors * load(line, Carrier.CYCLES, most, N, CHIP_S) <= SHARE[link]
        if most < 64:
            assert sensors * load(line, Carrier.CYCLES, most + 1, N, CHIP_S) > SHARE[link]
        assert most_reported(line, 5, N, CHIP_S, sensors) == min(5, most)
        text = reported_text(line, 16, N, CHIP_S, sensors)
        assert ("not 16" in text) == (0 < most < 16)
        assert text.startswith("nothing") == (most == 0)
        assert text.endswith(f"of {line}")


@pytest.mark.parametrize("line", LINES, ids=str)
@pytest.mark.parametrize("codes", [1, 4, 8, 16, 32, 60])
def test_what_is_chosen_fits_at_every_rate(line, codes):
    """The part that is told is below the share; what carries more was refused because it does not fit."""
    choice, share = choose(line, codes, N, CHIP_S), SHARE[line.link]
    blocks, chips = (load(line, carrier, codes, N, CHIP_S) for carrier in (Carrier.BLOCKS, Carrier.CHIPS))
    assert str(line) in choice.text
    assert choice.carrier is not Carrier.BLOCKS or (choice.load <= share and choice.reduced == (blocks > share))
    assert choice.carrier is not Carrier.CHIPS or blocks > share >= chips == choice.load
    if choice.carrier is Carrier.CYCLES:
        assert blocks > share
        assert block_rate_Hz(line, codes, N, CHIP_S) < LEAST_HZ if line.link is Link.CAN else chips > share


@pytest.mark.parametrize(
    ("line", "codes", "carrier"),
    [
        (Line(Link.CAN, 500_000), 8, Carrier.BLOCKS),
        (Line(Link.CAN, 125_000), 11, Carrier.BLOCKS),
        (Line(Link.CAN, 125_000), 14, Carrier.CYCLES),
        (Line(Link.SERIAL, 921_600), 13, Carrier.BLOCKS),
        (Line(Link.SERIAL, 921_600), 15, Carrier.CYCLES),
        (Line(Link.SERIAL, 460_800), 5, Carrier.BLOCKS),
        (Line(Link.SERIAL, 460_800), 8, Carrier.CYCLES),
        (Line(Link.SERIAL, 115_200), 1, Carrier.CYCLES),
    ],
    ids=str,
)
def test_slower_links_carry_less(line, codes, carrier):
    assert choose(line, codes, N, CHIP_S).carrier is carrier


def test_the_page_has_the_rates():
    assert rate_table() in FRAMING.read_text(encoding="utf-8")


def test_what_is_told_of_the_rates(capsys):
    main(["--strongest", "16", "--sensors", "4"])
    told = capsys.readouterr().out
    for line in LINES:
        assert f"{line}: {reported_text(line, 16, N, CHIP_S, 4 if line.link is Link.CAN else 1)}\n" in told
