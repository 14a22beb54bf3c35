"""More than one sync master on a bus: noticed by both, one steps back; one of another degree is ignored."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from goldfield_protocol import encode
from tests.firmware.host_rig import BEACON, MS, PIN_SYNC_OUT, SECOND, SENSOR, Board, Coil, Rig, beacon

OTHER_DEGREE, OTHER_MASTERS = 14, 17


def counters(board: Board) -> dict[int, float]:
    return {m.index: m.signals["value"] for m in board.messages("COUNTER")}


def syncs_since(board: Board, cycle: int) -> int:
    return sum(m.signals["cycle"] >= cycle for m in board.can_messages("SYNC"))


@pytest.fixture(params=["wire", "CAN"])
def pair(request: pytest.FixtureRequest) -> Iterator[tuple[Board, Board]]:
    """Two masters; the lower number drives the wire."""
    parameters = {"sync_master": 1, "amplitude": 5.0, "sync_source": 2 if request.param == "CAN" else 0}
    low = beacon(Coil(), parameters={**parameters, "node": 4, "code": 3}, ppm=-30.0)
    high = beacon(Coil(), parameters={**parameters, "node": 9, "code": 5}, ppm=40.0, power_on=33 * MS)
    yield low, high
    for board in (low, high):
        board.close()


def test_the_lowest_number_keeps_and_the_other_follows_it(pair: tuple[Board, Board]) -> None:
    low, high = pair
    rig = Rig(low, high)
    rig.run(5 * SECOND)
    assert 1 <= counters(low)[OTHER_MASTERS] <= 4
    assert 3 <= counters(high)[OTHER_MASTERS] <= 5
    assert 1 <= len(high.can_messages("SYNC")) <= 5
    assert len(low.can_messages("SYNC")) > 45
    assert [time for time in high.edges(PIN_SYNC_OUT) if time > SECOND] == []
    told = high.messages("DRIVE_STATUS")[-5:]
    assert all(m.signals["locked"] == m.signals["enabled"] == 1 for m in told)
    # Its clock is the other's: of two free ones 70 ppm apart the phase would slide by 7 us a cycle. On CAN the rig ends
    # a frame for both sides at the end of a quantum, where a receiver expects it a bit (1 us) before its end.
    phases = [m.signals["phase"] for m in told]
    assert max(phases) - min(phases) < 200
    assert max(map(abs, phases)) < 1200
    for board in (low, high):
        assert board.messages("HEARTBEAT")[-1].signals["state"] == 3


@pytest.mark.parametrize(("node", "keeps"), [(5, True), (3, False)])
@pytest.mark.parametrize("count", [2, 3])
def test_one_stray_sync_makes_no_master_step_back(node: int, keeps: bool, count: int) -> None:
    board = Board(BEACON, {"node": 4, "sync_master": 1}, volts=lambda pin, time: 1.65)
    for number in range(count):
        signals = {"cycle": 70 + number, "chips": 1023, "chip_period": 97750.0}
        board.can_in(*encode("SYNC", signals, node=node), 500 * MS + number * 100 * MS)
    late = {"cycle": 99, "chips": 1023, "chip_period": 97750.0}
    board.can_in(*encode("SYNC", late, node=node), 500 * MS + (count - 1) * 100 * MS + 1100 * MS)
    board.run(3 * SECOND)
    told = board.messages("SYNC")
    assert (len(told) > 25) == (keeps or count == 2)
    assert counters(board)[OTHER_MASTERS] >= 2
    board.close()


@pytest.mark.parametrize("sound", [True, False])
def test_a_master_of_another_degree_disturbs_only_a_wire_without_a_sound_master(sound: bool) -> None:
    """Its messages come between those of the wire's master, or alone."""
    head = Board(BEACON, {"node": 1, "sync_master": 1}, volts=lambda pin, time: 1.65, can=sound)
    sensor = Board(SENSOR, {"node": 100, "code_count": 0}, volts=lambda pin, time: 1.65)
    for number in range(40):
        signals = {"cycle": number, "chips": 2047, "chip_period": 97750.0}
        sensor.can_in(*encode("SYNC", signals, node=7), 1037 * MS + number * 90 * MS)
    Rig(head, sensor).run(4600 * MS)
    locked = [m.signals["locked"] for m in sensor.messages("EPOCH_STATUS")]
    cycles = [m.signals["cycle"] for m in sensor.messages("EPOCH")]
    assert counters(sensor)[OTHER_DEGREE] >= 30
    if sound:
        assert locked[-36:] == [1] * 36
        assert cycles[-36:] == list(range(int(cycles[-1]) - 35, int(cycles[-1]) + 1))
    else:
        assert locked[-25:] == [0] * 25
    for board in (head, sensor):
        board.close()
