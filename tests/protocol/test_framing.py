"""Serial framing against published vectors and properties."""

import crcmod.predefined
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goldfield_protocol.framing import FrameDecoder, RawFrame, cobs_decode, cobs_encode, crc16, encode_frame

# Cheshire & Baker's examples as given in the COBS article of Wikipedia.
COBS_VECTORS = [
    ("00", "0101"),
    ("0000", "010101"),
    ("001100", "01021101"),
    ("11220033", "0311220233"),
    ("11223344", "0511223344"),
    ("11000000", "0211010101"),
]

frames = st.builds(RawFrame, st.integers(0, (1 << 29) - 1), st.binary(max_size=8))


def test_crc_check_value():
    assert crc16(b"123456789") == 0x29B1


@given(st.binary(max_size=64))
def test_crc_is_that_of_crcmod(data):
    assert crc16(data) == crcmod.predefined.mkPredefinedCrcFun("crc-ccitt-false")(data)


@pytest.mark.parametrize(("plain", "encoded"), COBS_VECTORS)
def test_cobs_vectors(plain, encoded):
    assert cobs_encode(bytes.fromhex(plain)).hex() == encoded
    assert cobs_decode(bytes.fromhex(encoded)) == bytes.fromhex(plain)


@given(st.lists(frames), st.lists(st.integers(1, 40)))
def test_frames_survive_any_chunking(sent, chunks):
    stream = b"".join(encode_frame(f.identifier, f.data) for f in sent)
    decoder = FrameDecoder()
    received = []
    position = 0
    for size in [*chunks, len(stream)]:
        received += decoder.feed(stream[position : position + size])
        position += size
    received += decoder.feed(stream[position:])
    assert received == sent
    assert (decoder.bad_crc, decoder.malformed, decoder.overlong) == (0, 0, 0)


@given(st.lists(frames, min_size=3, max_size=3), st.binary(max_size=40))
def test_garbage_costs_only_itself(sent, garbage):
    decoder = FrameDecoder()
    stream = encode_frame(sent[0].identifier, sent[0].data) + garbage + b"\0"
    stream += encode_frame(sent[1].identifier, sent[1].data) + encode_frame(sent[2].identifier, sent[2].data)
    received = list(decoder.feed(stream))
    assert received[0] == sent[0]
    assert received[-2:] == sent[1:]


@given(frames, st.data())
def test_a_flipped_bit_is_never_accepted_as_another_frame(frame, data):
    encoded = bytearray(encode_frame(frame.identifier, frame.data))
    position = data.draw(st.integers(0, len(encoded) - 2))
    encoded[position] ^= 1 << data.draw(st.integers(0, 7))
    received = list(FrameDecoder().feed(bytes(encoded)))
    assert all(f == frame for f in received) or len(received) == 0 or 0 in encoded[:-1]
