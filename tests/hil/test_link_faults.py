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


def reports_of_can(frames):
    """Assemble what was on the CAN bus."""
    messages = [decode(frame.identifier, frame.data) for frame in frames]
    assembler = Assembler()
    own = [message for message in messages if message is not None and message.node == SENSOR]
    return [report for message in own for report in assembler.feed(message, 0.0)]


@pytest.fixture(scope="module")
def stream(recorded):
    """Every serial byte of the sensor."""
    return bytes(recorded.bench.stream)


def test_can_tells_the_same(recorded):
    by_can = fields_of(reports_of_can(recorded.can_frames))
    by_serial = fields_of(recorded.reports)
    common = sorted(by_can.keys() & by_serial.keys())
    assert len(common) >= len(by_serial) - 1
    for cycle in common:
        assert by_can[cycle].keys() == by_serial[cycle].keys()
        for code, field in by_can[cycle].items():
            np.testing.assert_array_equal(field, by_serial[cycle][code])


def test_a_bench_that_is_read_on_can(open_bench):
    reports = open_bench("patent3", link="can", boards="host").reports(3)
    assert [report.cycle - reports[0].cycle for report in reports] == [0, 1, 2]
    assert all(report.complete and report.locked for report in reports)


@pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too
def test_same_seed_same_bytes_in_any_slices(open_bench, recorded):
    bench = open_bench("prigge8")
    for _ in range(600):
        bench.advance(1e-3)
    assert len(bench.stream) > 1000
    assert recorded.bench.stream.startswith(bench.stream)


def test_bad_bytes_cost_only_the_frames_they_hit(stream):
    whole, _ = reports_of(stream)
    random = np.random.default_rng(5)
    pieces = stream.split(b"\0")[:-1]
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


def test_repeated_frames_change_nothing(stream):
    doubled = b"".join(encode_frame(f.identifier, f.data) * 2 for f in FrameDecoder().feed(stream))
    once, twice = (fields_of(reports_of(sent)[0]) for sent in (stream, doubled))
    assert twice.keys() == once.keys()
    for cycle, fields in once.items():
        for code, field in fields.items():
            np.testing.assert_array_equal(twice[cycle][code], field)
