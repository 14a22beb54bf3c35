"""What switches a beacon's drive off on a host board, what brings it back, and what does not.

``pytest -m slow -s tests/firmware/services/test_protection.py`` prints how soon a hundred faults of each kind act, on
host boards and on emulated ones.

The tests whose names end in `_as_on_silicon` are faults that the firmware once drove on with.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from goldfield_protocol.messages import database
from hil_sim.clib import load
from tests.bench.drive_figures import WAVEFORMS, CoilBoard
from tests.firmware.host_rig import (
    CHIPS,
    LISTENS,
    MS,
    PIN_COIL_TEMPERATURE,
    PIN_DRIVER_TEMPERATURE,
    PIN_ENABLE,
    PIN_FAULT,
    PIN_SUPPLY,
    SECOND,
    US,
    Board,
    Coil,
    beacon,
    chip_seconds,
)

CHIP = round(chip_seconds(0) * 1e12)
CAUSES = database().get_message_by_name("DRIVE_HEALTH").get_signal_by_name("cause").choices
PARAMETERS = {"node": 1, "code": 2, "amplitude": 8.0, "sync_master": 1}
NEVER = 1 << 62
RUNNING, FAULT = 3, 4


@pytest.fixture
def make() -> Iterator[Callable[..., Board]]:
    boards: list[Board] = []

    def made(coil: Coil | None = None, **options: object) -> Board:
        parameters = {**PARAMETERS, **options.pop("parameters", {})}  # type: ignore[dict-item]
        boards.append(beacon(coil or Coil(), parameters=parameters, **options))
        return boards[-1]

    yield made
    for board in boards:
        board.close()


def health(board: Board) -> dict[str, float]:
    return dict(board.messages("DRIVE_HEALTH")[-1].signals)


def cause(board: Board) -> str:
    return str(CAUSES[int(health(board)["cause"])])


def state(board: Board) -> int:
    return int(board.messages("HEARTBEAT")[-1].signals["state"])


def answers(board: Board) -> list[int]:
    """What became of the commands so far: 0 done, 1 unknown, 2 refused."""
    return [int(m.signals["status"]) for m in board.messages("COMMAND_ANSWER")]


def thermistor_volts(degC: float) -> float:
    return float(load("build/libgf_rig.so", ["world/coil.h"])[1].thermistor_volts(degC))


def step(before: float, after: float, time: int) -> Callable[[int], float]:
    return lambda now: after if now >= time else before


# ---- Shown on silicon ----


def test_a_fault_pin_that_is_still_low_keeps_off_whatever_parameter_comes_as_on_silicon(
    make: Callable[..., Board],
) -> None:
    board = make()
    board.pin(PIN_FAULT, False, 500 * MS)
    board.send_serial("PARAM_SET", {"kind": 2, "value_float": 2000.0}, 1, 8, 700 * MS)
    board.clear(2500 * MS)
    board.run(4 * SECOND)
    assert board.edges(PIN_ENABLE, False) == [500 * MS]
    assert len(board.edges(PIN_ENABLE)) == 1
    assert answers(board) == [2]
    assert (state(board), cause(board)) == (FAULT, "driver")
    board.pin(PIN_FAULT, True, 4100 * MS)
    board.clear(4200 * MS)
    board.run(5500 * MS)
    assert answers(board) == [2, 0]
    assert len(board.edges(PIN_ENABLE)) == 2
    assert (state(board), cause(board)) == (RUNNING, "none")


def test_a_fault_pin_that_was_low_before_the_board_had_power_is_seen(make: Callable[..., Board]) -> None:
    board = make(power_on=10 * MS)
    board.pin(PIN_FAULT, False, 5 * MS)
    board.run(1500 * MS)
    assert not board.edges(PIN_ENABLE)
    assert (state(board), cause(board)) == (FAULT, "driver")


def test_a_broadcast_parameter_does_not_clear_an_over_current_as_on_silicon(make: Callable[..., Board]) -> None:
    coil = Coil(extra_A=6.0, extra_from=500 * MS)
    board = make(coil)
    board.send_serial("PARAM_SET", {"kind": 2, "value_float": 2000.0}, 0, 8, 700 * MS)
    board.send_serial("PARAM_SET", {"kind": 2, "value_float": 6.0}, 1, 2, 800 * MS)
    board.clear(1700 * MS, node=0)
    board.clear(1800 * MS, board=0)
    board.clear(1900 * MS, board=12345)
    board.run(3 * SECOND)
    assert len(board.edges(PIN_ENABLE)) == 1
    assert answers(board) == [2, 2]  # The third names another board.
    assert cause(board) == "over_current"
    coil.extra_from = NEVER
    board.clear(3100 * MS)
    board.run(4100 * MS)
    assert answers(board)[-1] == 0
    assert len(board.edges(PIN_ENABLE)) == 2


@pytest.mark.parametrize("current", [0.0, 15.99])
def test_a_current_that_is_not_measured_ends_the_drive_within_two_chips_as_on_silicon(
    make: Callable[..., Board], current: float
) -> None:
    board = make()
    board.run(500 * MS)
    board.fail("CURRENT_STOPS")
    board.run(1600 * MS)
    [off] = board.edges(PIN_ENABLE, False)
    assert 500 * MS < off <= 500 * MS + 3 * CHIP  # Two whole chips, after the one that is under way.
    assert cause(board) == "stale"
    board.fail("CURRENT_STOPS", active=False)
    board.clear(1700 * MS)
    board.run(2500 * MS)
    assert len(board.edges(PIN_ENABLE)) == 2


def test_a_current_in_the_slots_of_others_ends_the_drive_as_on_silicon(make: Callable[..., Board]) -> None:
    """15.9 A from a driver that stays on outside the board's slot."""
    board = make(
        Coil(stray_A=15.9, stray_from=530 * MS), parameters={"waveform": 1, "slots": 9, "slot": 0, "over_current": 12.0}
    )
    board.run(1200 * MS)
    [off] = board.edges(PIN_ENABLE, False)
    assert 530 * MS < off <= 530 * MS + CHIP
    assert cause(board) == "over_current"


@pytest.mark.parametrize(("amperes", "why"), [(15.9, "over_current"), (-0.6, "excess")])
def test_a_current_with_the_bridge_off_is_told_as_on_silicon(
    make: Callable[..., Board], amperes: float, why: str
) -> None:
    board = make(Coil(stray_A=amperes, stray_from=30 * MS), parameters={"amplitude": 0.0})
    board.run(1500 * MS)
    assert not board.edges(PIN_ENABLE)
    assert (state(board), cause(board)) == (FAULT, why)


def test_a_sagging_supply_is_told_as_on_silicon(make: Callable[..., Board]) -> None:
    """The current falls to 6 of 8 A: not running as if nothing were; and running again when it is back."""
    coil = Coil()
    board = make(coil)
    board.run(1100 * MS)
    assert health(board)["headroom_lost"] == 0
    plain = coil.amperes
    coil.amperes = lambda time: float(np.clip(plain(time), -6.0, 6.0))  # type: ignore[method-assign]
    board.run(1300 * MS)
    assert health(board)["headroom_lost"] == 1
    assert dict(board.messages("DRIVE_STATUS")[-1].signals)["enabled"] == 1
    coil.amperes = plain  # type: ignore[method-assign]
    board.run(1800 * MS)
    assert health(board)["headroom_lost"] == 0
    assert dict(board.messages("DRIVE_STATUS")[-1].signals)["current"] == pytest.approx(8.0, abs=0.01)


def test_a_hung_main_loop_is_not_energised_for_ever_as_on_silicon(make: Callable[..., Board]) -> None:
    """Whenever the drive is on, main hangs, and the watchdog strikes 0.5 s later: it waits longer, then for ever."""
    board = make()
    board.run(400 * MS)
    assert len(board.edges(PIN_ENABLE)) == 1
    starts = []
    for trip in range(1, 6):
        board.fail("MAIN_HANGS")
        hung = board.operations.now(board.handle)
        board.run(hung + 510 * MS)
        assert not board.level[PIN_ENABLE]
        board.fail("MAIN_HANGS", active=False)
        board.run(hung + 510 * MS + (2 ** (trip - 1)) * SECOND + 400 * MS)
        starts.append(len(board.edges(PIN_ENABLE)))
        waited = (board.edges(PIN_ENABLE)[-1] - hung - 500 * MS) / SECOND
        if trip < 5:
            assert 2 ** (trip - 1) <= waited <= 2 ** (trip - 1) + 0.3
    assert starts == [2, 3, 4, 5, 5]
    board.clear(board.operations.now(board.handle) + MS)
    board.run(board.operations.now(board.handle) + 20 * SECOND)
    assert len(board.edges(PIN_ENABLE)) == 5
    assert (health(board)["locked_out"], cause(board)) == (1, "watchdog")
    assert answers(board)[-1] == 2


def test_a_main_loop_that_hangs_at_every_start_drives_once(make: Callable[..., Board]) -> None:
    board = make()
    board.run(LISTENS + 50 * MS)
    board.fail("MAIN_HANGS")
    board.run(10 * SECOND)
    assert len(board.edges(PIN_ENABLE)) == 1
    assert board.edges(PIN_ENABLE, False)[0] <= LISTENS + 560 * MS


# ---- Each protection ----


def ntc(pin: int) -> Callable[[int], dict[str, object]]:
    hot, cold = thermistor_volts(150.0), thermistor_volts(25.0)
    return lambda time: {"pins": {pin: step(cold, hot, time)}}


PROTECTIONS: dict[str, Callable[[int], dict[str, object]]] = {
    "over_current": lambda time: {"coil": Coil(extra_A=4.5, extra_from=time)},
    "excess": lambda time: {"coil": Coil(extra_A=4.5, extra_from=time), "parameters": {"over_current": 15.9}},
    "open_coil": lambda time: {"coil": Coil(broken_from=time)},
    "coil_hot": lambda time: ntc(PIN_COIL_TEMPERATURE[0])(time),
    "driver_hot": lambda time: ntc(PIN_DRIVER_TEMPERATURE)(time),
    "supply_low": lambda time: {"pins": {PIN_SUPPLY: step(1.65, 9.0 * 3.3 / 160.0, time)}},
    "supply_high": lambda time: {"pins": {PIN_SUPPLY: step(1.65, 151.0 * 3.3 / 160.0, time)}},
}


def off_after(make: Callable[..., Board], name: str, time: int) -> tuple[int, Board]:
    """Return how long after its beginning a fault ended the drive, ps."""
    board = make(**PROTECTIONS[name](time))
    board.run(time + 20 * MS)
    [off] = board.edges(PIN_ENABLE, False)
    return off - time, board


@pytest.mark.parametrize("name", PROTECTIONS)
def test_each_protection_acts_within_a_chip_and_stays(make: Callable[..., Board], name: str) -> None:
    late, board = off_after(make, name, 443_210 * US)
    assert 0 <= late <= CHIP
    board.run(2 * SECOND)
    assert (state(board), cause(board)) == (FAULT, name)
    assert len(board.edges(PIN_ENABLE)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PROTECTIONS, "driver", "stale"])
def test_a_hundred_of_a_hundred_are_off_within_a_chip(make: Callable[..., Board], name: str) -> None:
    """At random phases of chip and code; the fault input at once, a missing measurement after two whole chips."""
    rng = np.random.default_rng(12)
    worst = 0
    for _ in range(100):
        time = LISTENS + 210 * MS + int(rng.integers(0, CHIPS * CHIP))
        if name in PROTECTIONS:
            late, board = off_after(make, name, time)
        else:
            board = make()
            if name == "driver":
                board.pin(PIN_FAULT, False, time)
            board.run(time)
            if name == "stale":
                board.fail("CURRENT_STOPS")
            board.run(time + 20 * MS)
            late = board.edges(PIN_ENABLE, False)[0] - time
        worst = max(worst, late)
        assert len(board.edges(PIN_ENABLE)) == 1
        board.close()
        board.close = lambda: None  # type: ignore[method-assign]
    print(f"{name}, host board: 100 of 100, off after {worst / US:.1f} us at most")
    assert worst <= {"driver": 0, "stale": 3 * CHIP}.get(name, CHIP)


AT_ONCE = US
"""What hardware or an interrupt of its own switches off on an emulated board."""


def beset(board: Board, name: str, time: int) -> None:
    """Let something befall an emulated board that is no analog input's affair."""
    if name == "driver":
        board.pin(PIN_FAULT, False, time)
    elif name == "clock":
        board.emulator.crystal(False, time)
    else:
        board.emulator.supply(2.75, time)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*PROTECTIONS, "driver", "clock", "supply"])
def test_a_hundred_of_a_hundred_are_off_within_a_chip_on_the_image(make: Callable[..., Board], name: str) -> None:
    """At random phases of chip and code; what hardware or an interrupt of its own does is at once."""
    rng = np.random.default_rng(13)
    worst = 0
    for _ in range(100):
        time = LISTENS + 210 * MS + int(rng.integers(0, CHIPS * CHIP))
        sampled = name in PROTECTIONS
        board = make(emulated=True, **(PROTECTIONS[name](time) if sampled else {}))
        board.run(time - 5 * MS)
        assert board.level[PIN_ENABLE]
        if not sampled:
            beset(board, name, time)
        board.run(time + 20 * MS)
        [off] = board.edges(PIN_ENABLE, False)
        assert len(board.edges(PIN_ENABLE)) == 1
        worst = max(worst, off - time)
        assert 0 <= off - time <= (CHIP if sampled else AT_ONCE)
        board.close()
        board.close = lambda: None  # type: ignore[method-assign]
    print(f"{name}, emulated board: 100 of 100, off after {worst / US:.1f} us at most")


def test_the_mean_square_of_the_current_is_limited(make: Callable[..., Board]) -> None:
    board = make(parameters={"rms_current": 7.0, "rms_time": 1.0})
    board.run(5 * SECOND)
    [on], [off] = board.edges(PIN_ENABLE), board.edges(PIN_ENABLE, False)
    # (7/8)^2 = 1 - exp(-t / 1 s), begun two thirds of the ramp of 0.1 s late: its mean square is a third.
    assert (off - on) / SECOND == pytest.approx(-np.log(1.0 - (7.0 / 8.0) ** 2) + 0.067, abs=0.02)
    assert cause(board) == "overload"
    assert health(board)["rms"] < 7.0  # It has cooled down since.


def test_a_thermistor_that_is_not_connected_ends_the_drive_unless_it_is_not_watched(make: Callable[..., Board]) -> None:
    pins = {PIN_COIL_TEMPERATURE[0]: lambda _: 3.3}
    watched, unwatched = make(pins=pins), make(pins=pins, parameters={"coil_hot": 0.0})
    for board in (watched, unwatched):
        board.run(1200 * MS)
    assert cause(watched) == "coil_hot"
    assert not watched.edges(PIN_ENABLE)
    assert state(unwatched) == RUNNING


def test_what_is_measured_is_told(make: Callable[..., Board]) -> None:
    pins = {
        PIN_SUPPLY: lambda _: 48.0 * 3.3 / 160.0,
        PIN_COIL_TEMPERATURE[0]: lambda _: thermistor_volts(61.0),
        PIN_DRIVER_TEMPERATURE: lambda _: thermistor_volts(35.0),
    }
    board = make(pins=pins, parameters={"rms_time": 0.1})
    board.run(2 * SECOND)
    told = health(board)
    assert told["supply"] == pytest.approx(48.0, abs=0.04)
    assert told["coil_temperature"] == pytest.approx(61.0, abs=1.0)
    assert told["driver_temperature"] == pytest.approx(35.0, abs=1.0)
    assert told["rms"] == pytest.approx(8.0, abs=0.07)
    assert told["direct"] == pytest.approx(0.0, abs=0.004)
    assert told["trips"] == told["wait"] == told["locked_out"] == 0


@pytest.mark.long
def test_a_drive_that_a_parameter_stops_is_no_fault_at_any_phase_of_a_chip() -> None:
    """Its current of 8 A falls for 13 us then, and may do so through both looks at it."""
    board = CoilBoard({"code": 2, "amplitude": 8.0}, {})
    steps = 33
    for step in range(steps):
        time = 4 * (step + 1) * 1023 * CHIP + step * 3 * US
        board.send_serial("PARAM_SET", {"kind": 2, "value_float": 7.5 + step % 2 * 0.5}, 1, 2, time)
    board.run(4 * (steps + 1) * 1023 * CHIP + 1100 * MS)
    assert len(board.edges(PIN_ENABLE)) == steps + 1
    assert {m.signals["cause"] for m in board.messages("DRIVE_HEALTH")} == {0}
    board.close()


@pytest.mark.long
@pytest.mark.parametrize("waveform", WAVEFORMS)
@pytest.mark.parametrize("slower", [1.0, 2.0, 3.0, 3.7])
def test_a_slow_coil_is_no_open_one(waveform: str, slower: float) -> None:
    """With 3.7 times the inductance a current of 10 A turns to 6 A within a chip; less than 5 A is an open coil's.

    The supply sags by 20 %, that of the slowest by the 5 % that they can bear.
    """
    driver = {"inductance_H": slower * 1.9e-4, "sag": 0.8 if slower < 3.0 else 0.95}
    board = CoilBoard({"amplitude": 10.0, **WAVEFORMS[waveform][0]}, driver)
    board.run(SECOND)
    board.sag(SECOND)
    board.run(2 * SECOND)
    assert len(board.edges(PIN_ENABLE)) == 1
    assert board.level[PIN_ENABLE]
    assert {m.signals["cause"] for m in board.messages("DRIVE_HEALTH")} == {0}
    board.close()


# ---- What brings it back ----


def test_retries_wait_longer_each_time_and_end(make: Callable[..., Board]) -> None:
    board = make(Coil(broken_from=300 * MS))
    ons = [1]
    for seconds in (2, 5, 10, 19, 30, 50):
        board.run(seconds * SECOND)
        board.clear(seconds * SECOND + MS)
        board.run(seconds * SECOND + 700 * MS)
        ons.append(len(board.edges(PIN_ENABLE)))
    assert ons == [1, 2, 3, 4, 5, 5, 5]
    assert answers(board) == [0, 0, 0, 0, 2, 2]
    assert health(board)["locked_out"] == 1


def test_a_clear_that_comes_too_soon_waits(make: Callable[..., Board]) -> None:
    coil = Coil(extra_A=6.0, extra_from=500 * MS)
    board = make(coil)
    board.run(510 * MS)
    coil.extra_from = NEVER
    board.clear(520 * MS)
    board.run(3 * SECOND)
    waited = board.edges(PIN_ENABLE)[1] - board.edges(PIN_ENABLE, False)[0]
    assert SECOND <= waited <= 1300 * MS


def test_a_reset_by_command_keeps_the_cause(make: Callable[..., Board]) -> None:
    coil = Coil(extra_A=6.0, extra_from=500 * MS)
    board = make(coil)
    board.run(600 * MS)
    coil.extra_from = NEVER
    own = int.from_bytes(board.unique_id[:6], "little") ^ int.from_bytes(board.unique_id[6:], "little")
    board.send_serial("COMMAND", {"board": own, "argument": 0}, 1, 2, 700 * MS)
    board.run(3 * SECOND)
    assert len(board.edges(PIN_ENABLE)) == 1
    assert (state(board), cause(board)) == (FAULT, "over_current")
    board.clear(3100 * MS)
    board.run(3500 * MS)
    assert len(board.edges(PIN_ENABLE)) == 2


def test_noise_at_the_sense_trips_nothing(make: Callable[..., Board]) -> None:
    """Four times the noise that scenarios have, for 20 s."""
    rng = np.random.default_rng(3)
    coil = Coil(gain=1.04, steady=False)
    plain = coil.amperes
    coil.amperes = lambda time: plain(time) + float(rng.normal(0.0, 0.02))  # type: ignore[method-assign]
    board = make(coil)
    board.run(20 * SECOND)
    assert state(board) == RUNNING
    assert len(board.edges(PIN_ENABLE)) == 1
    assert health(board)["headroom_lost"] == 0
