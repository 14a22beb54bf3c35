"""The same firmware on a host board and as ARM image on the emulator, behind one edge: what comes out is the same.

The processor is another, the drivers are others, the models of the hardware are others: what agrees is no one's slip.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from goldfield_protocol import Message
from tests.firmware.apps.test_sensor_app import World
from tests.firmware.host_rig import (
    MS,
    PIN_BRIDGE_1,
    PIN_BRIDGE_2,
    PIN_ENABLE,
    PIN_SYNC_OUT,
    US,
    Board,
    Coil,
    Rig,
    beacon,
)

ENABLED = 7 * US
"""The way from the conversion to the enable on an image: some 400 instructions of up to 2.5 cycles."""
PARAMETERS = {"node": 1, "code": 700, "amplitude": 8.0, "sync_master": 1}


@pytest.fixture(scope="module")
def beacons() -> Iterator[tuple[Board, Board]]:
    """A sync master on a host board and emulated, 1.2 s."""
    boards = tuple(beacon(Coil(gain=0.95), parameters=PARAMETERS, ppm=30.0, emulated=e) for e in (False, True))
    for board in boards:
        Rig(board).run(1200 * MS)
    yield boards[0], boards[1]
    for board in boards:
        board.close()


@pytest.fixture(scope="module")
def sensors() -> Iterator[tuple[Board, Board]]:
    """A sensor in the field of seven codes, eight cycles."""
    worlds = [World(emulated=e) for e in (False, True)]
    for world in worlds:
        world.run_cycles(8)
    yield worlds[0].board, worlds[1].board
    for world in worlds:
        world.board.close()


def test_beacons_say_the_same(beacons: tuple[Board, Board]) -> None:
    host, emulated = beacons
    # The image needs 3 ms more until its first chip: its last messages may be missing. Which of two kinds comes first
    # depends on the turn of main that finds them due.
    assert len(emulated.messages()) >= len(host.messages()) - 2
    kinds = {message.name for message in host.messages()}
    assert kinds >= {"HEARTBEAT", "DRIVE_STATUS", "DRIVE_HEALTH", "SYNC"}
    for kind in kinds:
        theirs = emulated.messages(kind)
        assert len(theirs) >= len(host.messages(kind)) - 1
        assert theirs == host.messages(kind)[: len(theirs)]


def test_beacons_move_their_pins_at_the_same_chips(beacons: tuple[Board, Board]) -> None:
    host, emulated = beacons
    for pin in (PIN_BRIDGE_1, PIN_BRIDGE_2, PIN_SYNC_OUT):
        theirs = np.array(emulated.edges(pin))
        ours = np.array(host.edges(pin))[: len(theirs)]
        shift = theirs - ours
        # The first edge on a bridge is that of the enable (below).
        assert np.ptp(shift[1:]) <= 1
        assert abs(shift[0] - shift[1]) < (0.02 * US if pin == PIN_SYNC_OUT else ENABLED)
    [ours_on], [theirs_on] = host.edges(PIN_ENABLE), emulated.edges(PIN_ENABLE)
    chip = (theirs_on - emulated.edges(PIN_SYNC_OUT)[0]) - (ours_on - host.edges(PIN_SYNC_OUT)[0])
    assert abs(chip) < ENABLED  # Both at the end of chip 0's current conversion.


def report(board: Board) -> dict[float, list[Message]]:
    """Offset and fields of each cycle by its number, from the first that was numbered and locked."""
    cycles: dict[float, list[Message]] = {}
    cycle = 0.0
    locked = False
    for message in board.messages():
        if message.name == "EPOCH":
            cycle = message.signals["cycle"]
        elif message.name == "EPOCH_STATUS":
            locked = message.signals["locked"] == 1
        elif message.name in ("EPOCH_OFFSET", "FIELD") and locked:
            cycles.setdefault(cycle, []).append(message)
    return cycles


def test_sensors_measure_the_same(sensors: tuple[Board, Board]) -> None:
    host, emulated = (report(board) for board in sensors)
    both = (
        host.keys() & emulated.keys()
    )  # The cycle in which they lock may differ: their blocks begin at different chips.
    assert len(both) >= 3
    assert {cycle: emulated[cycle] for cycle in both} == {cycle: host[cycle] for cycle in both}


def test_sensors_date_cycles_alike(sensors: tuple[Board, Board]) -> None:
    """Their clocks start at different moments; the steps are the same to the microsecond of the message."""
    host, emulated = ([m.signals["time"] for m in board.messages("EPOCH")][-3:] for board in sensors)
    steps = np.diff(host)
    assert np.abs(np.diff(emulated) - steps).max() < 1.5e-6
