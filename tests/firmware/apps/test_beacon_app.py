"""The beacon application on host boards: code on the pins, lock of a follower, current, protections."""

from __future__ import annotations

import crcmod.predefined
import numpy as np
import pytest

from goldfield_protocol.messages import database
from tests.firmware.host_rig import (
    CHIPS,
    LISTENS,
    MS,
    PIN_BRIDGE_1,
    PIN_BRIDGE_2,
    PIN_ENABLE,
    PIN_FAULT,
    PIN_SYNC_OUT,
    PINS_BRIDGE,
    SECOND,
    US,
    Board,
    Coil,
    Rig,
    beacon,
    chip_seconds,
    gold_chips,
)

CAUSES = [
    str(name) for name in database().get_message_by_name("DRIVE_HEALTH").get_signal_by_name("cause").choices.values()
]
CHIP = round(chip_seconds(0) * 1e12)
MASTER = {"node": 1, "code": 2, "amplitude": 8.0, "sync_master": 1}
FOLLOWER = {"node": 2, "code": 1018, "amplitude": 8.0}


def master(boards: list[Board], coil: Coil | None = None, **options: object) -> Board:
    parameters = {**MASTER, **options.pop("parameters", {})}  # type: ignore[dict-item]
    boards.append(beacon(coil or Coil(), parameters=parameters, **options))
    return boards[-1]


def polarity(board: Board, times: np.ndarray) -> np.ndarray:
    """Current's sign that the bridge asks for at given times: +1, -1, 0."""
    result = np.zeros(len(times), dtype=np.int64)
    for pin, sign in ((PIN_BRIDGE_1, 1), (PIN_BRIDGE_2, -1)):
        changes = [(time, level) for time, number, level in board.pins if number == pin]
        at = np.searchsorted([time for time, _ in changes], times, side="right") - 1
        result += sign * np.array([changes[i][1] if i >= 0 else False for i in at])
    return result


def status(board: Board) -> dict[str, float]:
    return dict(board.messages("DRIVE_STATUS")[-1].signals)


def test_master_drives_its_code_from_sync_edge(boards: list[Board]) -> None:
    board = master(boards, ppm=30.0)
    board.run(LISTENS + SECOND)
    edges = board.edges(PIN_SYNC_OUT)
    period = CHIPS * chip_seconds(30.0) * 1e12
    assert np.abs(np.diff(edges) - period).max() <= 1  # Zero jitter: the picosecond is this test's rounding.
    assert 0 <= LISTENS - edges[0] < 8 * MS
    for edge in edges[1:9]:
        middles = np.array([edge + round((t + 0.5) * period / CHIPS) for t in range(CHIPS)])
        assert (polarity(board, middles) == gold_chips(2)).all()
    falls = board.edges(PIN_SYNC_OUT, False)
    assert falls[0] - edges[0] == pytest.approx(CHIP, rel=1e-4)


@pytest.mark.parametrize(("degree", "cycles"), [(5, 32), (6, 16), (7, 8), (9, 2), (11, 1)])
def test_other_degrees_by_sync_periods(boards: list[Board], degree: int, cycles: int) -> None:
    """The sync wire and SYNC mark every so-and-so-many cycle; the code goes on through all of them."""
    chips, code = 2**degree - 1, 2**degree - 3
    board = master(boards, parameters={"degree": degree, "code": code})
    follower = beacon(Coil(), parameters={**FOLLOWER, "degree": degree, "code": 3}, ppm=80.0, power_on=3 * MS)
    boards.append(follower)
    Rig(board, follower, quantum=100 * US).run(2000 * MS)
    edges = board.edges(PIN_SYNC_OUT)
    period = chips * cycles * chip_seconds(0.0) * 1e12
    assert np.abs(np.diff(edges) - period).max() <= 1
    messages = board.messages("SYNC")
    assert [m.signals["cycle"] for m in messages] == list(range(0, len(messages) * cycles, cycles))
    assert {m.signals["chips"] for m in messages} == {chips}
    sent = [time for time, _, identifier, _ in board.requests if identifier >> 24 == 1]
    assert all(0 <= s - edge < 7 * MS for s, edge in zip(sent[1:], edges[1:], strict=False))
    middles = np.array([edges[-2] + round((t + 0.5) * period / chips / cycles) for t in range(chips * cycles)])
    assert (polarity(board, middles) == np.tile(gold_chips(code, degree), cycles)).all()
    assert (polarity(follower, middles) == np.tile(gold_chips(3, degree), cycles)).all()


def test_a_code_beyond_the_degree_is_a_fault(boards: list[Board]) -> None:
    board = master(boards, parameters={"degree": 7, "code": 129})
    board.run(1100 * MS)
    assert board.messages("HEARTBEAT")[-1].signals["state"] == 4
    assert not board.level.get(PIN_BRIDGE_1)


def test_both_bridge_inputs_are_never_high(boards: list[Board]) -> None:
    board = master(boards)
    board.run(300 * MS)
    high: dict[int, bool] = {}
    by_time: dict[int, list[tuple[int, bool]]] = {}
    for time, pin, level in board.pins:
        by_time.setdefault(time, []).append((pin, level))
    for changes in by_time.values():
        high.update(changes)
        assert not (high.get(PIN_BRIDGE_1) and high.get(PIN_BRIDGE_2))


def test_sync_message_numbers_each_cycle_right_after_its_edge(boards: list[Board]) -> None:
    board = master(boards)
    Rig(board, quantum=100 * US).run(1010 * MS)
    messages = board.messages("SYNC")
    assert [m.signals["cycle"] for m in messages] == list(range(len(messages)))
    assert messages[0].signals["chips"] == CHIPS
    assert messages[0].signals["chip_period"] == pytest.approx(97750.0)
    edges = board.edges(PIN_SYNC_OUT)
    requests = [time for time, _, identifier, _ in board.requests if identifier >> 24 == 1]
    assert len(requests) == len(edges) == len(messages)
    # The first waits for the hello on the bus.
    assert all(0 <= request - edge < 400 * US for request, edge in zip(requests, edges, strict=True))


def test_first_message_is_a_heartbeat_with_number_from_unique_id(boards: list[Board]) -> None:
    for unique in (bytes(range(12)), bytes(range(1, 13))):
        boards.append(Board(0, {}, unique_id=unique))
        boards[-1].run(5 * MS)
    first, second = (board.messages()[0] for board in boards)
    assert first.name == second.name == "HEARTBEAT"
    crc = crcmod.predefined.mkPredefinedCrcFun("crc-ccitt-false")
    assert (first.node, second.node) == (1 + crc(bytes(range(12))) % 4095, 1 + crc(bytes(range(1, 13))) % 4095)
    assert first.signals["role"] == 0
    assert first.signals["version_minor"] == 1


@pytest.mark.parametrize("ppm", [-100.0, 100.0])
def test_follower_locks_to_master(boards: list[Board], ppm: float) -> None:
    head = master(boards, ppm=-ppm)
    follower = beacon(Coil(), parameters=FOLLOWER, ppm=ppm, power_on=37 * MS + 1_234_567)
    boards.append(follower)
    rig = Rig(head, follower)
    rig.run(1500 * MS)
    report = status(follower)
    assert report["locked"] == 1
    assert report["enabled"] == 1
    assert abs(report["phase"]) <= 60
    edge = head.edges(PIN_SYNC_OUT)[-2]
    period = chip_seconds(-ppm) * 1e12
    middles = np.array([edge + round((t + 0.5) * period) for t in range(CHIPS)])
    assert (polarity(follower, middles) == gold_chips(1018)).all()
    # Where the follower's chip edges lie against the master's, over the last three cycles.
    flips = np.array([t for t in follower.edges(PIN_BRIDGE_1) if t > head.edges(PIN_SYNC_OUT)[-4]])
    phase = (flips - head.edges(PIN_SYNC_OUT)[-4]) % period
    phase = np.minimum(phase, period - phase)
    assert phase.max() < 0.1 * US


def test_follower_does_not_drive_before_lock(boards: list[Board]) -> None:
    follower = beacon(Coil(), parameters=FOLLOWER)
    boards.append(follower)
    follower.run(2 * SECOND)
    assert not follower.edges(PIN_ENABLE)
    assert not follower.edges(PIN_BRIDGE_1)
    assert not follower.edges(PIN_BRIDGE_2)
    assert status(follower)["locked"] == 0
    assert follower.messages("HEARTBEAT")[-1].signals["state"] == 1


def test_soft_start_then_amplitude_with_gain_error(boards: list[Board]) -> None:
    board = master(boards, Coil(gain=0.9))
    board.run(SECOND)
    on = board.edges(PIN_ENABLE)
    assert len(on) == 1
    volts = np.array([v for _, v in board.analog[0]])
    times = np.array([t for t, _ in board.analog[0]])
    ramp = volts[times < on[0] + 90 * MS] / 3.3 * 16.0
    assert ramp[0] == 0
    assert (np.diff(ramp) < 1.0).all()
    assert ramp.max() < 8.0
    report = status(board)
    assert report["target"] == pytest.approx(8.0)
    assert report["current"] == pytest.approx(8.0, abs=0.02)
    assert report["reference"] == pytest.approx(8.0 / 0.9, abs=0.03)
    states = [m.signals["state"] for m in board.messages("HEARTBEAT")]
    assert states[0] == 0
    board.run(2100 * MS)
    assert board.messages("HEARTBEAT")[-1].signals["state"] == 3


@pytest.mark.parametrize(
    ("coil", "flag", "counter"),
    [
        (Coil(extra_A=6.0, extra_from=500 * MS), "over_current", 11),
        (Coil(broken_from=500 * MS), "open_coil", 12),
    ],
)
def test_protection_switches_off_within_one_chip(boards: list[Board], coil: Coil, flag: str, counter: int) -> None:
    board = master(boards, coil)
    board.run(1200 * MS)
    off = board.edges(PIN_ENABLE, False)
    assert len(off) == 1
    assert 500 * MS <= off[0] <= 500 * MS + CHIP
    assert len(board.edges(PIN_ENABLE)) == 1
    report = status(board)
    assert report[flag] == 1
    assert report["enabled"] == 0
    assert report["current"] == 0
    assert sum(report[f] for f in ("over_current", "open_coil", "driver_fault")) == 1
    assert board.messages("HEARTBEAT")[-1].signals["state"] == 4
    assert {m.index: m.signals["value"] for m in board.messages("COUNTER")} == {counter: 1}


def test_driver_fault_switches_off_at_once(boards: list[Board]) -> None:
    board = master(boards)
    board.pin(PIN_FAULT, False, 500 * MS)
    board.run(SECOND)
    assert board.edges(PIN_ENABLE, False) == [500 * MS]
    assert status(board)["driver_fault"] == 1
    assert status(board)["enabled"] == 0


def test_a_clear_and_not_a_new_amplitude_ends_a_fault(boards: list[Board]) -> None:
    board = master(boards)
    board.pin(PIN_FAULT, False, 500 * MS)
    board.pin(PIN_FAULT, True, 510 * MS)
    board.send_serial("PARAM_SET", {"kind": 2, "value_float": 5.0}, 1, 2, 700 * MS)
    board.run(1600 * MS)
    assert len(board.edges(PIN_ENABLE)) == 1
    assert status(board)["driver_fault"] == 1
    board.clear(1600 * MS)
    board.run(2100 * MS)
    assert len(board.edges(PIN_ENABLE)) == 2
    report = status(board)
    assert report["driver_fault"] == 0
    assert report["current"] == pytest.approx(5.0, abs=0.02)


def test_lost_wire_is_held_over_and_then_ends_the_drive(boards: list[Board]) -> None:
    head = master(boards)
    follower = beacon(Coil(), parameters=FOLLOWER, ppm=20.0)
    boards.append(follower)
    Rig(head, follower).run(1500 * MS)
    assert status(follower)["enabled"] == 1
    follower.run(5 * SECOND)
    assert status(follower)["enabled"] == 1
    follower.run(14 * SECOND)
    assert status(follower)["locked"] == 0
    assert status(follower)["enabled"] == 0
    assert follower.messages("HEARTBEAT")[-1].signals["state"] == 1


def test_code_set_at_run_time(boards: list[Board]) -> None:
    board = master(boards)
    board.send_serial("PARAM_SET", {"kind": 0, "value_unsigned": 77}, 1, 1, LISTENS + 350 * MS)
    board.run(LISTENS + 900 * MS)
    period = CHIPS * CHIP
    edge = board.edges(PIN_SYNC_OUT)[7]
    middles = np.array([edge + round((t + 0.5) * period / CHIPS) for t in range(CHIPS)])
    assert (polarity(board, middles) == gold_chips(77)).all()
    assert np.abs(np.diff(board.edges(PIN_SYNC_OUT)) - CHIPS * chip_seconds(0) * 1e12).max() <= 1


def test_zero_amplitude_is_off(boards: list[Board]) -> None:
    board = master(boards, parameters={"amplitude": 0.0})
    board.run(LISTENS + 500 * MS)
    assert not board.edges(PIN_ENABLE)
    assert len(board.edges(PIN_SYNC_OUT)) == 6
    assert status(board)["target"] == 0


def driven(board: Board, edge: int) -> np.ndarray:
    """What the bridge does in the middle of each chip of the cycle that begins at an edge of the sync wire."""
    return polarity(board, np.array([edge + round((t + 0.5) * chip_seconds(0) * 1e12) for t in range(CHIPS)]))


def test_a_pulse_in_its_time_slot_at_the_right_current(boards: list[Board]) -> None:
    """TDMA: on in one of nine slots, off elsewhere; the current loop sees its chips alone and settles."""
    board = master(boards, Coil(gain=1.1), parameters={"waveform": 1, "slots": 9, "slot": 4})
    board.run(3 * SECOND)
    edges = board.edges(PIN_SYNC_OUT)
    expected = np.array([1 if t // (CHIPS // 9) == 4 else 0 for t in range(CHIPS)])
    for edge in edges[2:9]:
        np.testing.assert_array_equal(driven(board, edge), expected)
    assert status(board)["enabled"] == 1
    assert status(board)["current"] == pytest.approx(8.0, abs=0.02)
    assert status(board)["open_coil"] == status(board)["over_current"] == 0


def test_an_open_coil_is_found_in_its_slot(boards: list[Board]) -> None:
    board = master(boards, Coil(broken_from=2 * SECOND), parameters={"waveform": 1, "slots": 9, "slot": 4})
    board.run(2 * SECOND - MS)
    assert status(board)["open_coil"] == 0
    board.run(2 * SECOND + 200 * MS)
    assert status(board)["open_coil"] == 1


def test_a_square_wave_of_whole_periods(boards: list[Board]) -> None:
    """FDMA: the sign of a cosine with seven periods in a cycle; a change to another waveform by PARAM_SET alone."""
    board = master(boards, parameters={"waveform": 2, "periods": 7})
    board.run(LISTENS + 500 * MS)
    edges = board.edges(PIN_SYNC_OUT)
    np.testing.assert_array_equal(driven(board, edges[2]), np.sign(np.cos(2.0 * np.pi * 7 * np.arange(CHIPS) / CHIPS)))
    board.send_serial("PARAM_SET", {"kind": 0, "value_unsigned": 0}, 1, 13, LISTENS + 510 * MS)
    board.run(LISTENS + SECOND)
    edges = board.edges(PIN_SYNC_OUT)
    np.testing.assert_array_equal(driven(board, edges[8]), gold_chips(2))


def test_a_slot_that_does_not_exist_is_a_fault(boards: list[Board]) -> None:
    board = master(boards, parameters={"waveform": 1, "slots": 9, "slot": 9})
    board.run(1200 * MS)
    assert board.messages("HEARTBEAT")[-1].signals["state"] == 4
    assert not status(board)["enabled"]
    board.send_serial("PARAM_SET", {"kind": 0, "value_unsigned": 8}, 1, 15, 1210 * MS)
    board.run(2400 * MS)
    assert board.messages("HEARTBEAT")[-1].signals["state"] != 4
    assert status(board)["enabled"] == 1


def drives(board: Board, times: np.ndarray, channel: int) -> np.ndarray:
    """Current that bridge and set-point of a channel ask for at given times, A."""
    result = np.zeros(len(times))
    for pin, sign in zip(PINS_BRIDGE[channel], (1, -1), strict=True):
        changes = [(time, level) for time, number, level in board.pins if number == pin]
        at = np.searchsorted([time for time, _ in changes], times, side="right") - 1
        result += sign * np.array([changes[i][1] if i >= 0 else False for i in at])
    steps = board.analog[channel]
    at = np.searchsorted([time for time, _ in steps], times, side="right") - 1
    return result * np.array([steps[i][1] for i in at]) / 3.3 * 16.0


def asked(board: Board, edge: int, chips: int = CHIPS, channel: int = 0) -> np.ndarray:
    """What a channel asks for in the middle of each chip of the cycle that begins at an edge of the sync wire, A."""
    return drives(board, np.array([edge + round((t + 0.5) * chip_seconds(0) * 1e12) for t in range(chips)]), channel)


def statuses(board: Board) -> dict[int, dict[str, float]]:
    """The latest DRIVE_STATUS of each channel."""
    return {m.index: dict(m.signals) for m in board.messages("DRIVE_STATUS")}


@pytest.mark.parametrize(("degree", "periods"), [(11, 5), (10, 37)])
def test_a_rotating_field_of_two_sinusoids(boards: list[Board], degree: int, periods: int) -> None:
    """Two drivers, each with a gain error of its own: the currents are the same and a quarter of a period apart."""
    chips = 2**degree - 1
    first, second = Coil(gain=0.93), Coil(gain=1.08)
    parameters = {**MASTER, "waveform": 3, "periods": periods, "degree": degree}
    board = beacon(first, second, parameters=parameters)
    boards.append(board)
    board.run(SECOND)
    edge = board.edges(PIN_SYNC_OUT)[-2]
    turn = 2.0 * np.pi * periods * np.arange(chips) / chips
    for channel, (coil, wave) in enumerate(((first, np.cos(turn)), (second, np.sin(turn)))):
        current = coil.gain * asked(board, edge, chips, channel)
        assert np.abs(current - 8.0 * wave).max() < 0.02
        report = statuses(board)[channel]
        assert report["current"] == pytest.approx(8.0, abs=0.01)
        assert report["reference"] == pytest.approx(8.0 / coil.gain, abs=0.02)
        assert report["target"] == 8.0
        assert report["enabled"] == 1
        assert report["open_coil"] == report["over_current"] == 0
    assert sorted(statuses(board)) == [0, 1]


@pytest.mark.parametrize(
    ("coil", "causes"),
    [(Coil(broken_from=500 * MS), {"open_coil"}), (Coil(extra_A=6.0, extra_from=500 * MS), {"over_current", "excess"})],
)
@pytest.mark.parametrize("channel", [0, 1])
def test_a_fault_of_either_coil_stops_both(boards: list[Board], coil: Coil, causes: set[str], channel: int) -> None:
    coils = [Coil(), Coil()]
    coils[channel] = Coil(broken_from=coil.broken_from, extra_A=coil.extra_A, extra_from=coil.extra_from)
    board = beacon(*coils, parameters={**MASTER, "waveform": 3, "periods": 20})
    boards.append(board)
    board.run(1200 * MS)
    [off] = board.edges(PIN_ENABLE, False)
    # Half a period has 25.6 chips; near its ends the current is too small to judge.
    assert 500 * MS <= off <= 500 * MS + 26 * CHIP
    reports = statuses(board)
    health = {m.index: CAUSES[int(m.signals["cause"])] for m in board.messages("DRIVE_HEALTH")}
    assert health[channel] in causes
    assert health[1 - channel] == "none"
    assert all(report["enabled"] == 0 and report["current"] == 0 for report in reports.values())
    assert board.messages("HEARTBEAT")[-1].signals["state"] == 4


def test_superposed_codes_share_the_amplitude(boards: list[Board]) -> None:
    codes = [(10, 700, 3, 1), (5, 7, 30, 33), (10, 2, 0, 1)]
    board = master(boards, Coil(gain=1.05), parameters={"waveform": 4, "codes": [n for code in codes for n in code]})
    board.run(LISTENS + SECOND)
    expected = np.zeros(CHIPS)
    for degree, index, offset, hold in codes:
        own = gold_chips(index, degree)
        expected += [own[(t // hold + offset) % len(own)] / len(codes) for t in range(CHIPS)]
    assert np.abs(1.05 * asked(board, board.edges(PIN_SYNC_OUT)[8]) - 8.0 * expected).max() < 0.02
    assert status(board)["current"] == pytest.approx(8.0, abs=0.02)
    assert statuses(board).keys() == {0}


def test_codes_that_do_not_fit_the_cycle_are_a_fault(boards: list[Board]) -> None:
    board = master(boards, parameters={"waveform": 4, "codes": [7, 0, 0, 1]})
    board.run(1200 * MS)
    assert board.messages("HEARTBEAT")[-1].signals["state"] == 4
    assert not status(board)["enabled"]
    board.send_serial("PARAM_SET", {"kind": 0, "value_unsigned": 10}, 1, 320, 1210 * MS)
    board.run(2400 * MS)
    assert status(board)["enabled"] == 1
    np.testing.assert_array_equal(driven(board, board.edges(PIN_SYNC_OUT)[-2]), gold_chips(0))
