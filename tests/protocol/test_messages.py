"""Which frames are messages: type, index and length as the database has them, for the host and the firmware."""

import random
import re

import pytest

from goldfield_protocol import c_tables
from goldfield_protocol.messages import DBC, Identifier, Mismatch, database, decode, mismatch

TEXT = DBC.read_text(encoding="ascii")
LENGTHS = {
    (int(number) >> 24) & 0x1F: int(length) for number, length in re.findall(r"^BO_ (\d+) \w+: (\d)", TEXT, re.M)
}
LARGEST = {
    (int(number) >> 24) & 0x1F: int(value)
    for number, value in re.findall(r'^BA_ "LargestIndex" BO_ (\d+) (\d+);', TEXT, re.M)
}


@pytest.mark.parametrize("type_", range(32))
def test_a_frame_is_a_message_only_with_its_index_and_its_length(type_):
    for length in range(9):
        for index in (0, LARGEST.get(type_, 0), LARGEST.get(type_, 0) + 1, 4095):
            identifier = Identifier(type_, min(index, 4095), 3).pack()
            expected = Mismatch.LENGTH if length != LENGTHS.get(type_) else None
            if type_ not in LENGTHS or min(index, 4095) > LARGEST.get(type_, 0):
                expected = Mismatch.FOREIGN
            assert mismatch(identifier, length) is expected
            assert expected is None or decode(identifier, bytes(length)) is None


def test_eight_bytes_that_another_protocol_sends_are_no_parameter():
    """J1939's TSC1, 0C000003, has the identifier of PARAM_SET to node 3; a wheel speed, 08FE6E0B, that of HEARTBEAT."""
    assert mismatch(0x0C000003, 8) is Mismatch.LENGTH
    assert decode(0x0C000003, bytes.fromhex("0055000000FFFFFF")) is None
    assert decode(0x0C000003, bytes.fromhex("0055000000")).signals["value_unsigned"] == 0x55
    assert mismatch(0x08FE6E0B, 8) is Mismatch.FOREIGN


def test_the_firmwares_table_is_the_databases():
    rows = re.findall(r"\[(\d+)\] = \{true, (\d+)u, (\d+)u\}", c_tables.messages_header())
    assert {int(t): (int(n), int(i)) for t, n, i in rows} == {t: (n, LARGEST.get(t, 0)) for t, n in LENGTHS.items()}


def test_blocks_as_in_the_golden_frames():
    """The bytes of protocol/vectors, whose bits were laid out by hand: x first, the count of the blocks last."""
    block = decode(0x0F3FE064, bytes.fromhex("e204e0b13f0000db"))
    assert (block.name, block.index, block.node) == ("BLOCK", 1022, 100)
    assert block.signals["cycle_low"] == 5
    assert block.signals["block_low"] == 13
    assert [block.signals[axis] for axis in "xyz"] == pytest.approx([1e-6, -2e-6, -262144 * 8e-10])
    total = decode(0x1A002064, bytes.fromhex("ffffffff7f0000d8"))
    assert (total.name, total.index, total.node) == ("BLOCK_SUM", 2, 100)
    assert total.signals["block_low"] == 13
    assert [total.signals[axis] for axis in "xyz"] == pytest.approx([-4e-10, 524287 * 4e-10, -524288 * 4e-10])


@pytest.mark.parametrize("message", database().messages, ids=lambda message: message.name)
def test_messages_are_unpacked_to_the_very_numbers_of_cantools(message):
    rng = random.Random(message.name)
    for data in [bytes(message.length), b"\xff" * message.length, *(rng.randbytes(message.length) for _ in range(300))]:
        if message.is_multiplexed() and data[0] % 16 > 1:
            continue  # kinds that the message has not, and floats that are no numbers
        expected = message.decode(data, decode_choices=False, scaling=True)
        found = decode(Identifier(message.frame_id >> 24, 0, 77).pack(), data)
        assert (found.name, found.node, found.index, found.signals) == (message.name, 77, 0, expected)
