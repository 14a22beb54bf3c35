"""Blocks of a sensor on a host board: sums against a matrix product, places, what is left out, links, and how soon."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from goldfield_protocol import FrameDecoder, Message, decode
from tests.firmware.apps.test_sensor_app import CODES, FIELD, MATRIX, NODE, ZERO, World, cycle_start, field_counts
from tests.firmware.host_rig import CHIPS, MS, US, Rig, chip_seconds, gold_chips

BLOCK = 31
COLUMNS = np.array([*(gold_chips(code) for code in CODES), np.ones(CHIPS)]).T
LIMIT_T = 524288 * 4e-10
POSITIONS = 8 * CHIPS
"""Chips after which the low bits of the cycle come round."""


def blocks(messages: list[Message]) -> list[tuple[Message, list[Message]]]:
    """Each block with its sums, which are complete and follow it at once; one that is on its way is left out."""
    found = []
    heads = [place for place, message in enumerate(messages) if message.name == "BLOCK"]
    if heads and heads[-1] + len(CODES) >= len(messages):
        messages = messages[: heads[-1]]
    for place, message in enumerate(messages):
        if message.name == "BLOCK":
            sums = messages[place + 1 : place + 1 + len(CODES)]
            assert [(m.name, m.index) for m in sums] == [("BLOCK_SUM", code) for code in CODES]
            assert {m.signals["block_low"] for m in sums} == {message.signals["block_low"]}
            found.append((message, sums))
    assert sum(m.name == "BLOCK_SUM" for m in messages) == len(CODES) * len(found)
    return found


def vector(message: Message) -> np.ndarray:
    return np.array([message.signals[axis] for axis in "xyz"])


def position(message: Message) -> int:
    return int(message.signals["cycle_low"]) * CHIPS + message.index


def settled(world: World, cycles: int = 8) -> list[tuple[Message, list[Message]]]:
    """The blocks behind the first cycle that was reported as locked throughout."""
    world.run_cycles(cycles)
    messages = world.board.messages()
    locked = next(i for i, m in enumerate(messages) if m.name == "EPOCH_STATUS" and m.signals["locked"])
    return blocks(messages[locked:])


def test_sums_equal_the_matrix_product_and_blocks_go_on(make: Callable[..., World]) -> None:
    found = settled(make(blocks=3))
    assert len(found) > 90
    places = [position(block) for block, _ in found]
    numbers = [int(block.signals["block_low"]) for block, _ in found]
    assert (np.diff(places) % POSITIONS == BLOCK).all()
    assert (np.diff(numbers) % 16 == 1).all()
    for block, sums in found:
        chips = np.arange(block.index, block.index + BLOCK) % CHIPS
        tesla = (FIELD[chips] + 2048 - ZERO) @ MATRIX.T
        expected = COLUMNS[chips].T @ tesla / BLOCK
        # Half a unit of rounding, and 24 bits of single precision.
        assert np.abs(vector(block) - expected[-1]).max() < 0.41e-9
        assert np.abs(np.array([vector(m) for m in sums]) - expected[:-1]).max() < 0.21e-9


def test_none_is_sent_before_the_clock_is_locked(make: Callable[..., World]) -> None:
    world = make(blocks=1)
    world.run_cycles(8)
    messages = world.board.messages()
    first = next(i for i, m in enumerate(messages) if m.name == "BLOCK")
    states = [m.signals["locked"] for m in messages[:first] if m.name == "EPOCH_STATUS"]
    assert set(states) == {0}


def test_none_is_sent_unless_asked_for(make: Callable[..., World]) -> None:
    world = make()
    world.run_cycles(8)
    assert not world.board.messages("BLOCK")
    assert not world.board.messages("BLOCK_SUM")


def test_every_field_is_the_same_with_blocks(make: Callable[..., World]) -> None:
    reports = []
    for asked in (0, 3):
        world = make(blocks=asked)
        world.run_cycles(8)
        kinds = ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", "FIELD")
        reports.append([m for m in world.board.messages() if m.name in kinds])
        assert not world.board.messages("COUNTER")
    assert reports[0] == reports[1]


def test_an_axis_with_a_saturated_sample_is_marked(make: Callable[..., World]) -> None:
    def counts(cycle: int, chip: int) -> np.ndarray:
        sample = field_counts(cycle, chip).copy()
        if cycle % 2 and chip == 500:
            sample[1] = 9999
        return sample

    found = settled(make(counts, blocks=1, calibration=[1e-7, 0, 0, 0, 1e-7, 0, 0, 2e-9, 1e-7]))
    hit = [b for b in found if b[0].signals["cycle_low"] % 2 and b[0].index <= 500 < b[0].index + BLOCK]
    assert len(hit) >= 2
    for block, sums in found:
        for message in (block, *sums):
            spoilt = vector(message) <= -LIMIT_T * (1 - 1e-7)
            # z is made of y, too
            assert spoilt.tolist() == ([False, True, True] if any(block is b for b, _ in hit) else [False] * 3)


def test_a_sum_beyond_the_range_is_marked_alone(make: Callable[..., World]) -> None:
    """At 1 uT a count, the offset of -200 counts is -200 uT, and codes of the same sign in all chips add to that."""
    found = settled(make(blocks=1, calibration=[1e-6, 0, 0, 0, 1e-7, 0, 0, 0, 1e-7]))
    beyond = 0
    for block, sums in found:
        chips = np.arange(block.index, block.index + BLOCK) % CHIPS
        tesla = (FIELD[chips] + 2048 - ZERO) @ np.diag([1e-6, 1e-7, 1e-7])
        expected = np.vstack([tesla.mean(axis=0), COLUMNS[chips, :-1].T @ tesla / BLOCK])
        for message, value in zip((block, *sums), expected, strict=True):
            out = abs(value[0]) > LIMIT_T
            beyond += out
            assert vector(message)[0] == pytest.approx(-LIMIT_T if out else value[0], abs=0.5e-9)
    assert beyond > 10


def test_blocks_go_on_the_links_that_are_named(make: Callable[..., World]) -> None:
    for asked, serial, can in ((0, False, False), (1, True, False), (2, False, True), (3, True, True)):
        world = make(blocks=asked)
        Rig(world.board, quantum=200 * US).run(cycle_start(7))
        assert bool(world.board.messages("BLOCK")) is serial
        assert bool(world.board.can_messages("BLOCK")) is can
        assert world.board.messages("FIELD")
        assert world.board.can_messages("FIELD")
        if can:
            assert len(blocks(world.board.can_messages())) > 60


def test_asked_for_and_given_up_at_run_time(make: Callable[..., World]) -> None:
    world = make()
    for value, at in ((1, cycle_start(6)), (0, cycle_start(7))):
        world.board.send_serial("PARAM_SET", {"kind": 0, "value_unsigned": value}, NODE, 44, at)
    world.run_cycles(9)
    found = blocks(world.board.messages())
    assert 31 <= len(found) <= 34
    assert {int(block.signals["cycle_low"]) for block, _ in found} <= {1005 % 8, 1006 % 8, 1007 % 8}


def test_more_codes_than_can_carries_cost_blocks_and_no_report(make: Callable[..., World]) -> None:
    """A block of 40 codes is 41 messages, 5.3 ms on this bus: the report of every cycle is whole all the same."""
    world = make(blocks=2, code_count=40, code_list=list(range(100, 140)))
    Rig(world.board, quantum=200 * US).run(cycle_start(9))
    messages = world.board.can_messages()
    epochs = [m.signals["cycle"] for m in messages if m.name == "EPOCH"]
    assert epochs[1:] == list(range(1002, 1008))  # the first one was not numbered yet
    assert sum(m.name == "FIELD" for m in messages) in (40 * len(epochs), 40 * len(epochs) - 1)
    heads = sum(m.name == "BLOCK" for m in messages)
    assert 20 < heads < 3 * 33  # of 33 a cycle, some 18 fit
    assert not world.board.messages("COUNTER")


def test_the_first_byte_leaves_at_once_and_the_last_within_a_millisecond(make: Callable[..., World]) -> None:
    """Host boards take no time to compute: what is seen here are the links and the order in which messages leave."""
    world = make(blocks=1)
    world.run_cycles(8)
    decoder, times = FrameDecoder(), []
    for time, byte in world.board.serial:
        for frame in decoder.feed(bytes([byte])):
            message = decode(frame.identifier, frame.data)
            assert message is not None
            times.append((time, message))
    delays = []
    for place, (time, message) in enumerate(times):
        if message.name == "BLOCK" and time < cycle_start(8):
            cycle = (int(message.signals["cycle_low"]) - 1000) % 8
            end = cycle_start(cycle) + round((message.index + BLOCK) * chip_seconds(-50.0) * 1e12)
            last, last_time = times[place + len(CODES)][1], times[place + len(CODES)][0]
            assert last.index == CODES[-1]
            delays.append((time - end, last_time - end))
    first, last = np.array(delays).T
    assert first.max() < 150 * US
    assert last.max() < MS
