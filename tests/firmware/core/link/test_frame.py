"""Frames in C against the shared vectors and, on any bytes, against the Python decoder."""

import binascii
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield_protocol.framing import FrameDecoder, RawFrame, encode_frame
from hil_sim.clib import ROOT

VECTORS = json.loads((ROOT / "protocol/vectors/frames.json").read_text())
COUNTERS = ("bad_crc", "malformed", "overlong")
raw_frames = st.builds(RawFrame, st.integers(0, (1 << 29) - 1), st.binary(max_size=8))


def encode(core, identifier, data):
    ffi, lib = core
    frame = ffi.new("frame_t *", {"id": identifier, "length": len(data), "data": list(data[:8])})
    buffer = ffi.new("uint8_t[16]")
    return bytes(ffi.buffer(buffer)[: lib.frame_encode(frame, buffer)])


def decode(core, stream):
    """Frames and counters after all bytes."""
    ffi, lib = core
    decoder = ffi.new("frame_decoder_t *")
    lib.frame_decoder_init(decoder)
    frame = ffi.new("frame_t *")
    frames = []
    for byte in stream:
        if lib.frame_decode(decoder, byte, frame):
            frames.append(RawFrame(frame.id, bytes(frame.data[0 : frame.length])))
    assert lib.frame_dropped(decoder) == sum(getattr(decoder, name) for name in COUNTERS)
    return frames, {name: getattr(decoder, name) for name in COUNTERS}


@pytest.mark.parametrize("vector", VECTORS["frames"], ids=lambda v: v["name"])
def test_shared_frames(core, vector):
    data, encoded = bytes.fromhex(vector["data"]), bytes.fromhex(vector["encoded"])
    assert encode(core, vector["id"], data) == encoded
    assert decode(core, encoded)[0] == [RawFrame(vector["id"], data)]


@pytest.mark.parametrize("vector", VECTORS["streams"], ids=lambda v: v["name"])
def test_shared_streams(core, vector):
    frames, counters = decode(core, bytes.fromhex(vector["bytes"]))
    assert [{"id": f.identifier, "data": f.data.hex()} for f in frames] == vector["frames"]
    assert counters == {name: vector[name] for name in COUNTERS}


@given(raw_frames)
def test_encodes_as_python_does(core, frame):
    assert encode(core, frame.identifier, frame.data) == encode_frame(frame.identifier, frame.data)


pieces = st.one_of(
    raw_frames.map(lambda f: encode_frame(f.identifier, f.data)),
    st.tuples(raw_frames, st.integers(0, 15), st.integers(1, 255)).map(
        lambda t: bytes(b ^ (t[2] if i == t[1] else 0) for i, b in enumerate(encode_frame(t[0].identifier, t[0].data)))
    ),
    st.binary(max_size=20),
    st.lists(st.integers(0, 4), max_size=20).map(bytes),
)


@given(st.lists(pieces, max_size=12).map(b"".join))
def test_any_bytes_decode_as_in_python(core, stream):
    reference = FrameDecoder()
    expected = list(reference.feed(stream))
    assert decode(core, stream) == (expected, {name: getattr(reference, name) for name in COUNTERS})


def test_impossible_frames_are_not_encoded(core):
    assert encode(core, 1 << 29, b"") == b""
    assert encode(core, 5, bytes(9)) == b""


def test_crc_check_value_and_counter_that_stops(core):
    ffi, lib = core
    assert lib.frame_crc(b"123456789", 9) == 0x29B1
    assert lib.frame_crc(b"", 0) == 0xFFFF
    decoder = ffi.new("frame_decoder_t *", {"malformed": 2**32 - 1, "bad_crc": 7})
    for byte in b"\x01\0":
        lib.frame_decode(decoder, byte, ffi.new("frame_t *"))
    assert decoder.malformed == 2**32 - 1
    assert lib.frame_dropped(decoder) == 2**32 - 1


def test_what_the_decoder_starts_with_and_what_lies_behind_the_data(core):
    """Whatever lay in the decoder before, and in the frame: bytes behind the data are zero, as on the wire."""
    ffi, lib = core
    decoder, frame = ffi.new("frame_decoder_t *"), ffi.new("frame_t *", {"data": [0xEE] * 8})
    ffi.memmove(decoder, b"\x55" * ffi.sizeof("frame_decoder_t"), ffi.sizeof("frame_decoder_t"))
    lib.frame_decoder_init(decoder)
    assert lib.frame_dropped(decoder) == 0
    stream = encode_frame(0x123, b"\x07\x08")
    assert [bool(lib.frame_decode(decoder, byte, frame)) for byte in stream] == [False] * (len(stream) - 1) + [True]
    assert (frame.id, frame.length, bytes(frame.data)) == (0x123, 2, b"\x07\x08" + bytes(6))


def test_an_encoded_frame_ends_with_a_zero_and_goes_no_further(core):
    ffi, lib = core
    frame = ffi.new("frame_t *", {"id": 0x1FFFFFFF, "length": 3, "data": [1, 0, 2]})
    buffer = ffi.new("uint8_t[16]", [0xEE] * 16)
    count = lib.frame_encode(frame, buffer)
    assert bytes(buffer)[:count] == encode_frame(0x1FFFFFFF, b"\x01\x00\x02")
    assert bytes(buffer)[count - 1 :] == b"\0" + b"\xee" * (16 - count)


def stuffed(payload):
    """Bytes on the wire of any payload, by another hand: each zero becomes the distance to the next."""
    pieces = payload.split(b"\0")
    return b"".join(bytes([len(piece) + 1]) + piece for piece in pieces) + b"\0"


def checked(body):
    """A body of any length with the checksum that is right for it."""
    return body + binascii.crc_hqx(body, 0xFFFF).to_bytes(2, "little")


@pytest.mark.parametrize(
    ("body", "good"),
    [
        (b"\1\2\3", False),
        (b"\1\2\3\4", True),
        (b"\1\2\3\4" + bytes(range(1, 9)), True),
        (b"\xff\xff\xff\x1f", True),
        (b"\0\0\0\x20", False),
    ],
)
def test_the_least_and_the_most_that_is_a_frame(core, body, good):
    """Both sides of the shortest, the longest and the largest identifier, each with a right checksum."""
    frames, counters = decode(core, stuffed(checked(body)))
    assert len(frames) == good
    assert counters == {"bad_crc": 0, "malformed": int(not good), "overlong": 0}


def test_a_counter_counts_to_its_end(core):
    """The sum of all stops at its end, and one below it is told as it is."""
    ffi, lib = core
    for before, after in ((2**32 - 3, 2**32 - 2), (2**32 - 2, 2**32 - 1), (2**32 - 1, 2**32 - 1)):
        decoder = ffi.new("frame_decoder_t *", {"malformed": before})
        for byte in b"\1\0":
            lib.frame_decode(decoder, byte, ffi.new("frame_t *"))
        assert decoder.malformed == after
    for parts in ((2**31, 2**31 - 2, 0), (2**31, 2**31 - 1, 0), (2**31, 2**31 - 1, 1)):
        decoder = ffi.new("frame_decoder_t *", dict(zip(COUNTERS, parts, strict=True)))
        assert lib.frame_dropped(decoder) == min(sum(parts), 2**32 - 1)
