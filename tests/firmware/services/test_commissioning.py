"""What a host needs to commission boards: a start and a stop, groups, a signature, another number."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from goldfield_protocol.messages import database
from goldfield_protocol.parameters import PARAMETERS
from tests.bench.drive_figures import DRIVERS, WAVEFORMS, CoilBoard
from tests.firmware.host_rig import (
    ANCHOR,
    CHIPS,
    MS,
    PIN_ENABLE,
    PIN_LED,
    PIN_SYNC_OUT,
    SECOND,
    SENSOR,
    Board,
    Coil,
    beacon,
    chip_seconds,
)

START, STOP, SIGNATURE, NUMBER = 6, 7, 8, 9
OK, REFUSED = 0, 2
CAUSES = database().get_message_by_name("DRIVE_HEALTH").get_signal_by_name("cause").choices or {}
OPEN_COIL, SUPPLY_LOW = (next(n for n, said in CAUSES.items() if str(said) == x) for x in ("open_coil", "supply_low"))
ALL = 65535
BLOCK = round(31 * chip_seconds(0) * 1e12)
UNIQUE = bytes(range(12))
NAMED = int.from_bytes(UNIQUE[:6], "little") ^ int.from_bytes(UNIQUE[6:], "little")
FOR_NODE_9 = {"node": 9, "code": 2, "sync_master": 1}


def made(boards: list[Board], parameters: Mapping[str, Any] | None = None) -> Board:
    """A sync master with the number 9 and an amplitude of 5 A, unless the parameters say otherwise."""
    board = beacon(Coil(), parameters={**FOR_NODE_9, "amplitude": 5.0, **(parameters or {})})
    boards.append(board)
    return board


def command(board: Board, index: int, at: int, *, named: int = NAMED, argument: int = 0, node: int = 9) -> None:
    board.send_serial("COMMAND", {"board": named, "argument": argument}, node, index, at)


def put(board: Board, name: str, value: float, at: int, node: int = 9) -> None:
    parameter = PARAMETERS[name]
    signals = {"kind": parameter.kind, f"value_{parameter.kind.name.lower()}": value}
    board.send_serial("PARAM_SET", signals, node, parameter.first, at)


def get(board: Board, name: str, at: int) -> float:
    board.send_serial("PARAM_GET", {"reserved": 0}, 0, PARAMETERS[name].first, at)
    board.run(at + 20 * MS)
    answer = board.messages("PARAM_VALUE")[-1]
    assert answer.index == PARAMETERS[name].first
    return answer.signals[f"value_{PARAMETERS[name].kind.name.lower()}"]


def statuses(board: Board) -> list[tuple[int, float]]:
    return [(m.index, m.signals["status"]) for m in board.messages("COMMAND_ANSWER")]


def driven(board: Board) -> bool:
    return bool(board.level.get(PIN_ENABLE))


# ---- Armed ----


@pytest.mark.parametrize(
    ("page", "armed"),
    [({}, 0), ({"amplitude": 0.0}, 0), ({"amplitude": 5.0}, 1), ({"amplitude": 5.0, "armed": 0}, 0)],
)
def test_what_was_flashed_with_a_current_is_armed_unless_it_says_no(
    boards: list[Board], page: dict[str, Any], armed: int
) -> None:
    board = beacon(Coil(), parameters={**FOR_NODE_9, **page})
    boards.append(board)
    board.run(SECOND)
    assert driven(board) == bool(armed)
    assert get(board, "armed", SECOND) == armed


def test_a_current_that_a_fresh_board_is_given_waits_for_a_start(boards: list[Board]) -> None:
    board = made(boards, {"amplitude": 0.0})
    board.run(SECOND)
    command(board, START, SECOND)
    board.run(1100 * MS)
    assert statuses(board) == [(START, REFUSED)]
    put(board, "amplitude", 5.0, 1200 * MS)
    board.run(2500 * MS)
    assert not board.edges(PIN_ENABLE)
    command(board, START, 2500 * MS)
    board.run(3500 * MS)
    assert statuses(board) == [(START, REFUSED), (START, OK)]
    assert driven(board)


def test_a_supply_that_is_off_is_no_fault_before_the_start_and_is_one_behind_it(boards: list[Board]) -> None:
    board = CoilBoard({**FOR_NODE_9, "amplitude": 5.0, "armed": 0}, {"supply_V": 0.0})
    boards.append(board)
    board.run(2 * SECOND)
    assert {m.signals["cause"] for m in board.messages("DRIVE_HEALTH")} == {0}
    command(board, START, 2 * SECOND)
    board.run(4 * SECOND)
    assert board.messages("DRIVE_HEALTH")[-1].signals["cause"] == SUPPLY_LOW


@pytest.mark.parametrize("node", [9, 0])
@pytest.mark.parametrize(("named", "argument"), [(NAMED, 0), (0, 0), (0, ALL), (0, 7)])
def test_a_stop_acts_within_a_block_and_a_start_brings_the_current_back(
    boards: list[Board], node: int, named: int, argument: int
) -> None:
    board = made(boards, {"group": 7})
    for late in range(4):
        at = SECOND + 2 * late * SECOND + late * BLOCK // 4
        board.run(at)
        assert driven(board)
        command(board, STOP, at, named=named, argument=argument, node=node)
        board.run(at + SECOND)
        assert not driven(board)
        assert 0 < board.edges(PIN_ENABLE, False)[-1] - at < BLOCK
        assert board.messages("HEARTBEAT")[-1].signals["state"] == 3
        command(board, START, at + SECOND)
        board.run(at + 2 * SECOND)
    assert statuses(board) == 4 * [(STOP, OK), (START, OK)]
    assert {m.signals["cause"] for m in board.messages("DRIVE_HEALTH")} == {0}


@pytest.mark.parametrize(
    ("command_index", "named", "argument", "node", "said", "drives"),
    [
        (STOP, 0, 6, 0, [], True),
        (STOP, NAMED + 1, 0, 9, [], True),
        (START, 0, 0, 9, [(START, REFUSED)], False),
        (START, NAMED, 0, 0, [(START, REFUSED)], False),
        (START, 0, 6, 0, [], False),
        (START, 0, 7, 0, [(START, OK)], True),
        (START, 0, ALL, 0, [(START, OK)], True),
    ],
)
def test_whom_a_start_and_a_stop_mean(
    boards: list[Board], command_index: int, named: int, argument: int, node: int, said: list[Any], drives: bool
) -> None:
    board = made(boards, {"group": 7, "armed": int(command_index == STOP)})
    board.run(SECOND)
    command(board, command_index, SECOND, named=named, argument=argument, node=node)
    board.run(2 * SECOND)
    assert (statuses(board), driven(board)) == (said, drives)


def test_a_sensor_is_not_started(boards: list[Board]) -> None:
    board = Board(SENSOR, {"node": 9, "amplitude": 5.0})
    boards.append(board)
    board.run(100 * MS)
    command(board, START, 100 * MS, named=0, argument=ALL, node=0)
    board.run(200 * MS)
    assert statuses(board) == [(START, REFUSED)]


# ---- Signature ----


def currents(board: CoilBoard, begin: int, end: int) -> list[float]:
    """The mean size of the current at the ends of the chips of each cycle from one time to another, A."""
    edges = [edge for edge in board.edges(PIN_SYNC_OUT) if begin <= edge < end]
    times, amperes = (np.array(column) for column in zip(*board.seen[0], strict=True))
    place = (times - edges[0]) * 1e-12 / chip_seconds(0)
    at_end = place % 1.0 > 0.5
    return [
        float(np.mean(np.abs(amperes[at_end & (place >= cycle * CHIPS) & (place < (cycle + 1) * CHIPS)])))
        for cycle in range(len(edges) - 1)
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    ("waveform", "driver"),
    [
        ("one code", "all of these, offset 0.05 A"),
        pytest.param("one code", "exact driver, 20 degC", marks=pytest.mark.slow),
        ("rotating, 37", "exact driver, 20 degC"),
        pytest.param("rotating, 37", "all of these, offset 0.05 A", marks=pytest.mark.slow),
        ("three codes", "all of these, offset 0.05 A"),
        pytest.param("three codes", "exact driver, 20 degC", marks=pytest.mark.slow),
    ],
)
def test_a_signature_halves_every_other_cycle_and_no_guard_trips(
    boards: list[Board], waveform: str, driver: str
) -> None:
    board = CoilBoard({**FOR_NODE_9, "amplitude": 8.0, **WAVEFORMS[waveform][0]}, DRIVERS[driver])
    boards.append(board)
    board.run(2 * SECOND)
    command(board, SIGNATURE, 2 * SECOND, argument=3)
    board.run(7 * SECOND)
    (before,) = {round(value, 1) for value in currents(board, SECOND, 2 * SECOND)[:-1]}
    signed = np.array(currents(board, 2500 * MS, 4800 * MS)) / before
    print(f"{waveform}, {driver}: of the current before: {np.round(signed, 3)}")
    assert len(signed) >= 20
    low, high = sorted((signed[0::2].mean(), signed[1::2].mean()))
    assert low == pytest.approx(0.5, abs=0.03)
    assert high == pytest.approx(1.0, abs=0.02)
    assert max(signed[0::2].std(), signed[1::2].std()) < 0.01
    after = np.array(currents(board, 5500 * MS, 6900 * MS)) / before
    assert after == pytest.approx(1.0, abs=0.01)
    assert len(board.edges(PIN_ENABLE)) == 1
    assert {m.signals["cause"] for m in board.messages("DRIVE_HEALTH")} == {0}
    assert statuses(board) == [(SIGNATURE, OK)]
    assert 23 <= len([edge for edge in board.edges(PIN_LED) if edge > 2 * SECOND]) * 2 <= 27


def test_a_signature_is_ended_by_zero_seconds(boards: list[Board]) -> None:
    board = CoilBoard({**FOR_NODE_9, "amplitude": 8.0}, {})
    boards.append(board)
    board.run(SECOND)
    command(board, SIGNATURE, SECOND, argument=60)
    command(board, SIGNATURE, 2 * SECOND, argument=0)
    board.run(3500 * MS)
    assert np.ptp(currents(board, 2300 * MS, 3400 * MS)) < 0.1
    assert np.ptp(currents(board, 1300 * MS, 1900 * MS)) > 3.0


def test_only_the_board_that_is_named_and_drives_its_coil_shows_a_signature(boards: list[Board]) -> None:
    board = made(boards, {"armed": 0})
    board.run(SECOND)
    command(board, SIGNATURE, SECOND, argument=5)
    command(board, START, 1100 * MS)
    board.run(2 * SECOND)
    command(board, SIGNATURE, 2 * SECOND, argument=5, named=0)
    command(board, SIGNATURE, 2100 * MS, argument=5, named=NAMED + 1)
    command(board, SIGNATURE, 2200 * MS, argument=5, node=0)
    board.run(3 * SECOND)
    assert statuses(board) == [(SIGNATURE, REFUSED), (START, OK), (SIGNATURE, REFUSED), (SIGNATURE, REFUSED)]


def test_an_open_coil_trips_in_the_midst_of_a_signature(boards: list[Board]) -> None:
    coil = Coil(broken_from=2500 * MS)
    board = beacon(coil, parameters={**FOR_NODE_9, "amplitude": 5.0})
    boards.append(board)
    board.run(2 * SECOND)
    command(board, SIGNATURE, 2 * SECOND, argument=5)
    board.run(3 * SECOND)
    assert board.edges(PIN_ENABLE, False)[0] - 2500 * MS < 2 * BLOCK
    assert board.messages("DRIVE_HEALTH")[-1].signals["cause"] == OPEN_COIL


# ---- Number ----


@pytest.mark.parametrize(
    ("argument", "named", "node", "said", "number"),
    [
        (77, NAMED, 9, [(NUMBER, OK)], 77),
        (4095, NAMED, 9, [(NUMBER, OK)], 4095),
        (4096, NAMED, 9, [(NUMBER, REFUSED)], 9),
        (0, NAMED, 9, [(NUMBER, REFUSED)], 9),
        (77, 0, 9, [(NUMBER, REFUSED)], 9),
        (77, NAMED, 0, [(NUMBER, REFUSED)], 9),
        (77, NAMED + 1, 9, [], 9),
    ],
)
def test_a_board_that_is_named_takes_another_number(
    boards: list[Board], argument: int, named: int, node: int, said: list[Any], number: int
) -> None:
    board = Board(ANCHOR, {"node": 9})
    boards.append(board)
    board.run(100 * MS)
    command(board, NUMBER, 100 * MS, argument=argument, named=named, node=node)
    board.run(1500 * MS)
    assert statuses(board) == said
    assert {m.node for m in board.messages("COMMAND_ANSWER")} <= {9}
    assert board.messages("HEARTBEAT")[-1].node == number
    assert get(board, "node", 1500 * MS) == number


# ---- Asked of all ----


@pytest.mark.parametrize(("index", "name"), [(0, "IDENTITY"), (4, "RESET_REPORT")])
def test_boards_with_one_number_do_not_answer_all_at_once(boards: list[Board], index: int, name: str) -> None:
    """Each answers within 64 ms; of 24 boards that hear the same moment few answer in one millisecond.

    The board's number is one that tells its own status at 95 ms of a cycle: nothing else is told meanwhile.
    """
    times = []
    for i in range(24):
        board = beacon(Coil(), parameters={"node": 15}, unique_id=bytes([*range(11), 40 + i]))
        boards.append(board)
        board.run(100 * MS)
        before, said = len(board.serial), len(board.messages())
        board.send_serial("COMMAND", {"board": 0, "argument": 0}, 0, index, 100 * MS)
        board.run(180 * MS)
        assert {m.name for m in board.messages()[said:]} == {name}
        times.append((board.serial[before][0] - 100 * MS) / MS)
    assert max(times) < 67
    assert len({int(time) for time in times}) >= 16
    board.send_serial("COMMAND", {"board": 0, "argument": 0}, 15, index, 200 * MS)
    before = len(board.messages(name))
    board.run(205 * MS)
    assert len(board.messages(name)) > before
