"""The budget of the links: lengths against frames that are laid out bit by bit, the page, and what is chosen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from goldfield.link.budget import LINK_BITS, SHARE, Carrier, Link, block_s, choose, load, message_s, table
from goldfield_protocol import encode_frame
from goldfield_protocol.messages import database
from goldfield_protocol.parameters import PARAMETERS

FRAMING = Path(__file__).parents[3] / "protocol" / "framing.md"
NAMES = [message.name for message in database().messages]
N, CHIP_S = 1023, 97.75e-6


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
        assert len(encode_frame(identifier, data)) * 10 / 2e6 == pytest.approx(message_s(Link.SERIAL, name))
        longest = max(longest, can_bits(identifier, data))
    assert 0.85 * message_s(Link.CAN, name) < longest * 1e-6 <= message_s(Link.CAN, name)


def test_the_table_of_the_page():
    assert table() in FRAMING.read_text(encoding="utf-8"), "write it: python -m goldfield.link.budget"


def test_the_table_by_hand():
    """Eight codes: nine frames of 160 us, or of 16 bytes of 5 us, in 31 chips, and eleven in a cycle."""
    cycle_s = N * CHIP_S
    for link, frame_s in ((Link.CAN, 160e-6), (Link.SERIAL, 80e-6)):
        assert block_s(link, 8) == pytest.approx(9 * frame_s)
        expected = 9 * frame_s / (31 * CHIP_S) + 11 * frame_s / cycle_s
        assert load(link, Carrier.BLOCKS, 8, N, CHIP_S) == pytest.approx(expected)
        assert load(link, Carrier.CYCLES, 8, N, CHIP_S) == pytest.approx(11 * frame_s / cycle_s)
    streamed = 80e-6 / CHIP_S + 11 * 80e-6 / cycle_s
    assert load(Link.SERIAL, Carrier.CHIPS, 8, N, CHIP_S) == pytest.approx(streamed)


@pytest.mark.parametrize(
    ("link", "codes", "carrier"),
    [
        (Link.CAN, 1, Carrier.BLOCKS),
        (Link.CAN, 12, Carrier.BLOCKS),
        (Link.CAN, 13, Carrier.CYCLES),
        (Link.CAN, 64, Carrier.CYCLES),
        (Link.SERIAL, 32, Carrier.BLOCKS),
        (Link.SERIAL, 33, Carrier.CHIPS),
        (Link.SERIAL, 64, Carrier.CHIPS),
    ],
)
def test_what_is_chosen(link, codes, carrier):
    choice = choose(link, codes, N, CHIP_S)
    assert choice.carrier is carrier
    assert choice.load == load(link, carrier, codes, N, CHIP_S) <= SHARE[link]
    wanted = {
        Carrier.BLOCKS: {PARAMETERS["blocks"].first: LINK_BITS[link]},
        Carrier.CHIPS: {PARAMETERS["stream"].first: 1},
        Carrier.CYCLES: {},
    }
    assert choice.parameters == wanted[carrier]


def test_two_sensors_share_a_bus():
    assert choose(Link.CAN, 5, N, CHIP_S, sensors=2).carrier is Carrier.BLOCKS
    both = choose(Link.CAN, 8, N, CHIP_S, sensors=2)
    assert both.carrier is Carrier.CYCLES
    assert "2 sensors" in both.text


def test_every_choice_is_told_in_one_sentence():
    for link in Link:
        for codes in (1, 2, 8, 20, 64):
            text = choose(link, codes, N, CHIP_S).text
            assert "%" in text
            assert not text.endswith(".")
            assert len(text) < 160
