"""The CAN bus: frame lengths against an independent count, arbitration, acknowledgement, abort."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hil_sim import clib

BIT = 10**6


@pytest.fixture(scope="module")
def lib():
    return clib.load("build/libgf_rig.so", ["rig/can_bus.h"])


def frame(lib, identifier, data=b"", *, extended=True, remote=False, length=None):
    count = len(data) if length is None else length
    values = {"id": identifier, "extended": extended, "remote": remote, "length": count, "data": list(data)}
    return lib[0].new("board_frame_t *", values)


# ---- An independent frame: strings of '0' and '1', CRC by polynomial division, stuffing by regular expression ----


def arbitration_bits(identifier, extended, remote):
    if extended:
        bits = f"{identifier:029b}"
        return bits[:11] + "11" + bits[11:] + "01"[remote]
    return f"{identifier:011b}" + "01"[remote] + "0"


def crc15(bits):
    remainder, polynomial = int(bits + "0" * 15, 2), 0b1100010110011001
    for shift in range(len(bits) - 1, -1, -1):
        if remainder >> (shift + 15) & 1:
            remainder ^= polynomial << shift
    return f"{remainder:015b}"


def stuffed(bits):
    done, rest = "", bits
    while match := re.search(r"00000|11111", rest):
        done += rest[: match.end()]
        inserted = "1" if match[0][0] == "0" else "0"
        rest = inserted + rest[match.end() :]
    return done + rest


def brute_force_bits(identifier, data, extended, remote):
    control = ("00" if extended else "0") + f"{len(data):04b}"
    payload = "" if remote else "".join(f"{byte:08b}" for byte in data)
    head = "0" + arbitration_bits(identifier, extended, remote) + control + payload
    return len(stuffed(head + crc15(head))) + 1 + 2 + 7


def test_independent_crc_has_its_check_value():
    # CRC-15/CAN of "123456789" in the catalogue of parametrised CRC algorithms: 0x059e
    assert int(crc15("".join(f"{byte:08b}" for byte in b"123456789")), 2) == 0x059E


def test_frame_lengths(lib):
    random = np.random.default_rng(8)
    lengths = set()
    for trial in range(600):
        extended, remote = bool(random.integers(2)), bool(random.integers(8) == 0)
        identifier = int(random.integers(1 << (29 if extended else 11))) & (-1 << int(random.integers(12)))
        data = random.bytes(int(random.integers(9))) if trial % 2 else bytes([random.choice([0, 255])]) * 8
        got = lib[1].can_frame_bits(frame(lib, identifier, data, extended=extended, remote=remote))
        assert got == brute_force_bits(identifier, data, extended, remote)
        lengths.add(got)
        assert got >= (lib[1].CAN_SHORTEST_EXTENDED_BITS if extended else 44)
    assert max(lengths) > 140


def test_arbitration_key_orders_as_the_wire_does(lib):
    random = np.random.default_rng(9)
    frames = []
    for _ in range(300):
        extended, remote = bool(random.integers(2)), bool(random.integers(2))
        base = int(random.integers(4))
        identifier = (base << 18 | int(random.integers(4))) if extended else base
        bits = arbitration_bits(identifier, extended, remote)
        frames.append((bits, lib[1].can_arbitration_key(frame(lib, identifier, extended=extended, remote=remote))))
    by_key = [bits for bits, key in sorted(frames, key=lambda item: item[1])]
    # Dominant is 0: bit by bit the smaller string goes on.
    assert by_key == sorted(by_key)


class Bus:
    def __init__(self, lib, nodes=4):
        self.lib = lib
        ffi, library = lib
        self.bus = ffi.gc(library.can_bus_create(nodes, 1_000_000), library.can_bus_destroy)
        for node in range(nodes):
            library.can_bus_join(self.bus, node, 0)
        self.seen = []
        self.valid_ps = []

        @ffi.callback("can_deliver_t")
        def deliver(_, transfer):
            self.valid_ps.append(transfer.valid_ps)
            self.seen.append(
                (transfer.node, transfer.frame.id, transfer.start_ps, transfer.end_ps, bool(transfer.acknowledged))
            )

        self.deliver = deliver

    def request(self, node, identifier, time_ps, data=b"\1\2\3", mailbox=0):
        self.lib[1].can_bus_request(self.bus, node, mailbox, frame(self.lib, identifier, data), time_ps)
        return brute_force_bits(identifier, data, True, False) * BIT

    def run(self, until_ps):
        self.lib[1].can_bus_run(self.bus, until_ps, self.deliver, self.lib[0].NULL)


def test_the_lower_identifier_wins_and_frames_keep_their_distance(lib):
    bus = Bus(lib)
    first = bus.request(0, 0x500, 0)
    later = {0x300: bus.request(1, 0x300, 5 * BIT), 0x100: bus.request(2, 0x100, 9 * BIT)}
    later[0x200] = bus.request(3, 0x200, 20 * BIT)
    bus.run(10**12)
    assert [identifier for _, identifier, *_ in bus.seen] == [0x500, 0x100, 0x200, 0x300]
    assert bus.seen[0][2:4] == (0, first)
    for before, after in zip(bus.seen, bus.seen[1:], strict=False):
        assert after[2] == before[3] + 3 * BIT
        assert after[3] - after[2] == later[after[1]]


def test_receivers_have_a_frame_one_bit_before_its_sender(lib):
    """CAN 2.0, message validation: no error up to the last but one bit of end of frame; for the sender, its end."""
    bus = Bus(lib)
    ends = [bus.request(0, 0x500, 0), bus.request(1, 0x7FF, 1, data=b"")]
    bus.run(10**12)
    assert bus.valid_ps[0] == ends[0] - BIT
    assert bus.valid_ps[1] == ends[0] + 3 * BIT + ends[1] - BIT


def test_a_frame_waits_for_nobody_when_the_bus_is_idle(lib):
    bus = Bus(lib)
    bus.request(0, 0x500, 1234)
    bus.request(1, 0x100, 1235)
    bus.run(1234)
    assert bus.seen == []
    bus.run(1235)
    assert [(node, start) for node, _, start, *_ in bus.seen] == [(0, 1234)]


def test_in_slices_as_in_one_piece(lib):
    random = np.random.default_rng(4)
    wishes = sorted(
        (int(random.integers(10**10)), int(random.integers(4)), int(random.integers(1 << 29))) for _ in range(60)
    )
    whole, sliced = Bus(lib), Bus(lib)
    for time_ps, node, identifier in wishes:
        whole.request(node, identifier, time_ps)
    whole.run(10**11)
    pending = list(wishes)
    for until in range(0, 10**11, 17 * BIT):
        while pending and pending[0][0] < until:
            time_ps, node, identifier = pending.pop(0)
            sliced.request(node, identifier, time_ps)
        sliced.run(until)
        if not pending and len(sliced.seen) == len(wishes):
            break
    assert whole.seen == sliced.seen
    assert len(whole.seen) == 60


def test_alone_on_the_bus_is_an_error(lib):
    bus = Bus(lib, nodes=1)
    bits = bus.request(0, 0x123, 0)
    bus.request(0, 0x124, 0, mailbox=1)
    bus.run(10**12)
    # Acknowledged: ..., slot, delimiter, 7 bits. Not: ..., slot, 6 bits of error flag, 8 of delimiter.
    # Then the same 3 bits of silence.
    assert bus.seen[0][3:] == (bits + (14 - 8) * BIT, False)
    assert bus.seen[1][2] == bus.seen[0][3] + 3 * BIT


def test_a_node_acknowledges_only_once_it_is_there(lib):
    bus = Bus(lib, nodes=2)
    lib[1].can_bus_join(bus.bus, 1, 10**9)
    bus.request(0, 0x123, 0)
    bus.request(0, 0x123, 2 * 10**9)
    bus.run(10**12)
    assert [ok for *_, ok in bus.seen] == [False, True]


def test_abort_before_the_frame_starts_and_after(lib):
    bus = Bus(lib)
    bus.request(0, 0x100, 0)
    bus.request(1, 0x200, 5 * BIT)
    lib[1].can_bus_abort(bus.bus, 0, 0, 5 * BIT)  # its frame is on the wire: goes on
    lib[1].can_bus_abort(bus.bus, 1, 0, 9 * BIT)
    bus.request(1, 0x300, 10 * BIT)  # the same mailbox, again
    bus.run(10**12)
    assert [identifier for _, identifier, *_ in bus.seen] == [0x100, 0x300]


def test_collisions_are_counted(lib):
    bus = Bus(lib)
    bus.request(2, 0x100, 0)
    bus.request(1, 0x100, 0)
    bus.run(10**12)
    statistics = lib[0].new("can_statistics_t *")
    lib[1].can_bus_statistics(bus.bus, statistics)
    assert statistics.collisions == 1
    assert [node for node, *_ in bus.seen] == [1, 2]


def test_equal_identifiers_of_one_node_go_by_mailbox(lib):
    """RM0090 32.7.1: if the identifier values are equal, the lower mailbox number is scheduled first."""
    bus = Bus(lib)
    bus.request(0, 0x50, 0)
    long, short = (frame(lib, 0x100, data) for data in (b"12345678", b""))
    lib[1].can_bus_request(bus.bus, 0, 2, long, BIT)
    lib[1].can_bus_request(bus.bus, 0, 1, short, 2 * BIT)
    bus.run(10**12)
    assert [end - start for _, _, start, end, _ in bus.seen[1:]] == [
        BIT * lib[1].can_frame_bits(sent) for sent in (short, long)
    ]


# ---- Bit errors and delay ----


def test_a_corrupted_frame_ends_with_an_error_flag(lib):
    bus = Bus(lib)
    bits = bus.request(0, 0x500, 0) // BIT
    bus.request(1, 0x600, 10)
    lib[1].can_bus_corrupt(bus.bus, 1)
    bus.run(10**12)
    wrong = max(50, bits // 2)
    assert bus.seen[0] == (0, 0x500, 0, (wrong + 14) * BIT, False)
    assert bus.seen[1][:3] == (1, 0x600, (wrong + 14 + 3) * BIT)
    assert bus.seen[1][4]
    statistics = lib[0].new("can_statistics_t *")
    lib[1].can_bus_statistics(bus.bus, statistics)
    assert (statistics.errors, statistics.unacknowledged, statistics.frames) == (1, 0, 2)


@pytest.mark.parametrize("probability", [1e-3, 1e-2])
def test_bit_errors_come_at_their_rate_and_follow_their_seed(lib, probability):
    runs = []
    for seed in (1, 1, 2):
        bus = Bus(lib)
        lib[1].can_bus_errors(bus.bus, probability, seed)
        for turn in range(2000):
            bits = bus.request(0, 0x500, turn * 10**9) // BIT
            bus.run((turn + 1) * 10**9)
        runs.append([ended[4] for ended in bus.seen])
    assert runs[0] == runs[1] != runs[2]
    expected = 2000 * (1 - (1 - probability) ** bits)
    assert abs(runs[0].count(False) - expected) < 4 * np.sqrt(expected)


def test_no_errors_unless_asked_for(lib):
    bus = Bus(lib)
    for turn in range(200):
        bus.request(0, 0x500, turn * 10**9)
    bus.run(10**12)
    assert all(ended[4] for ended in bus.seen)


def test_transceivers_delay_receivers_and_not_the_sender(lib):
    bus = Bus(lib)
    lib[1].can_bus_delay(bus.bus, 250_000)
    end = bus.request(0, 0x500, 0)
    bus.run(10**12)
    assert bus.valid_ps == [end - BIT + 250_000]
    assert bus.seen[0][3] == end
