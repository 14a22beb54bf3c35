"""Reports of cycles from messages that are lost, repeated, late or garbage."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goldfield.link.reports import CYCLE_MODULUS, Assembler
from goldfield_protocol import Message, decode, encode

NODE = 100
CYCLE_S = 0.1
FIELDS = 4


def messages_of(cycle):
    """A cycle whose every number tells the cycle it belongs to."""
    low, mark = cycle % 16, 1e-9 * (cycle % 5000)
    vector = {"x": mark, "y": mark, "z": mark, "cycle_low": low}
    status = {"cycle_low": low, "chips": 1023, "saturated": cycle % 7, "fields": FIELDS, "locked": 1, "phase": 0}
    status["temperature"] = 20.0
    packed = [
        encode("EPOCH", {"cycle": cycle % CYCLE_MODULUS, "time": cycle * CYCLE_S}, node=NODE),
        encode("EPOCH_STATUS", status, node=NODE),
        encode("EPOCH_OFFSET", vector, node=NODE),
        *(encode("FIELD", vector, node=NODE, index=10 + i) for i in range(FIELDS)),
    ]
    return [decode(*message) for message in packed]


def arrivals(cycles):
    return [((c * 7 + i) * CYCLE_S / 7, m) for c in cycles for i, m in enumerate(messages_of(c))]


def assemble(timed):
    assembler = Assembler()
    reports = []
    for time_s, message in timed:
        reports += assembler.feed(message, time_s)
    return assembler, [*reports, *assembler.flush()]


def assert_unmixed(report, true_cycle):
    mark = 1e-9 * (true_cycle % 5000)
    for vector in report.correlation_T.values():
        np.testing.assert_allclose(vector, mark, atol=1e-12)
    if report.offset_T is not None:
        np.testing.assert_allclose(report.offset_T, mark, atol=1e-12)
    if report.announced is not None:
        assert report.saturated == true_cycle % 7
    if report.has_header:
        assert report.time_s == pytest.approx(true_cycle * CYCLE_S)


def test_a_clean_stream():
    start = CYCLE_MODULUS - 3  # the number wraps on the way
    assembler, reports = assemble(arrivals(range(start, start + 6)))
    assert [r.cycle for r in reports] == [(start + i) % CYCLE_MODULUS for i in range(6)]
    assert all(r.complete and r.lost(99) == 0 for r in reports)
    assert (assembler.late, assembler.repeated, assembler.orphans, assembler.restarts) == (0, 0, 0, 0)


def test_a_complete_report_comes_at_once():
    assembler = Assembler()
    counts = [len(list(assembler.feed(message, t))) for t, message in arrivals(range(3))]
    assert counts == [0, 0, 0, 0, 0, 0, 1] * 3


@settings(max_examples=300)
@given(st.integers(0, CYCLE_MODULUS), st.data())
def test_lost_repeated_and_late_messages_never_mix_cycles(start, data):
    """Messages may be lost, repeated, or come up to a cycle late; what remains is reported once, unmixed."""
    count = 12
    timed = arrivals(range(start, start + count))
    lost = data.draw(st.sets(st.integers(1, len(timed) - 1)))
    delays = data.draw(st.lists(st.integers(0, 6), min_size=len(timed), max_size=len(timed)))
    repeats = data.draw(st.sets(st.integers(0, len(timed) - 1)))
    order = sorted((index + delay, index) for index, delay in enumerate(delays) if index > 0)
    kept = [(0, 0)] + [(place, index) for place, index in order if index not in lost]
    doubled = [entry for entry in kept for _ in range(1 + (entry[1] in repeats))]
    assembler, reports = assemble(
        [(start * CYCLE_S + place * CYCLE_S / 7, timed[index][1]) for place, index in doubled]
    )

    arrived = {}
    for _, index in kept:
        arrived.setdefault(start + index // 7, set()).add(index % 7)
    true_cycles = [start + (r.cycle - start) % CYCLE_MODULUS for r in reports]
    assert true_cycles == sorted(set(true_cycles))
    for report, cycle in zip(reports, true_cycles, strict=True):
        assert_unmixed(report, cycle)
    got = sum(
        r.has_header + (r.announced is not None) + (r.offset_T is not None) + len(r.correlation_T) for r in reports
    )
    longest_gap = max([b - a for a, b in zip(sorted(arrived), sorted(arrived)[1:], strict=False)], default=0)
    if longest_gap <= 6:
        # Nothing that arrived is missing from the reports, and each cycle up to the last has one.
        assert got == len(kept)
        assert true_cycles == list(range(start, max(arrived) + 1))
        assert all(
            r.lost(FIELDS) >= 7 - len(arrived.get(c, ())) - (r.announced is None) * FIELDS
            for r, c in zip(reports, true_cycles, strict=True)
        )
        assert assembler.repeated + assembler.late == len(doubled) - len(kept)
    else:
        assert got <= len(kept)


@given(st.lists(st.tuples(st.integers(0, (1 << 29) - 1), st.binary(min_size=8, max_size=8)), max_size=60))
def test_garbage_that_passes_every_check_raises_nothing(frames):
    decoded = [decode(identifier, data) for identifier, data in frames if identifier >> 24 != 0x0E]
    timed = arrivals(range(2)) + [(0.2 + i * 1e-3, m) for i, m in enumerate(decoded) if m is not None]
    _, reports = assemble(timed)
    assert [r.cycle for r in reports[:2]] == [0, 1]


def test_lost_messages_are_counted_with_and_without_the_sensors_own_word():
    timed = arrivals([5])
    _, (no_fields,) = assemble(timed[:4])
    assert no_fields.lost(expected_fields=0) == FIELDS - 1
    _, (no_status,) = assemble(timed[:1] + timed[2:4])
    assert no_status.lost(expected_fields=FIELDS) == 1 + FIELDS - 1


def test_a_lost_cycle_is_handed_out_empty():
    _, reports = assemble(arrivals([3, 4, 6, 7]))
    assert [(r.cycle, r.complete) for r in reports] == [(3, True), (4, True), (5, False), (6, True), (7, True)]
    assert reports[2].lost(FIELDS) == 3 + FIELDS
    assert math.isnan(reports[2].time_s)


@pytest.mark.parametrize("gap", range(1, 8))
def test_a_gap_that_ends_without_a_header_is_counted_by_the_low_bits(gap):
    _, reports = assemble(arrivals([13]) + arrivals([13 + gap])[1:])
    assert [r.cycle for r in reports] == list(range(13, 14 + gap))
    assert_unmixed(reports[-1], 13 + gap)
    assert (reports[-1].has_header, len(reports[-1].correlation_T)) == (False, FIELDS)


def test_a_long_gap_is_counted_and_a_jump_is_a_restart():
    assembler, reports = assemble(arrivals([3, 4, 60, 61]))
    assert [r.cycle for r in reports] == [3, 4, 60, 61]
    assert (assembler.missed_cycles, assembler.restarts) == (55, 0)
    assembler, reports = assemble(arrivals([3000, 3001]) + [(400.0 + t, m) for t, m in arrivals([0, 1])])
    assert [r.cycle for r in reports] == [3000, 3001, 0, 1]
    assert (assembler.missed_cycles, assembler.restarts) == (0, 1)


def test_a_silence_of_sixteen_cycles_without_a_header_joins_nothing():
    timed = arrivals([3]) + arrivals([20])[1:]
    timed[6:7] = []  # cycle 3 lacks a field, and cycle 19's low bits are those of 3
    late = arrivals([19])[1:]
    assembler, reports = assemble(timed[:6] + late)
    assert len(reports) == 1
    assert_unmixed(reports[0], 3)
    assert assembler.orphans == len(late)


@pytest.mark.parametrize("cut", range(7))
def test_a_pause_of_the_reader_costs_no_cycle(cut):
    """A process that was stopped for 30 s, or a clock that was set forward: the arrivals jump, the sensor does not."""
    timed = arrivals(range(3, 9))
    at = 2 * 7 + cut
    delayed = timed[:at] + [(time_s + 30.0, message) for time_s, message in timed[at:]]
    assembler, reports = assemble(delayed)
    assert [r.cycle for r in reports] == list(range(3, 9))
    assert all(r.complete for r in reports)
    for report in reports:
        assert_unmixed(report, report.cycle)
    assert (assembler.orphans, assembler.late, assembler.restarts, assembler.missed_cycles) == (0, 0, 0, 0)


def test_a_sensor_that_restarts_behind_a_silence_begins_anew():
    """Its number is the next one by chance, but its clock has gone back."""
    first, second = arrivals(range(3)), arrivals(range(3, 5))
    again = [(t + 9.0, m) for t, m in second]
    again = [
        (
            t,
            decode(*encode("EPOCH", {"cycle": m.signals["cycle"], "time": 0.05}, node=NODE))
            if m.name == "EPOCH"
            else m,
        )
        for t, m in again
    ]
    assembler, reports = assemble([*first, *again])
    assert [r.cycle for r in reports] == [0, 1, 2, 3, 4]
    assert assembler.orphans == 0
    late = [(t + 9.0, m) for t, m in first[15:]]  # fields of the cycle before, which nobody can tell from its own
    assembler, reports = assemble([*first[:15], *late, *again])
    assert assembler.orphans == len(late)


def test_messages_before_the_first_header_are_orphans():
    assembler, reports = assemble(arrivals([8])[3:] + arrivals([9]))
    assert [r.cycle for r in reports] == [9]
    assert assembler.orphans == 4


def test_an_axis_out_of_range_is_not_a_number():
    limit = {"x": -524288e-10, "y": 524287e-10, "z": 0.0, "cycle_low": 1}
    timed = [(0.1, decode(*encode("EPOCH", {"cycle": 1, "time": 0.1}, node=NODE)))]
    timed += [(0.1, decode(*encode("FIELD", limit, node=NODE, index=2)))]
    wide = {"x": 524287e-9, "y": -524288e-9, "z": -524287e-9, "cycle_low": 1}
    timed += [(0.1, decode(*encode("EPOCH_OFFSET", wide, node=NODE)))]
    _, (report,) = assemble(timed)
    assert np.isnan(report.correlation_T[2]).tolist() == [True, False, False]
    assert report.offset_T is not None
    assert np.isnan(report.offset_T).tolist() == [False, True, False]


def test_other_messages_are_ignored():
    assembler = Assembler()
    assert list(assembler.feed(Message("HEARTBEAT", NODE, 0, {}), 0.0)) == []
