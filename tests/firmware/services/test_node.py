"""What the applications share: parameters on both links, heartbeat, counters, loss."""

from __future__ import annotations

from collections.abc import Iterator
from random import Random

import pytest

from goldfield_protocol import FrameDecoder, Identifier, Message, decode, encode, encode_frame, protocol_hash
from goldfield_protocol.messages import shapes
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES
from tests.firmware.host_rig import (
    ANCHOR,
    BEACON,
    MS,
    PIN_ENABLE,
    PIN_LED,
    SECOND,
    SENSOR,
    US,
    Board,
    Coil,
    Rig,
    beacon,
)

OK, UNKNOWN, OUT_OF_RANGE, WRONG_KIND = range(4)
INTERNAL, SLOW = 1, 2


@pytest.fixture(params=[BEACON, SENSOR, ANCHOR])
def board(request: pytest.FixtureRequest) -> Iterator[Board]:
    made = Board(request.param, {"node": 9})
    yield made
    made.close()


def set_value(value: float | int) -> dict[str, float]:
    if isinstance(value, float):
        return {"kind": 2, "value_float": value}
    return {"kind": 0, "value_unsigned": value}


def answers(board: Board) -> list[tuple[int, int, float, float]]:
    """Sender, parameter, status, value."""
    return [
        (m.node, m.index, m.signals["status"], next(v for k, v in m.signals.items() if k.startswith("value")))
        for m in board.messages("PARAM_VALUE")
    ]


def test_heartbeat_every_second_with_hash_and_version(board: Board) -> None:
    board.run(3500 * MS)
    beats = board.messages("HEARTBEAT")
    assert len(beats) == 4
    assert {m.signals["protocol_hash"] for m in beats} == {protocol_hash()}
    assert {(m.node, m.signals["version_major"], m.signals["version_minor"]) for m in beats} == {(9, 0, 1)}
    assert {m.signals["errors"] for m in beats} == {0}


def test_nothing_precedes_the_first_heartbeat(board: Board) -> None:
    board.run(100 * MS)
    assert board.messages()[0].name == "HEARTBEAT"
    assert board.can_messages()[0].name == "HEARTBEAT"


def test_a_frame_that_the_reset_tore_does_not_take_the_first_heartbeat_with_it(board: Board) -> None:
    board.run(100 * MS)
    torn = encode_frame(1 << 24 | 9, bytes(8))[:-5]
    first = next(FrameDecoder().feed(torn + bytes(byte for _, byte in board.serial)))
    heartbeat = decode(first.identifier, first.data)
    assert heartbeat is not None
    assert heartbeat.name == "HEARTBEAT"


@pytest.mark.parametrize(
    ("index", "value", "status", "in_force"),
    [
        (1, 55, OK, 55),
        (2, 3.5, OK, 3.5),
        (1, 2049, OUT_OF_RANGE, 0),
        (2, 99.0, OUT_OF_RANGE, 0.0),
        (2, 3, WRONG_KIND, 0.0),
        (9, 1000.0, OK, 1000.0),
        (16, float("nan"), OUT_OF_RANGE, None),
        (300, 1022, OK, 1022),
        (200, 1, UNKNOWN, 0),
    ],
)
def test_set_is_answered_with_the_value_in_force(
    board: Board, index: int, value: float | int, status: int, in_force: float | None
) -> None:
    board.send_serial("PARAM_SET", set_value(value), 9, index, MS)
    board.run(20 * MS)
    [(node, number, answer, now)] = answers(board)
    assert (node, number, answer) == (9, index, status)
    if in_force is not None:
        assert now == pytest.approx(in_force)
    board.send_serial("PARAM_GET", {"reserved": 0}, 9, index, 30 * MS)
    board.run(50 * MS)
    assert answers(board)[1][3] == now
    assert answers(board)[1][2] == (UNKNOWN if status == UNKNOWN else OK)


def test_node_zero_addresses_all_and_others_are_ignored(board: Board) -> None:
    board.send_serial("PARAM_GET", {"reserved": 0}, 0, 0, MS)
    board.send_serial("PARAM_GET", {"reserved": 0}, 8, 0, 2 * MS)
    board.run(20 * MS)
    assert answers(board) == [(9, 0, OK, 9)]


def test_answer_to_a_new_number_comes_from_the_old(board: Board) -> None:
    board.send_serial("PARAM_SET", set_value(12), 9, 0, MS)
    board.send_serial("PARAM_GET", {"reserved": 0}, 12, 0, 10 * MS)
    board.run(20 * MS)
    assert answers(board) == [(9, 0, OK, 12), (12, 0, OK, 12)]


def test_answer_goes_to_the_link_it_came_from(board: Board) -> None:
    board.can_in(*encode("PARAM_GET", {"reserved": 0}, node=9, index=0), 3 * MS)
    Rig(board).run(20 * MS)
    assert not board.messages("PARAM_VALUE")
    assert [(m.node, m.index, m.signals["value_unsigned"]) for m in board.can_messages("PARAM_VALUE")] == [(9, 0, 9)]


def counters(board: Board) -> dict[int, float]:
    return {m.index: m.signals["value"] for m in board.messages("COUNTER")}


@pytest.mark.parametrize("link", ["serial", "CAN"])
def test_frames_of_others_are_ignored_and_counted(board: Board, link: str) -> None:
    """Every type but HEARTBEAT's with every wrong length, and with a foreign index; the board keeps its parameters."""

    def put(identifier: int, data: bytes, time: int) -> None:
        if link == "serial":
            board.receive(encode_frame(identifier, data), time)
        else:
            board.can_in(identifier, data, time)

    time, lengths, indices = 2 * MS, 0, 0
    for type_ in range(32):
        for length in range(9):
            good = type_ in shapes() and shapes()[type_].length == length
            if not good:
                put(Identifier(type_, 0, 9).pack(), bytes([0, *range(length)][:length]), time)
                lengths += type_ in shapes()
                indices += type_ not in shapes()
                time += MS
        if type_ in shapes() and shapes()[type_].largest_index < 4095:
            put(Identifier(type_, 4095, 9).pack(), bytes(shapes()[type_].length), time)
            indices += 1
            time += MS
    put(0x0C000009, bytes.fromhex("0055000000FFFFFF"), time)  # J1939's TSC1: the board is not to become node 85
    Rig(board).run(1100 * MS)
    assert not board.messages("PARAM_VALUE")
    assert {m.node for m in board.messages()} == {9}
    assert counters(board) == {15: indices, 16: lengths + 1}


def test_damaged_bytes_cost_their_frame_and_are_counted(board: Board) -> None:
    good = encode_frame(*encode("PARAM_GET", {"reserved": 0}, node=9, index=0))
    bad = bytes([*good[:4], good[4] ^ 0x40, *good[5:]])
    random = Random(3)
    garbage = bytes(random.randrange(1, 256) for _ in range(40))
    board.receive(good + bad + garbage + b"\0" + good, MS)
    board.run(1100 * MS)
    assert len(answers(board)) == 2
    assert counters(board) == {0: 2}
    assert board.messages("HEARTBEAT")[-1].signals["errors"] == 2


def test_bytes_at_another_rate_are_lost_and_counted(board: Board) -> None:
    board.receive(b"abc", MS, baud=115_200)
    board.run(1100 * MS)
    assert counters(board) == {1: 3}


def test_bad_page_is_ignored_and_counted() -> None:
    page = bytearray(b"GFP1\x01\x00\x00\x00" + b"\0" * 8)
    board = Board(BEACON, bytes(page))
    board.run(1100 * MS)
    assert counters(board) == {9: 1}
    board.close()


def test_full_can_queue_counts_what_it_loses() -> None:
    """64 codes a cycle, a bus that takes a frame in 2 ms, for 2 s; then the backlog drains: each loss is counted.

    Reports come whole or not at all: what the queue refused is 67 messages for each cycle of counter 13.
    """
    parameters = {"node": 9, "code_count": 64, "code_list": list(range(64))}
    board = Board(SENSOR, parameters)
    board.send_serial("PARAM_SET", set_value(0), 9, 5, 2 * SECOND)
    done = 0
    for step in range(1, 3100):
        board.run(step * MS)
        if len(board.requests) > done and (step % 2 == 0 or step > 2000):
            board.can_sent(board.requests[done][1], True, step * MS)
            done += 1
    answered_on_serial_only = {"PARAM_VALUE"}
    serial = [m for m in board.messages() if m.name not in answered_on_serial_only]
    can = board.can_messages()
    counted = counters(board)
    board.close()
    assert counted[13] >= 3
    assert len(serial) == len(can) + 67 * counted[13] + counted.get(4, 0)
    assert counted.get(4, 0) < 10
    assert in_order(can, serial)


@pytest.mark.parametrize("rate", [0, 3])
@pytest.mark.parametrize("heard", [True, False])
def test_what_a_full_bus_does_not_take_is_counted_and_what_a_dead_one_does_not_is_not(heard: bool, rate: int) -> None:
    """The bus takes nothing of a sensor; it is full of others' frames, or nobody is there."""
    parameters = {"node": 9, "code_count": 4, "code_list": [2, 3, 4, 5], "can_rate": rate}
    board = Board(SENSOR, parameters)
    board.operations.can_rate(board.handle, CAN_RATES[rate])
    identifier, data = encode("FIELD", {"x": 0, "y": 0, "z": 0, "cycle_low": 1}, node=8, index=2)
    for step in range(1, 2100, 10):
        if heard:
            board.can_in(identifier, data, step * MS)
        board.run(step * MS)
    counted = counters(board)
    fields = len(board.messages("FIELD"))
    board.close()
    assert fields > 60
    assert (counted.get(4, 0) > 0) is heard
    assert not board.can_messages("EPOCH")


@pytest.mark.parametrize("role", [BEACON, SENSOR, ANCHOR])
@pytest.mark.parametrize("clock", [INTERNAL, SLOW])
def test_clock_fallback_is_told_and_drives_nothing(role: int, clock: int) -> None:
    parameters = {"node": 9, "amplitude": 5.0, "sync_master": 1}
    board = Board(role, parameters, ppm=9000.0, clock=clock)
    board.send_serial("PARAM_GET", {"reserved": 0}, 9, 0, MS)
    board.run(1100 * MS)
    assert board.messages("HEARTBEAT")[-1].signals["state"] == 5
    assert counters(board) == {7: 1}
    assert answers(board) == [(9, 0, OK, 9)]
    assert not board.edges(PIN_ENABLE)
    assert bool(board.messages("EPOCH")) == (role != BEACON and clock == INTERNAL)
    board.close()


def in_order(part: list[Message], whole: list[Message]) -> bool:
    """Is the part what remains of the whole after leaving some out?"""
    rest = iter(whole)
    return all(message in rest for message in part)


def test_frames_leave_one_mailbox_after_the_other_and_are_repeated_on_error() -> None:
    board = Board(BEACON, {"node": 9})
    board.run(10 * MS)
    [(_, mailbox, identifier, data)] = board.requests
    board.can_sent(mailbox, False, 11 * MS)
    board.run(12 * MS)
    assert [r[1:] for r in board.requests] == [(mailbox, identifier, data)] * 2
    board.can_sent(mailbox, True, 13 * MS + US)
    board.run(150 * MS)
    assert board.requests[2][0] == pytest.approx(13 * MS + US, abs=6000)
    board.can_sent((mailbox + 1) % 3, True, 151 * MS)
    board.run(SECOND + 100 * MS)
    assert counters(board) == {2: 1}
    board.close()


IDENTITY, BLINK, RESET, LAST_RESET = 0, 1, 2, 4
UNIQUE = bytes(range(12))
"""Unique id of the boards of these tests."""
NAMED = int.from_bytes(UNIQUE[:6], "little") ^ int.from_bytes(UNIQUE[6:], "little")


def command(
    board: Board, index: int, *, named: int = 0, argument: int = 0, node: int = 9, time: int = 100 * MS
) -> None:
    board.send_serial("COMMAND", {"board": named, "argument": argument}, node, index, time)


def statuses(board: Board) -> list[tuple[int, float]]:
    return [(m.index, m.signals["status"]) for m in board.messages("COMMAND_ANSWER")]


@pytest.mark.parametrize(("named", "told"), [(0, 2), (NAMED, 2), (NAMED + 1, 0)])
def test_a_board_tells_its_unique_id_unless_another_is_meant(board: Board, named: int, told: int) -> None:
    board.run(100 * MS)
    command(board, IDENTITY, named=named, node=0)
    board.run(200 * MS)
    halves = {m.index: m.signals for m in board.messages("IDENTITY")}
    assert len(halves) == told
    if told:
        whole = b"".join(int(halves[i]["half"]).to_bytes(6, "little") for i in (0, 1))
        assert whole == UNIQUE
        assert {int(half["tag"]) for half in halves.values()} == {NAMED & 0xFFFF}


def test_a_board_blinks_for_the_time_that_it_was_told(board: Board) -> None:
    board.run(100 * MS)
    before = len(board.edges(PIN_LED))
    command(board, BLINK, argument=2)
    board.run(4 * SECOND)
    on, off = (board.edges(PIN_LED, level) for level in (True, False))
    assert len(on) - before in (8, 9)
    assert 2 * SECOND < max(*on, *off) < 2 * SECOND + 200 * MS
    assert board.level[PIN_LED] is True
    assert statuses(board) == [(BLINK, OK)]


def test_blinking_stops_at_once(board: Board) -> None:
    board.run(100 * MS)
    command(board, BLINK, argument=60)
    command(board, BLINK, argument=0, time=500 * MS)
    board.run(2 * SECOND)
    assert max(board.edges(PIN_LED, False)) < 600 * MS
    assert board.level[PIN_LED] is True


@pytest.mark.parametrize(
    ("named", "node", "answer"), [(NAMED, 9, [(RESET, OK)]), (0, 9, [(RESET, 2)]), (NAMED, 0, [(RESET, 2)])]
)
def test_a_reset_must_name_its_board(board: Board, named: int, node: int, answer: list[tuple[int, int]]) -> None:
    board.run(1100 * MS)
    command(board, RESET, named=named, node=node, time=1100 * MS)
    board.run(1500 * MS)
    assert statuses(board) == answer
    states = [m.signals["state"] for m in board.messages("HEARTBEAT")]
    assert states.count(0) - 1 == (answer == [(RESET, OK)])
    board.run(3 * SECOND)
    assert board.can_messages("HEARTBEAT")[-1].node == 9


@pytest.mark.parametrize(
    ("rates", "ms"),
    [
        ({}, 50),
        ({"can_rate": 1}, 100),
        ({"can_rate": 3}, 400),
        ({"serial_rate": 1}, 50),
        ({"serial_rate": 2}, 100),
        ({"serial_rate": 3}, 400),
    ],
)
def test_a_reset_comes_when_the_slower_link_has_told_the_answer(rates: dict[str, int], ms: int) -> None:
    board = Board(SENSOR, {"node": 9, "pose": 0, **rates})
    can_bit_s, baud = CAN_RATES[rates.get("can_rate", 0)], SERIAL_RATES[rates.get("serial_rate", 0)]
    board.operations.can_rate(board.handle, can_bit_s)
    board.run(105 * MS)
    identifier, data = encode("COMMAND", {"board": NAMED, "argument": 0}, node=9, index=RESET)
    board.receive(encode_frame(identifier, data), 105 * MS, baud)
    board.run(700 * MS)
    off = board.edges(PIN_LED, False)[-1]
    heard = 105 * MS + 10 * SECOND * len(encode_frame(identifier, data)) // baud
    assert ms * MS <= off - heard < (ms + 4) * MS
    assert statuses(board) == [(RESET, OK)]
    board.close()


def test_a_command_for_another_board_and_one_of_the_wrong_length_are_ignored(board: Board) -> None:
    board.run(100 * MS)
    command(board, RESET, named=NAMED + 1)
    identifier, _ = encode("COMMAND", {"board": NAMED, "argument": 0}, node=9, index=RESET)
    board.receive(encode_frame(identifier, NAMED.to_bytes(6, "little")), 150 * MS)
    board.run(500 * MS)
    assert statuses(board) == []
    command(board, 100, time=500 * MS)
    board.run(600 * MS)
    assert statuses(board) == [(100, 1)]


def reset_reports(messages: list[Message]) -> list[tuple[int, dict[str, float]]]:
    """Index and signals that are not 0."""
    return [(m.index, {k: v for k, v in m.signals.items() if v}) for m in messages]


def test_a_board_tells_after_its_start_and_when_asked_why_it_started(board: Board) -> None:
    begun = [(0, {}), (1, {"item": 1, "resets_power_on": 1})]
    Rig(board).run(100 * MS)
    assert reset_reports(board.messages("RESET_REPORT")) == begun
    assert reset_reports(board.can_messages("RESET_REPORT")) == begun
    assert board.messages()[0].name == board.can_messages()[0].name == "HEARTBEAT"
    command(board, LAST_RESET, node=0, time=100 * MS)
    board.run(2100 * MS)
    assert reset_reports(board.messages("RESET_REPORT")) == begun * 2
    command(board, RESET, named=NAMED, time=2100 * MS)
    board.run(2300 * MS)
    assert reset_reports(board.messages("RESET_REPORT"))[4:] == [
        (0, {"cause": 3, "uptime": 2}),
        (1, {"item": 1, "resets_power_on": 1, "resets_software": 1}),
    ]
    assert statuses(board) == [(RESET, OK)]


@pytest.mark.parametrize("emulated", [False, True])
def test_a_beacon_that_drives_its_coil_resets_with_the_bridge_off(emulated: bool) -> None:
    page = {"node": 9, "code": 2, "amplitude": 5.0, "sync_master": 1}
    board = beacon(Coil(), parameters=page, emulated=emulated)
    try:
        board.run(2 * SECOND)
        assert board.level[PIN_ENABLE]
        command(board, RESET, named=NAMED, time=2 * SECOND)
        board.run(2 * SECOND + 100 * MS)
        off = [time for time in board.edges(PIN_ENABLE, False) if time > 2 * SECOND]
        assert 50 * MS < off[0] - 2 * SECOND < 60 * MS  # the answer goes out first
        starts = [time for time in board.edges(PIN_LED) if time > 2 * SECOND]
        assert off[0] <= starts[0]
        on = [time for time in board.edges(PIN_ENABLE) if time > 2 * SECOND]
        assert all(time > starts[0] for time in on)
        assert statuses(board) == [(RESET, OK)]
        assert [m.signals["state"] for m in board.messages("HEARTBEAT")].count(0) == 2
        board.run(4 * SECOND)
        assert board.level[PIN_ENABLE]
        assert board.messages("DRIVE_STATUS")[-1].signals["current"] == pytest.approx(5.0, rel=0.02)
    finally:
        board.close()
