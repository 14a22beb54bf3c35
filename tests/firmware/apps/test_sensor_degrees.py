"""The sensor application with codes of other degrees: fields, numbers, a master of another degree, full links."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest

from tests.firmware.host_rig import (
    MS,
    SECOND,
    SENSOR,
    US,
    Board,
    Coil,
    Rig,
    beacon,
    chip_at,
    chip_seconds,
    each_axis,
    gold_chips,
)

FIRST_EDGE = 3 * MS + 123_457
PPM = -50.0
AMPLITUDES = np.array([[120, -60, 10], [-3, 5, 7], [40, 41, -42]])
OFFSET = np.array([-200, 150, 37])
COUNT_T = 200e-6 / 2048
CAN_FRAME = 137 * US
"""The duration of a frame of eight bytes, with the stuff bits of a typical FIELD."""


def codes_of(degree: int) -> list[int]:
    """A shift, the last shift, and u."""
    return [3, 2**degree - 2, 2**degree - 1]


class World:
    """A sensor board in a field that repeats with each cycle of the master."""

    def __init__(
        self, degree: int, cycles: int, seconds: float, master: int | None = None, **parameters: object
    ) -> None:
        self.chips, self.cycles = 2**degree - 1, cycles
        codes = codes_of(degree)
        self.field = OFFSET + np.array([gold_chips(code, degree) for code in codes]).T @ AMPLITUDES
        stored = {"node": 100, "degree": degree, "code_count": len(codes), "code_list": codes}
        self.board = Board(SENSOR, {**stored, **parameters}, ppm=17.0, volts=each_axis(self.volts))
        period = self.chips * cycles * chip_seconds(PPM)
        for number in range(int(seconds / period)):
            edge = FIRST_EDGE + round(number * period * 1e12)
            self.board.sync_pulse(edge)
            told = {
                "cycle": 2**20 - 64 + number * cycles,
                "chips": master or self.chips,
                "chip_period": 97750.0,
                "rank": 1,
            }
            told["cycle"] %= 2**20
            self.board.send_serial("SYNC", told, 1, 0, edge + 2 * MS)

    def volts(self, axis: int, time: int) -> tuple[float, int]:
        """Volts of an axis, and until when they stay."""
        chip, until = chip_at(time, FIRST_EDGE, PPM)
        return float((2048 + self.field[chip % self.chips, axis]) * 3.3 / 4096), until


@contextmanager
def world(*arguments: object, **options: object) -> Iterator[World]:
    made = World(*arguments, **options)  # type: ignore[arg-type]
    yield made
    made.board.close()


@pytest.mark.parametrize(("degree", "cycles"), [(5, 32), (6, 16), (7, 8), (9, 2), (11, 1)])
def test_fields_equal_the_matrix_product_in_every_cycle(degree: int, cycles: int) -> None:
    with world(degree, cycles, 2.0) as made:
        made.board.run(1800 * MS)
        messages = made.board.messages()
        reports = [i for i, m in enumerate(messages) if m.name == "EPOCH"]
        expected = np.array([gold_chips(code, degree) for code in codes_of(degree)]) @ made.field / made.chips * COUNT_T
        settled = reports[-cycles - 2 : -1]
        numbers = [messages[i].signals["cycle"] for i in settled]
        time_s = int((1800 * MS - FIRST_EDGE) * 1e-12 / (made.chips * chip_seconds(PPM)))
        assert np.diff(numbers).tolist() == [1] * (len(numbers) - 1)
        assert abs(numbers[-1] - (2**20 - 64 + time_s) % 2**20) <= 2
        for i in settled:
            status, fields = messages[i + 1], messages[i + 3 : i + 6]
            assert (status.signals["chips"], status.signals["fields"], status.signals["locked"]) == (made.chips, 3, 1)
            assert [m.index for m in fields] == codes_of(degree)
            got = np.array([[m.signals[axis] for axis in "xyz"] for m in fields])
            assert np.abs(got - expected).max() < 1e-10
        times = np.array([messages[i].signals["time"] for i in settled])
        assert np.abs(np.diff(times) - made.chips * chip_seconds(0.0)).max() < 20e-6
        # Dropped: the cycle that the clock cut short when it found the master; what a bus without listeners refused.
        counted = {m.index: m.signals["value"] for m in made.board.messages("COUNTER")}
        assert counted.get(13, 0) <= 20
        assert not counted.keys() & {4, 14}


def test_codes_beyond_the_degree_are_left_out_and_poses_then_fail() -> None:
    with world(7, 8, 0.5, code_count=3, code_list=[4, 200, 5], pose=1) as made:
        made.board.run(400 * MS)
        assert {m.index for m in made.board.messages("FIELD")} == {4, 5}
        assert {m.signals["status"] for m in made.board.messages("POSE_QUALITY")} == {4}


def test_field_synchronisation_is_for_degree_10() -> None:
    with world(6, 16, 0.9, sync_source=1) as made:
        made.board.run(800 * MS)
        assert made.board.messages("EPOCH_STATUS")[-1].signals["locked"] == 1  # By the wire.


@pytest.mark.parametrize("told", [1022, 2047])
def test_a_master_of_another_degree_is_not_followed_and_counted(told: int) -> None:
    """Even though its edges fit: the message alone says it."""
    with world(10, 1, 3.0, master=told) as made:
        made.board.run(2900 * MS)
        assert {m.signals["locked"] for m in made.board.messages("EPOCH_STATUS")} == {0}
        assert made.board.messages("HEARTBEAT")[-1].signals["state"] == 1
        [*_, counted] = [m.signals["value"] for m in made.board.messages("COUNTER") if m.index == 14]
        assert counted >= 15


@pytest.mark.parametrize(("own", "masters"), [(10, 11), (11, 10), (9, 10), (5, 6)])
def test_a_beacon_does_not_drive_beside_a_master_of_another_degree(own: int, masters: int) -> None:
    """Wire and CAN are both there, with the crystals as far apart as brings degrees 10 and 11 nearest."""
    head = beacon(Coil(), parameters={"node": 1, "sync_master": 1, "degree": masters}, ppm=-100.0)
    other = beacon(Coil(), parameters={"node": 2, "amplitude": 5.0, "degree": own}, ppm=100.0)
    Rig(head, other).run(4 * SECOND)
    assert {m.signals["enabled"] for m in other.messages("DRIVE_STATUS")} == {0}
    assert other.messages("HEARTBEAT")[-1].signals["state"] == 1
    assert max(m.signals["value"] for m in other.messages("COUNTER") if m.index == 14) >= 10
    for board in (head, other):
        board.close()


def on_a_bus(board: Board, until: int) -> None:
    """Run with a CAN bus that takes one frame after the other."""
    done, free = 0, 0
    for now in range(0, until, 50 * US):
        board.run(now)
        while done < len(board.requests):
            time, mailbox, *_ = board.requests[done]
            if max(free, time) + CAN_FRAME > now:
                break
            free = max(free, time) + CAN_FRAME
            board.can_sent(mailbox, True, now)
            done += 1


@pytest.mark.parametrize(("codes", "kept"), [(14, True), (30, False)])
def test_short_cycles_on_can_come_whole_or_not_at_all(codes: int, kept: bool) -> None:
    """Degree 5: a cycle has 3.03 ms. Serial carries every cycle, and CAN as many as fit, none torn."""
    parameters = {"code_count": codes, "code_list": list(range(codes))}
    with world(5, 32, 1.4, **parameters) as made:
        on_a_bus(made.board, 1300 * MS)
        reports = [m for m in made.board.can_messages() if m.name in ("EPOCH", "FIELD")]
        starts = [i for i, m in enumerate(reports) if m.name == "EPOCH"]
        assert {b - a for a, b in pairwise(starts)} == {1 + codes}
        serial = made.board.messages("EPOCH")
        on_can = len(starts) / len(serial)
        counted = {m.index: m.signals["value"] for m in made.board.messages("COUNTER")}
        assert (on_can > 0.98) == kept
        if kept:
            assert 13 not in counted
        else:
            assert on_can == pytest.approx(3.032 / ((3 + codes) * 0.137), rel=0.15)
            assert counted[13] > 0.2 * len(serial)
        assert 4 not in counted


def test_a_dead_bus_costs_serial_nothing_and_is_not_counted_as_full() -> None:
    with world(5, 32, 2.4, code_count=8, code_list=list(range(8))) as made:
        made.board.run(2300 * MS)
        early = {m.index: m.signals["value"] for m in made.board.messages("COUNTER") if m.index in (4, 13)}
        numbers = [m.signals["cycle"] for m in made.board.messages("EPOCH")][-500:]
        assert np.unique(np.diff(numbers) % 2**20).tolist() == [1]
        # Only until the bus is known to be dead, 0.1 s, there were reports for it that found no room.
        assert early.get(13, 0) < 40
        assert early.get(4, 0) < 5
        assert len(made.board.requests) == 1  # Still the first.
