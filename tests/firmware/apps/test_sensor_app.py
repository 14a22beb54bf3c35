"""The sensor application on a host board: fields against a matrix product, numbers, times, stream, saturation."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from tests.firmware.host_rig import (
    CHIPS,
    MS,
    SENSOR,
    US,
    Board,
    chip_at,
    chip_seconds,
    each_axis,
    gold_chips,
)

NODE = 100
MASTER_PPM = -50.0
FIRST_EDGE = 3 * MS + 123_457
CODES = [2, 3, 700, 1018, 1022, 1023, 1024]
AMPLITUDES = np.array([[120, -60, 10], [-3, 5, 7], [40, 41, -42], [0, 0, 1], [-100, 100, 50], [25, 0, -25], [9, -8, 7]])
OFFSET = np.array([-200, 150, 37])
ZERO = np.array([2040.25, 2051.5, 2047.0])
MATRIX = np.array([[9.9e-8, 1.1e-9, -0.7e-9], [-2.0e-9, 9.6e-8, 0.4e-9], [0.3e-9, 0.8e-9, 1.02e-7]])

Counts = Callable[[int, int], np.ndarray]


def cycle_start(cycle: int) -> int:
    """Picosecond at which the master begins a cycle."""
    return FIRST_EDGE + round(cycle * CHIPS * chip_seconds(MASTER_PPM) * 1e12)


FIELD = OFFSET + np.array([gold_chips(code) for code in CODES]).T @ AMPLITUDES
"""Converter counts about mid-scale, whole numbers: chip by axis."""


def field_counts(_cycle: int, chip: int) -> np.ndarray:
    return FIELD[chip]


class World:
    """A sensor board in a field that is a function of the master's cycle and chip."""

    def __init__(
        self, counts: Counts = field_counts, ppm: float = 17.0, emulated: bool = False, **parameters: object
    ) -> None:
        self.counts = counts
        stored = {
            "node": NODE,
            "code_count": len(CODES),
            "code_list": CODES,
            "zero_x": float(ZERO[0]),
            "zero_y": float(ZERO[1]),
            "zero_z": float(ZERO[2]),
            "calibration": [float(x) for x in MATRIX.ravel()],
        }
        self.board = Board(
            SENSOR, {**stored, **parameters}, ppm=ppm, volts=each_axis(self.volts), temperature=31.04, emulated=emulated
        )
        for cycle in range(20):
            self.board.sync_pulse(cycle_start(cycle))
            self.board.send_serial("SYNC", sync(1000 + cycle), 1, 0, cycle_start(cycle) + 2 * MS)

    def volts(self, axis: int, time: int) -> tuple[float, int]:
        """Volts of an axis, and until when they stay: they change with the master's chips."""
        chip, until = chip_at(time, FIRST_EDGE, MASTER_PPM)
        return float((2048 + self.counts(*divmod(chip, CHIPS))[axis]) * 3.3 / 4096), until

    def run_cycles(self, cycles: int) -> None:
        """Run until the report of the last of these cycles has left."""
        self.board.run(cycle_start(cycles) + 6 * MS)


def sync(cycle: int) -> dict[str, float]:
    return {"cycle": cycle, "chips": CHIPS, "chip_period": 97750.0, "rank": 1}


@pytest.fixture(scope="module")
def settled() -> Iterator[World]:
    """Ten cycles of the plain field; locked long before the last."""
    world = World()
    world.run_cycles(10)
    yield world
    world.board.close()


def last_epoch(board: Board) -> dict[str, dict[int, dict[str, float]]]:
    """Messages of the latest cycle: name, index, signals."""
    messages = board.messages()
    start = max(i for i, m in enumerate(messages) if m.name == "EPOCH")
    epoch: dict[str, dict[int, dict[str, float]]] = {}
    for message in messages[start:]:
        assert message.node == NODE
        epoch.setdefault(message.name, {})[message.index] = dict(message.signals)
    return epoch


def expected_field(chips: np.ndarray) -> np.ndarray:
    """Plain correlation of the field in tesla with one code, over N: the definition in framing.md."""
    tesla = (FIELD + 2048 - ZERO) @ MATRIX.T
    return chips @ tesla / CHIPS


def test_fields_equal_matrix_product(settled: World) -> None:
    epoch = last_epoch(settled.board)
    assert sorted(epoch["FIELD"]) == CODES
    for code in CODES:
        got = np.array([epoch["FIELD"][code][axis] for axis in "xyz"])
        # Half a unit of rounding, and 24 bits of single precision.
        assert np.abs(got - expected_field(gold_chips(code))).max() < 0.55e-10


def test_offset_equals_mean(settled: World) -> None:
    got = np.array([last_epoch(settled.board)["EPOCH_OFFSET"][0][axis] for axis in "xyz"])
    assert np.abs(got - expected_field(np.ones(CHIPS))).max() < 0.55e-9


def test_status(settled: World) -> None:
    status = last_epoch(settled.board)["EPOCH_STATUS"][0]
    assert status["chips"] == CHIPS
    assert status["fields"] == len(CODES)
    assert status["saturated"] == 0
    assert status["locked"] == 1
    assert status["temperature"] == pytest.approx(31.0)
    assert abs(status["phase"]) <= 100


def test_cycle_numbers_follow_sync(settled: World) -> None:
    numbers = [m.signals["cycle"] for m in settled.board.messages("EPOCH")]
    assert numbers[0] == 0
    assert numbers[1:] == list(range(1010 - len(numbers) + 1, 1010))  # From the relabelling on.
    locked = [m.signals["locked"] for m in settled.board.messages("EPOCH_STATUS")]
    assert locked[-5:] == [1] * 5
    assert numbers[-5:] == [1005, 1006, 1007, 1008, 1009]
    low = [m.signals["cycle_low"] for m in settled.board.messages("EPOCH_OFFSET")]
    assert low == [n % 16 for n in numbers]


def test_time_is_mid_cycle_on_own_clock(settled: World) -> None:
    epochs = settled.board.messages("EPOCH")
    middle = (cycle_start(9) + cycle_start(10)) / 2 * 1e-12
    own = middle * (1 + 17e-6)
    assert epochs[-1].signals["time"] == pytest.approx(own, abs=2.5e-6)  # The engine starts 1 us after power-on.
    steps = np.diff([m.signals["time"] for m in epochs[-5:]])
    assert steps == pytest.approx(CHIPS * chip_seconds(MASTER_PPM) * (1 + 17e-6), abs=1.1e-6)


def test_dead_can_bus_loses_nothing_elsewhere(settled: World) -> None:
    # Nobody took the first frame off the bus: the node gives up what waits behind it, and does not call it lost.
    assert [m.name for m in settled.board.can_messages()] == ["HEARTBEAT"]
    assert 4 not in {m.index for m in settled.board.messages("COUNTER")}


def test_can_carries_the_epoch(make: Callable[..., World]) -> None:
    world = make()
    done = 0
    for step in range(1, 1100):
        world.board.run(step * MS)
        for time, mailbox, _, _ in world.board.requests[done:]:
            world.board.can_sent(mailbox, True, time + 130 * US)
        done = len(world.board.requests)
    report = {"EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET", "FIELD"}
    serial = [m for m in world.board.messages() if m.name in report]
    can = [m for m in world.board.can_messages() if m.name in report]
    assert len(serial) >= 9 * (3 + len(CODES))
    assert can == serial


def test_first_message_is_a_heartbeat(settled: World) -> None:
    first = settled.board.messages()[0]
    assert (first.name, first.node) == ("HEARTBEAT", NODE)
    assert first.signals["role"] == 1
    assert first.signals["state"] == 0
    assert settled.board.serial[0][0] == pytest.approx(5 * US, rel=20e-6)


def test_locked_within_six_cycles_and_stays(settled: World) -> None:
    locked = [m.signals["locked"] for m in settled.board.messages("EPOCH_STATUS")]
    assert locked == sorted(locked)
    assert locked[-4:] == [1] * 4
    heartbeats = settled.board.messages("HEARTBEAT")
    assert heartbeats[-1].signals["state"] == 3


def test_the_cycle_that_is_cut_when_the_clock_finds_its_master_is_no_loss(settled: World) -> None:
    # The sensor starts 3.1 ms before the master's cycle: the label jumps once, in the cycle under way.
    assert not settled.board.messages("COUNTER")
    chips = {m.signals["chips"] for m in settled.board.messages("EPOCH_STATUS")}
    assert chips == {CHIPS}


def test_stream_carries_every_chip(make: Callable[..., World]) -> None:
    world = make(stream=1)
    world.run_cycles(8)
    streamed = [m for m in world.board.messages("CHIP") if m.signals["cycle_low"] == 1006]
    assert [m.index for m in streamed] == list(range(CHIPS))
    got = np.array([[m.signals[axis] for axis in "xyz"] for m in streamed])
    assert (got == 8 * FIELD).all()
    assert not world.board.can_messages("CHIP")
    assert 4 not in {m.index for m in world.board.messages("COUNTER")}


def test_saturation_is_counted_and_marked(make: Callable[..., World]) -> None:
    def counts(cycle: int, chip: int) -> np.ndarray:
        sample = FIELD[chip].copy()
        if chip in (17, 500):
            sample[1] = 9999
        if chip == 900:
            sample[2] = -9999
        return sample

    world = make(counts, stream=1)
    world.run_cycles(8)
    assert last_epoch(world.board)["EPOCH_STATUS"][0]["saturated"] == 3
    streamed = {m.index: m.signals for m in world.board.messages("CHIP") if m.signals["cycle_low"] == 1006}
    assert streamed[17]["y"] == streamed[500]["y"] == streamed[900]["z"] == -32768
    assert streamed[17]["x"] == 8 * FIELD[17][0]
    assert streamed[18]["y"] == 8 * FIELD[18][1]


def test_field_out_of_range_says_so(make: Callable[..., World]) -> None:
    world = make(calibration=[1e-6, 0, 0, 0, 1e-7, 0, 0, 0, 1e-7])
    world.run_cycles(8)
    epoch = last_epoch(world.board)
    assert epoch["FIELD"][2]["x"] == pytest.approx(-524288e-10)  # 120 counts are 120 uT.
    assert abs(epoch["FIELD"][2]["y"]) < 10e-6


def test_code_list_set_at_run_time(make: Callable[..., World]) -> None:
    world = make()
    for i, code in enumerate([1018, 5]):
        parameter = {"kind": 0, "value_unsigned": code}
        world.board.send_serial("PARAM_SET", parameter, NODE, 256 + i, cycle_start(7) + 40 * MS + i * MS)
    world.board.send_serial("PARAM_SET", {"kind": 0, "value_unsigned": 2}, NODE, 5, cycle_start(7) + 43 * MS)
    world.run_cycles(9)
    epoch = last_epoch(world.board)
    assert sorted(epoch["FIELD"]) == [5, 1018]
    assert epoch["EPOCH_STATUS"][0]["fields"] == 2
    for code in (5, 1018):
        got = np.array([epoch["FIELD"][code][axis] for axis in "xyz"])
        assert np.abs(got - expected_field(gold_chips(code))).max() < 0.55e-10


def test_number_is_counted_from_zero_without_sync_messages() -> None:
    board = Board(SENSOR, {"node": NODE})
    board.run(350 * MS)
    epochs = board.messages("EPOCH")
    board.close()
    assert [m.signals["cycle"] for m in epochs] == [0, 1, 2]
    assert epochs[0].signals["time"] == pytest.approx(CHIPS * 97.75e-6 / 2, abs=1e-6)
    assert {m.signals["locked"] for m in board.messages("EPOCH_STATUS")} == {0}


def test_another_code_list_at_run_time(make: Callable[..., World]) -> None:
    """Every cycle is reported, that of the change with the codes of the new list."""
    world = make()
    for number, value, ms in ((256, 1018, 150), (257, 5, 151), (5, 2, 152)):
        world.board.send_serial(
            "PARAM_SET", {"kind": 0, "value_unsigned": value}, NODE, number, cycle_start(6) + ms * MS
        )
    world.run_cycles(10)
    epoch = last_epoch(world.board)
    assert sorted(epoch["FIELD"]) == [5, 1018]
    for code in (5, 1018):
        got = np.array([epoch["FIELD"][code][axis] for axis in "xyz"])
        assert np.abs(got - expected_field(gold_chips(code))).max() < 0.55e-10
    assert [m.signals["cycle"] for m in world.board.messages("EPOCH")][-3:] == [1007, 1008, 1009]
