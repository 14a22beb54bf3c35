"""The sensor application with parameter strongest: it reports what it hears, with no list, and locates itself by it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from tests.firmware.apps.test_sensor_app import MATRIX, NODE, ZERO, World, cycle_start, last_epoch
from tests.firmware.apps.test_sensor_blocks import BLOCK, vector
from tests.firmware.host_rig import CHIPS, MS, SENSOR, Board, gold_chips
from tests.firmware.services.test_onboard_app import CODES, TABLE, chips_of_field, counts_of, error_of, poses_of

HEARD = {3: [120, -60, 10], 700: [40, 41, -42], 1018: [-100, 100, 50], 1022: [25, 0, -25], 1023: [9, -8, 7]}
"""Codes and their amplitudes in counts; the strongest first would be 1018, 3, 700, 1022, 1023."""


def field_of(heard: dict[int, list[int]]) -> np.ndarray:
    """Whole counts about mid-scale by chip and axis, with an offset."""
    return np.array([-200, 150, 37]) + sum(np.outer(gold_chips(code), heard[code]) for code in heard)


def tesla_of(counts: np.ndarray) -> np.ndarray:
    return np.asarray((counts + 2048 - ZERO) @ MATRIX.T)


FIELD = field_of(HEARD)


@pytest.fixture
def make() -> Iterator[Callable[..., World]]:
    worlds: list[World] = []

    def create(counts: Callable[[int, int], np.ndarray] = lambda _, chip: FIELD[chip], **parameters: Any) -> World:
        worlds.append(World(counts, **({"code_count": 0, "code_list": [], "strongest": 8} | parameters)))
        return worlds[-1]

    yield create
    for world in worlds:
        world.board.close()


def put(world: World, number: int, value: int, time: int) -> None:
    world.board.send_serial("PARAM_SET", {"kind": 0, "value_unsigned": value}, NODE, number, time)


def reported(board: Board) -> dict[int, list[int]]:
    """Codes of the fields of each cycle, in the order they came."""
    cycles: dict[int, list[int]] = {}
    for message in board.messages():
        if message.name == "EPOCH":
            cycles[int(message.signals["cycle"])] = []
        elif message.name == "FIELD":
            cycles[max(cycles)].append(message.index)
    return cycles


@pytest.mark.parametrize("emulated", [False, True], ids=["host board", "image"])
def test_all_that_is_heard_is_reported_with_no_list(make: Callable[..., World], emulated: bool) -> None:
    world = make(emulated=emulated)
    world.run_cycles(8)
    epoch = last_epoch(world.board)
    assert sorted(epoch["FIELD"]) == list(HEARD)
    assert epoch["EPOCH_STATUS"][0]["fields"] == len(HEARD)
    for code in HEARD:
        got = np.array([epoch["FIELD"][code][axis] for axis in "xyz"])
        assert np.abs(got - gold_chips(code) @ tesla_of(FIELD) / CHIPS).max() < 0.55e-10
    locked = [m.signals["locked"] for m in world.board.messages("EPOCH_STATUS")]
    codes = [tuple(codes) for codes, at in zip(reported(world.board).values(), locked, strict=True) if at]
    assert len(codes) >= 2
    assert set(codes) == {(1018, 3, 700, 1022, 1023)}


def test_the_strongest_few(make: Callable[..., World]) -> None:
    world = make(strongest=3)
    world.run_cycles(6)
    assert reported(world.board)[1005] == [1018, 3, 700]


def test_set_and_given_up_at_run_time(make: Callable[..., World]) -> None:
    """Every cycle is reported, that of a change by the new rule; the list is not forgotten."""
    world = make(strongest=0, code_count=2, code_list=[5, 700])
    for value, cycle in ((8, 4), (2, 5), (0, 6), (4, 7)):
        put(world, 46, value, cycle_start(cycle) + 40 * MS)
    world.run_cycles(8)
    cycles = reported(world.board)
    assert [cycles[1000 + c] for c in range(3, 8)] == [
        [5, 700],
        [1018, 3, 700, 1022, 1023],
        [1018, 3],
        [5, 700],
        [1018, 3, 700, 1022],
    ]


def test_nothing_is_chosen_before_the_clock_is_locked() -> None:
    board = Board(SENSOR, {"node": NODE, "strongest": 8})
    board.run(350 * MS)
    states = [(m.signals["locked"], m.signals["fields"]) for m in board.messages("EPOCH_STATUS")]
    board.close()
    assert states == [(0, 0)] * 3


def test_beacons_come_and_go(make: Callable[..., World]) -> None:
    """A beacon that goes off is gone with the next whole cycle, one that comes on is there with it; order is kept."""
    later = {code: HEARD[code] for code in (3, 1018, 1022, 1023)} | {41: [0, 70, 0]}
    fields = [FIELD, field_of(later)]
    world = make(lambda cycle, chip: fields[cycle >= 5][chip])
    world.run_cycles(8)
    cycles = reported(world.board)
    assert cycles[1004] == [1018, 3, 700, 1022, 1023]
    assert cycles[1005] == cycles[1007] == [1018, 3, 1022, 1023, 41]


def test_blocks_carry_the_selection_of_the_cycle_reported_last(make: Callable[..., World]) -> None:
    """Each block is whole and of one selection, with the sums of just those codes, also where the selection changes."""
    later = {code: HEARD[code] for code in (3, 1022, 1023)} | {41: [0, 70, 0], 600: [300, 0, 0]}
    fields = [FIELD, field_of(later)]
    world = make(lambda cycle, chip: fields[cycle >= 5][chip], blocks=1, strongest=4)
    world.run_cycles(8)
    messages = world.board.messages()
    heads = [i for i, m in enumerate(messages) if m.name == "BLOCK"]
    columns = {code: gold_chips(code) for code in (*HEARD, 41, 600)}
    last = max(i for i, m in enumerate(messages[: heads[0]]) if m.name == "EPOCH")
    selections, codes = [], [m.index for m in messages[last : heads[0]] if m.name == "FIELD"]
    for head, after in pairwise(heads):
        block, sums = messages[head], [m for m in messages[head:after] if m.name == "BLOCK_SUM"]
        assert [m.index for m in sums] == codes
        assert {m.signals["block_low"] for m in sums} <= {block.signals["block_low"]}
        selections.append(tuple(codes))
        if any(m.name == "EPOCH" for m in messages[head:after]):
            codes = [m.index for m in messages[head:after] if m.name == "FIELD"]
        cycle = (int(block.signals["cycle_low"]) - 1000) % 8
        if cycle == 4 or block.index + BLOCK > CHIPS:
            continue  # Chips of both fields.
        chips = np.arange(block.index, block.index + BLOCK)
        tesla = tesla_of(fields[cycle >= 5][chips])
        for m in sums:
            assert np.abs(vector(m) - columns[m.index][chips] @ tesla / BLOCK).max() < 0.21e-9
    assert {(1018, 3, 700, 1022), (600, 3, 41, 1022)} <= set(selections)


FAR = [float(x) for centre in ((40.0, 0, 0), (0, 40.0, 0)) for x in (*centre, 0.0, 0.0, 2.0, 13.0, 0.149)]
KNOWN = TABLE | {
    "code_count": 10,
    "code_list": [30, *CODES, 31],
    "beacons": [*FAR[:8], *TABLE["beacons"], *FAR[8:]],
    "survey": [0.0] * 30,
}


def test_own_pose_by_what_is_heard_and_known(make: Callable[..., World]) -> None:
    """Two of the ten beacons in the table are far, and one of the nine codes on the air is in no table."""
    chips = chips_of_field(CODES) + np.outer(gold_chips(333), [3e-6, 0.0, 2e-6])
    full = make(counts_of(chips_of_field(CODES)), **(TABLE | {"strongest": 0}))
    worlds = [full, *(make(counts_of(chips), **(KNOWN | {"strongest": most})) for most in (64, 7))]
    told = []
    for world in worlds:
        world.run_cycles(9)
        position, attitude, quality, integrity = poses_of(world)[-1]
        assert quality.signals["status"] == 0
        assert integrity.signals["left_out"] == 255
        off_m, off_rad = error_of(position, attitude)
        assert off_m < 3.0 * quality.signals["sigma_position"] < 0.04
        assert off_rad < 3.0 * quality.signals["sigma_attitude"] < 0.08
        told.append((position, quality.signals))
    assert [quality["used"] for _, quality in told] == [8, 8, 6]
    listed, strongest = (np.array([position.signals[axis] for axis in "xyz"]) for position, _ in told[:2])
    assert np.linalg.norm(strongest - listed) < 0.5 * told[0][1]["sigma_position"]  # The noise is the same.
    assert 333 in reported(worlds[2].board)[1008]


@pytest.mark.parametrize("wrong", [{"code_list": [*CODES[:7], 2]}, {"pose_blocks": 1}], ids=["twice", "blocks"])
def test_poses_that_cannot_be_fail(make: Callable[..., World], wrong: dict[str, Any]) -> None:
    """A table with one code twice; and the track by blocks, which needs the same codes all the time."""
    world = make(counts_of(chips_of_field(CODES)), **(TABLE | {"strongest": 8} | wrong))
    world.run_cycles(7)
    rows = [row for row in poses_of(world) if (row[0].index > 0) == ("pose_blocks" in wrong)]
    assert len(rows) >= 3
    for _, _, quality, integrity in rows[1:]:
        assert (quality.signals["status"], integrity.signals["reason"]) == (4, 3)
