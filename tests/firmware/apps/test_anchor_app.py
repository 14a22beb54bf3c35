"""The anchor application: boards that drive coils and measure the fields of all of them, their own included."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from tests.firmware.analog_pins import MID_SCALE_V
from tests.firmware.host_rig import (
    ANCHOR,
    CHIPS,
    MS,
    PIN_BRIDGE_1,
    PIN_BRIDGE_2,
    PIN_CURRENT,
    PIN_ENABLE,
    US,
    Board,
    Rig,
    each_axis,
    gold_chips,
)

CODES = [2, 1018]
CHIP_VALUES = np.array([gold_chips(code) for code in CODES])
COUNTS_PER_A = np.array([[30.0, -12.0, 55.0], [5.0, 7.0, -3.0]])
"""Converter counts at an anchor per ampere: of its own coil, of the other's."""
COUNT_T = 1e-7
AMPLITUDE_A = 8.0
STEP_T = COUNT_T * COUNTS_PER_A.max() * 0.008
"""What one step of the current sense, 0.0078 A, is worth at most; the loop is no better."""


QUANTUM = 20 * US
"""The first board is at most so far ahead of the second: less than what lies between two chips' samples and edges."""


class Anchor:
    """A board, its coil, and a sensor that feels this coil and those of others; ``broken_from``: the coil's wire."""

    def __init__(self, *, ppm: float = 0.0, power_on: int = 0, emulated: bool = False, **parameters: object) -> None:
        self.broken_from = 1 << 62
        self.others: list[Anchor] = []
        self._present = (-1, -1), 0.0  # how much the board has done by now, and the current since then
        stored = {
            "amplitude": AMPLITUDE_A,
            "code_count": len(CODES),
            "code_list": CODES,
            "calibration": [COUNT_T, 0.0, 0.0, 0.0, COUNT_T, 0.0, 0.0, 0.0, COUNT_T],
            **parameters,
        }
        inputs = {PIN_CURRENT[0]: self.sense, **each_axis(self.field)}
        self.board = Board(ANCHOR, stored, volts=inputs, ppm=ppm, power_on=power_on, emulated=emulated)

    def amperes(self, time: int) -> float:
        """The coil follows its bridge at once; a time that the board has not lived through yet is as its present."""
        if time >= self.broken_from:
            return 0.0
        pins = self.board.pins
        if pins and time < pins[-1][0]:
            return self._driven(time)
        seen = len(pins), len(self.board.analog[0])
        if seen != self._present[0]:
            self._present = seen, self._driven(time)
        return self._present[1]

    def _driven(self, time: int) -> float:
        """The reference with the sign of the bridge at that time, if the driver is enabled at present."""

        def level(pin: int) -> bool:
            return next(
                (new for when, number, new in reversed(self.board.pins) if number == pin and when <= time), False
            )

        if not self.board.level.get(PIN_ENABLE):
            return 0.0
        return (int(level(PIN_BRIDGE_1)) - int(level(PIN_BRIDGE_2))) * self.board.analog[0][-1][1] / 3.3 * 16.0

    def sense(self, time: int) -> float:
        return MID_SCALE_V + 0.103125 * self.amperes(time)

    def field(self, axis: int, time: int) -> float:
        counts = COUNTS_PER_A[0, axis] * self.amperes(time)
        counts += sum(COUNTS_PER_A[1, axis] * other.amperes(time) for other in self.others)
        return float(MID_SCALE_V + counts * 3.3 / 4096)


def pair(**of_both: object) -> list[Anchor]:
    """A master and its follower, which has another clock."""
    first = Anchor(node=1, code=CODES[0], sync_master=1, ppm=20.0, **of_both)
    second = Anchor(node=2, code=CODES[1], ppm=-60.0, power_on=7 * MS, **of_both)
    first.others, second.others = [second], [first]
    return [first, second]


@pytest.fixture
def anchors() -> Iterator[list[Anchor]]:
    made: list[Anchor] = []
    yield made
    for anchor in made:
        anchor.board.close()


def last_fields(board: Board) -> np.ndarray:
    """Return the fields of the latest cycle, code by axis, tesla."""
    fields = board.messages("FIELD")[-len(CODES) :]
    assert [m.index for m in fields] == CODES
    assert len({m.signals["cycle_low"] for m in fields}) == 1
    return np.array([[m.signals[axis] for axis in "xyz"] for m in fields])


def correlations(amperes: list[float], own: int) -> np.ndarray:
    """What framing.md defines, for coils with these currents by code, at an anchor with code number own: tesla."""
    counts = COUNTS_PER_A if own == 0 else COUNTS_PER_A[::-1]
    return COUNT_T * CHIP_VALUES @ (CHIP_VALUES.T * amperes) @ counts / CHIPS


@pytest.mark.parametrize("timing", [{}, {"sync_source": 2}])
def test_two_anchors_measure_each_other_and_themselves(anchors: list[Anchor], timing: dict[str, int]) -> None:
    anchors += pair(**timing)
    Rig(*(anchor.board for anchor in anchors), quantum=QUANTUM).run(1300 * MS)
    for own, anchor in enumerate(anchors):
        board = anchor.board
        assert {m.node for m in board.messages()} == {own + 1}
        heartbeat = board.messages("HEARTBEAT")[-1].signals
        assert (heartbeat["role"], heartbeat["state"]) == (3, 3)
        status, epoch = board.messages("DRIVE_STATUS")[-1].signals, board.messages("EPOCH_STATUS")[-1].signals
        assert (status["enabled"], status["locked"], epoch["locked"], epoch["chips"]) == (1, 1, 1, CHIPS)
        assert np.abs(last_fields(board) - correlations([AMPLITUDE_A, AMPLITUDE_A], own)).max() < STEP_T
        assert board.can_messages("FIELD")[:20] == board.messages("FIELD")[:20]
    first, second = (anchor.board.messages("EPOCH")[-1].signals["cycle"] for anchor in anchors)
    assert abs(first - second) <= 1
    assert not anchors[0].board.messages("COUNTER")  # The master's cycles are whole from the first on.


def test_an_anchor_whose_coil_breaks_goes_on_measuring(anchors: list[Anchor]) -> None:
    anchors += pair()
    boards = [anchor.board for anchor in anchors]
    rig = Rig(*boards, quantum=QUANTUM)
    rig.run(1100 * MS)
    anchors[1].broken_from = rig.now
    rig.run(2250 * MS)
    assert boards[1].messages("HEARTBEAT")[-1].signals["state"] == 4
    assert boards[1].messages("DRIVE_STATUS")[-1].signals["open_coil"] == 1
    assert not boards[1].level[PIN_ENABLE]
    assert boards[1].messages("EPOCH_STATUS")[-1].signals["locked"] == 1
    assert np.abs(last_fields(boards[1]) - correlations([AMPLITUDE_A, 0.0], 1)).max() < STEP_T


def test_parameters_of_both_halves(anchors: list[Anchor]) -> None:
    """One of the sensor does not touch the drive; one of the drive stops no report."""
    anchors += pair()
    boards = [anchor.board for anchor in anchors]
    rig = Rig(*boards, quantum=QUANTUM)
    rig.run(1100 * MS)
    offs = len(boards[0].edges(PIN_ENABLE, False))
    boards[0].send_serial("PARAM_SET", {"kind": 0, "value_unsigned": 1}, 1, 5, rig.now + MS)
    rig.run(1400 * MS)
    assert len(boards[0].edges(PIN_ENABLE, False)) == offs
    assert [m.index for m in boards[0].messages("FIELD")[-2:]] == CODES[:1] * 2
    boards[0].send_serial("PARAM_SET", {"kind": 2, "value_float": 2.0}, 1, 2, rig.now + MS)
    rig.run(2100 * MS)
    assert len(boards[0].edges(PIN_ENABLE, False)) == offs + 1
    assert boards[0].messages("DRIVE_STATUS")[-1].signals["target"] == 2.0
    cycles = zip(boards[0].messages("EPOCH"), boards[0].messages("EPOCH_STATUS"), strict=True)
    numbers = [epoch.signals["cycle"] for epoch, status in cycles if status.signals["locked"]]
    assert numbers == list(range(len(numbers)))
    assert len(numbers) >= 18
    own = np.array([boards[0].messages("FIELD")[-1].signals[axis] for axis in "xyz"])
    assert np.abs(own - correlations([2.0, AMPLITUDE_A], 0)[0]).max() < STEP_T


def test_the_image_does_what_the_host_board_does(anchors: list[Anchor]) -> None:
    for emulated in (False, True):
        anchors.append(Anchor(node=1, code=CODES[0], sync_master=1, ppm=20.0, emulated=emulated))
        anchors[-1].board.run(800 * MS)
    host, image = (last_fields(anchor.board) for anchor in anchors)
    assert np.abs(host - correlations([AMPLITUDE_A, 0.0], 0)).max() < STEP_T
    assert np.abs(image - host).max() < STEP_T
