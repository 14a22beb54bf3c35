"""The same stream on both links, twice the same bytes, and bad bytes on the way."""

import numpy as np
import pytest

from goldfield.link.reports import Assembler
from goldfield_protocol import FrameDecoder, decode, encode_frame

SENSOR = 100


def fields_of(reports):
    return {r.cycle: r.correlation_T for r in reports}


def reports_of(stream):
    """Assemble a recorded stream; also returns the decoder with its counters."""
    decoder, assembler, reports = FrameDecoder(), Assembler(), []
    for frame in decoder.feed(stream):
        message = decode(frame.identifier, frame.data)
        if message is not None and message.node == SENSOR:
            reports += assembler.feed(message, 0.0)
    return [*reports, *assembler.flush()], decoder


@pytest.fixture(scope="module")
def serial(open_bench):
    bench = open_bench("prigge8")
    bench.reports(10)
    return bench


def test_can_tells_the_same(open_bench, serial):
    can = open_bench("prigge8", link="can")
    by_can = fields_of(can.reports(10))
    by_serial = fields_of(reports_of(bytes(serial.stream))[0])
    common = sorted(by_can.keys() & by_serial.keys())
    assert len(common) >= 9
    for cycle in common:
        assert by_can[cycle].keys() == by_serial[cycle].keys()
        for code, field in by_can[cycle].items():
            np.testing.assert_array_equal(field, by_serial[cycle][code])


def test_same_seed_same_bytes_in_any_slices(open_bench):
    streams = []
    for slice_ms in (1, 10):
        bench = open_bench("prigge8")
        for _ in range(600 // slice_ms):
            bench.advance(slice_ms * 1e-3)
        streams.append(bytes(bench.stream))
    assert len(streams[0]) > 1000
    assert streams[0] == streams[1]


def test_bad_bytes_cost_only_the_frames_they_hit(serial):
    clean = bytes(serial.stream)
    whole, _ = reports_of(clean)
    random = np.random.default_rng(5)
    pieces = clean.split(b"\0")[:-1]
    hit = set(random.choice(np.arange(50, len(pieces)), 12, replace=False).tolist())
    damaged = bytearray()
    for number, piece in enumerate(pieces):
        if number in hit:
            kind = number % 4
            if kind == 0:
                piece = piece[:-3]  # truncated
            elif kind == 1:
                piece = bytes([piece[0] ^ 0x41 or 1]) + piece[1:]
            elif kind == 2:
                piece = bytes(random.integers(1, 256, 40, dtype=np.uint8))  # garbage longer than any frame
            else:
                piece = piece[:5] + bytes([piece[5] ^ 0x10 or 1]) + piece[6:]
        damaged += piece + b"\0"
    received, decoder = reports_of(bytes(damaged))
    assert decoder.bad_crc + decoder.malformed + decoder.overlong == len(hit)
    good = [f for number, p in enumerate(pieces) if number not in hit for f in FrameDecoder().feed(p + b"\0")]
    survivors = list(FrameDecoder().feed(bytes(damaged)))
    assert survivors == good
    assert {r.cycle for r in received} <= {r.cycle for r in whole}


def test_repeated_frames_change_nothing(serial):
    clean = bytes(serial.stream)
    doubled = b"".join(encode_frame(f.identifier, f.data) * 2 for f in FrameDecoder().feed(clean))
    assert fields_of(reports_of(doubled)[0]).keys() == fields_of(reports_of(clean)[0]).keys()
    for cycle, fields in fields_of(reports_of(clean)[0]).items():
        for code, field in fields.items():
            np.testing.assert_array_equal(fields_of(reports_of(doubled)[0])[cycle][code], field)
