"""The frames of protocol/vectors, shared with the C tests."""

import binascii
import json
from pathlib import Path

import pytest

from goldfield_protocol.framing import FrameDecoder, RawFrame, encode_frame

VECTORS = json.loads((Path(__file__).parents[2] / "protocol" / "vectors" / "frames.json").read_text())


@pytest.mark.parametrize("vector", VECTORS["frames"], ids=lambda v: v["name"])
def test_frames(vector):
    data = bytes.fromhex(vector["data"])
    encoded = bytes.fromhex(vector["encoded"])
    assert encode_frame(vector["id"], data) == encoded
    assert list(FrameDecoder().feed(encoded)) == [RawFrame(vector["id"], data)]
    # By the standard library: undo COBS by hand, then CRC-16/CCITT (binascii) of all but the last two bytes.
    plain = bytearray(encoded[:-1])
    position = 0
    while position < len(plain):
        distance = plain[position]
        assert distance > 0
        plain[position] = 0
        position += distance
    body = bytes(plain[1:])
    assert position == len(plain)
    assert binascii.crc_hqx(body[:-2], 0xFFFF) == int.from_bytes(body[-2:], "little")


@pytest.mark.parametrize("vector", VECTORS["streams"], ids=lambda v: v["name"])
def test_streams(vector):
    decoder = FrameDecoder()
    frames = [{"id": f.identifier, "data": f.data.hex()} for f in decoder.feed(bytes.fromhex(vector["bytes"]))]
    assert frames == vector["frames"]
    counters = {"bad_crc": decoder.bad_crc, "malformed": decoder.malformed, "overlong": decoder.overlong}
    assert counters == {name: vector[name] for name in counters}
