"""The host board itself: times and levels at its edge, determinism, slices, power."""

from __future__ import annotations

from functools import partial
from random import Random
from threading import Thread

import numpy as np
import pytest

from tests.firmware.analog_pins import Pins
from tests.firmware.host_rig import (
    ANCHOR,
    BEACON,
    CHIP_TICKS,
    FFI,
    LIBRARY,
    LISTENS,
    MS,
    PIN_BRIDGE_1,
    PIN_COIL_TEMPERATURE,
    PIN_CURRENT,
    PIN_DRIVER_TEMPERATURE,
    PIN_FIELD,
    PIN_LED,
    PIN_SUPPLY,
    SENSOR,
    TICKS_PER_SECOND,
    US,
    Board,
    Coil,
    beacon,
    chip_seconds,
)

MASTER = {"node": 1, "code": 2, "amplitude": 8.0, "sync_master": 1}


class Sampled:
    """A converter input that keeps when it was read."""

    def __init__(self) -> None:
        self.times: list[tuple[int, int]] = []

    def pins(self) -> Pins:
        """What a board is given as its inputs."""
        temperatures = (*PIN_COIL_TEMPERATURE, PIN_DRIVER_TEMPERATURE)
        return {pin: partial(self._volts, pin) for pin in (*PIN_CURRENT, *PIN_FIELD, PIN_SUPPLY, *temperatures)}

    def _volts(self, pin: int, time: int) -> float:
        self.times.append((time, pin))
        return 1.65 + 0.2 * np.sin(time * 1e-10 + pin)


def test_burst_of_eight_on_three_axes_before_each_chip_end() -> None:
    sampled = Sampled()
    board = Board(SENSOR, {"node": 1}, volts=sampled.pins())
    board.run(50 * MS)
    board.close()
    times = np.array([t for t, _ in sampled.times])
    assert [p for _, p in sampled.times[:6]] == [1, 2, 3, 1, 2, 3]
    whole = len(times) // 24 * 24
    bursts = times[:whole].reshape(-1, 8, 3)
    assert (bursts == bursts[:, :, :1]).all()
    spacing = 27 / 21e6 * 1e12  # 15 clocks of sampling and 12 of conversion at 21 MHz.
    assert np.abs(np.diff(bursts[:, :, 0], axis=1) - spacing).max() <= 1
    assert np.abs(np.diff(bursts[:, 0, 0]) - chip_seconds(0) * 1e12).max() <= 1
    # The first chip starts 1 us after the application; its last conversion ends 12 clocks after its hold.
    end = bursts[0, 7, 0] + 12 / 21e6 * 1e12
    chip_end = 1 * US + chip_seconds(0) * 1e12
    assert 0 <= chip_end - end <= US


def test_coil_currents_are_sampled_behind_each_edge_amid_each_chip_and_just_before_each_end() -> None:
    sampled = Sampled()
    board = Board(BEACON, MASTER, volts=sampled.pins(), ppm=-70.0)
    board.run(50 * MS)
    board.close()
    pins = [p for _, p in sampled.times[: len(sampled.times) // 2]]
    monitor = pins[4:8]
    assert sorted(monitor) == [32, 33, 34, 35]  # supply and temperatures
    chip = [0, 36, 0, 36, *monitor, 0, 36, *monitor]
    assert pins == (chip * len(pins))[: len(pins)]
    looks = np.array([t for t, p in sampled.times if p in (0, 36)])
    both = looks[: len(looks) // 6 * 6].reshape(-1, 3, 2)
    times = both[:, :, 0]
    assert (both[:, :, 1] == times).all()
    period = chip_seconds(-70.0) * 1e12
    assert np.abs(np.diff(times, axis=0) - period).max() <= 1
    tick = period / CHIP_TICKS
    assert times[0, 0] - US == pytest.approx(4 * 168 * tick, abs=tick)  # The first chip starts 1 us after power-on.
    assert 0 < US + period - times[0, 2] < 2 * US
    into = times[0] - US
    assert 2 / 5 < into[1] / into[2] <= 1 / 2  # hal.h says so
    assert 2 / 5 < (into[1] - into[0]) / (into[2] - into[0]) <= 1 / 2


def test_edges_lie_on_ticks_of_the_local_clock() -> None:
    board = beacon(Coil(), parameters=MASTER, ppm=40.0, power_on=12_345_678)
    board.run(LISTENS + 200 * MS)
    edges = np.array(board.edges(PIN_BRIDGE_1))
    board.close()
    tick = 1e12 / (TICKS_PER_SECOND * (1 + 40e-6))
    position = (edges - 12_345_678) / tick
    assert np.abs(position - np.round(position)).max() < 1.5 / tick


def test_serial_bytes_are_five_microseconds_apart() -> None:
    board = Board(SENSOR, {"node": 1})
    board.run(200 * MS)
    times = np.array([t for t, _ in board.serial])
    board.close()
    assert np.diff(times).min() >= 5 * US - 1
    hello = np.diff(times[:16])
    assert np.abs(hello - 5 * US).max() <= 1


def test_power_on_later() -> None:
    board = Board(BEACON, MASTER, power_on=30 * MS)
    board.receive(b"nobody hears this", MS)
    board.run(30 * MS)
    assert not board.pins
    assert not board.serial
    board.run(31 * MS)
    assert board.pins[0] == (30 * MS, PIN_LED, False)
    assert board.serial[0][0] == pytest.approx(30 * MS + 5 * US, abs=1)
    board.close()


def inputs(board: Board) -> None:
    """A mixture of everything that may come from outside, over 700 ms."""
    random = Random(5)
    for cycle in range(7):
        board.sync_pulse(2 * MS + 345 + cycle * 100_003 * US)
    for _ in range(60):
        time = random.randrange(700 * MS)
        board.receive(bytes(random.randrange(256) for _ in range(random.randrange(40))), time)
    for i in range(20):
        board.send_serial("PARAM_GET", {"reserved": 0}, 0, random.randrange(9), (1 + 30 * i) * MS)
        board.can_in(0x1000001, bytes([i, 0, 240, 63, 0, 0, 0, 0]), (5 + 33 * i) * MS)


def record(role: int, steps: list[int]) -> tuple[object, ...]:
    parameters = {"node": 3, "code": 9, "amplitude": 4.0, "code_count": 3, "code_list": [1, 2, 3], "stream": 1}
    sampled = Sampled()
    board = Board(role, parameters, volts=sampled.pins(), ppm=12.5, unique_id=b"\7" * 12)
    inputs(board)
    for until in steps:
        board.run(until)
    result = (board.pins, board.analog, board.serial, board.requests, sampled.times)
    board.close()
    return result


@pytest.mark.parametrize("role", [BEACON, SENSOR, ANCHOR])
def test_same_bytes_in_slices_of_any_length(role: int) -> None:
    random = Random(11)
    ragged = sorted(random.randrange(700 * MS) for _ in range(500))
    whole = record(role, [700 * MS])
    assert len(whole[2]) > 150  # type: ignore[arg-type]
    assert record(role, [700 * MS]) == whole
    assert record(role, [*range(MS, 700 * MS, MS), 700 * MS]) == whole
    assert record(role, [*ragged, 700 * MS]) == whole


def test_boards_in_threads_do_not_disturb_each_other() -> None:
    alone = record(BEACON, [700 * MS])
    results: dict[int, object] = {}
    threads = [Thread(target=lambda i=i: results.update({i: record(BEACON, [700 * MS])})) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(results[i] == alone for i in range(4))


def test_unconnected_edge_and_bad_configuration() -> None:
    config = FFI.new("host_board_config_t *", {"role": BEACON})
    edge = FFI.new("board_edge_t *")
    board = LIBRARY.host_board_create(config, edge, 0)
    operations = LIBRARY.host_board_operations
    assert operations.run(board, 200 * MS) == 0
    assert operations.now(board) == 200 * MS
    assert FFI.string(operations.report(board)) == b""
    operations.destroy(board)
    config.crystal_ppm = float("nan")
    assert LIBRARY.host_board_create(config, edge, 0) == FFI.NULL
