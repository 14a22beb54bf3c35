"""Causes that only a run of their own shows, on the flashable image, at random phases of chip and code.

The causes of a single fault that a conversion sees are in `test_protection.py`, what stops on the board in
`boards/stm32f405/test_protection_in_hardware.py`; ``make protections`` runs all of them a hundred times.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from tests.firmware.host_rig import (
    CHIPS,
    MS,
    PIN_COIL_TEMPERATURE,
    PIN_DRIVER_TEMPERATURE,
    PIN_ENABLE,
    US,
    Board,
    Coil,
    beacon,
)
from tests.firmware.services.test_protection import CHIP, PARAMETERS, cause, step, thermistor_volts

RMS_S = 0.1
FULL = 2047
"""The end of the current's measurement, counts."""


@dataclass
class Told(Coil):
    """A coil that remembers when its current was measured, and what it was."""

    def __post_init__(self) -> None:
        self.seen: list[tuple[int, float]] = []
        self.steady = False

    def amperes(self, time: int) -> float:
        """Return the current, A."""
        value = super().amperes(time)
        self.seen.append((time, value))
        return value


def shorted(time: int) -> Board:
    """A short: the current runs to the supply's end at once, in both directions."""
    return beacon(Coil(extra_A=60.0, extra_from=time), parameters=PARAMETERS, emulated=True)


def second_coil(time: int) -> Board:
    """The second coil of a rotating field, whose driver has run away."""
    parameters = PARAMETERS | {"waveform": 3, "periods": 5}
    return beacon(Coil(), Coil(extra_A=60.0, extra_from=time), parameters=parameters, emulated=True)


def slots_of_others(time: int) -> Board:
    """A current in the slots of others, with the board's own bridge off."""
    parameters = PARAMETERS | {"waveform": 1, "slots": 9, "slot": 0, "over_current": 12.0}
    return beacon(Coil(stray_A=15.9, stray_from=time), parameters=parameters, emulated=True)


def thermistor(pin: int) -> Callable[[int], Board]:
    """A thermistor that falls off."""
    cold = thermistor_volts(25.0)
    return lambda time: beacon(Coil(), pins={pin: step(cold, 3.3, time)}, parameters=PARAMETERS, emulated=True)


STRUCK: dict[str, tuple[Callable[[int], Board], str]] = {
    "shorted coil": (shorted, "over_current"),
    "second coil": (second_coil, "over_current"),
    "slots of others": (slots_of_others, "over_current"),
    "thermistor of the coil": (thermistor(PIN_COIL_TEMPERATURE[0]), "coil_hot"),
    "thermistor of the driver": (thermistor(PIN_DRIVER_TEMPERATURE), "driver_hot"),
}


def strike(name: str, seed: int) -> int:
    """Let a fault come, and return how long after it the drive went off, ps."""
    make, why = STRUCK[name]
    time = 330 * MS + int(np.random.default_rng([15, seed]).integers(0, CHIPS * CHIP))
    board = make(time)
    board.run(time + 20 * MS)
    [off] = board.edges(PIN_ENABLE, False)
    assert len(board.edges(PIN_ENABLE)) == 1
    board.run(off + 1100 * MS if seed == 0 else off)
    assert seed != 0 or cause(board) == why
    board.close()
    return off - time


def overload(seed: int) -> int:
    """Let the mean square of the current pass a limit, and return how long behind that the drive ends, ps.

    The mean is computed anew, from what the coil carried at the conversion before the end of each chip, in counts as
    the converter has them: those behind each edge, 8 us later, and amid the chip are no part of it.
    """
    limit_A = float(np.random.default_rng([16, seed]).uniform(6.0, 7.5))
    coil = Told()
    board = beacon(coil, parameters=PARAMETERS | {"rms_current": limit_A, "rms_time": RMS_S}, emulated=True)
    board.run(600 * MS)
    [off] = board.edges(PIN_ENABLE, False)
    mean, chips, passed = 0.0, RMS_S / (CHIP * 1e-12), None
    for (when, amperes), (later, _) in itertools.pairwise(coil.seen):
        if later - when > CHIP // 8:
            continue
        count = np.floor((1.65 + 0.103125 * amperes) / 3.3 * 4096.0 + 0.5) - 2048.0
        mean += (min(abs(count), FULL) ** 2 - mean) / chips
        if mean > (limit_A / 0.0078125) ** 2:
            passed = when
            break
    assert passed is not None
    assert len(board.edges(PIN_ENABLE)) == 1
    board.run(off + 1100 * MS if seed == 0 else off)
    assert seed != 0 or cause(board) == "overload"
    board.close()
    return off - passed


@pytest.mark.parametrize("name", STRUCK)
def test_a_fault_ends_the_drive_within_a_chip(name: str) -> None:
    assert all(0 <= strike(name, seed) <= CHIP for seed in range(2))


BRIEF = 51 * US
"""How long a current flows that is seen at least once: at most 48.8 us lie between two looks, the rest is jitter."""


def brief(seed: int) -> str:
    """Let 15 A flow for less than a chip with the bridge off, and return the cause that the board tells then."""
    time = 60 * MS + int(np.random.default_rng([18, seed]).integers(0, 62 * CHIP))
    coil = Coil(stray_A=15.0, stray_from=time)
    board = beacon(coil, parameters=PARAMETERS | {"amplitude": 0.0}, emulated=True)
    board.run(time + BRIEF)
    coil.stray_from = 1 << 62
    board.run(1100 * MS)
    assert not board.edges(PIN_ENABLE)
    why = cause(board)
    board.close()
    return why


def test_a_current_is_seen_within_a_chip_with_the_bridge_off() -> None:
    assert {brief(seed) for seed in range(3)} == {"over_current"}


def test_an_overload_ends_the_drive_when_the_mean_square_passes_its_limit() -> None:
    """To a chip: the board rounds the currents to its converter's counts."""
    assert all(-CHIP <= overload(seed) <= CHIP for seed in range(2))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*STRUCK, "overload"])
def test_a_hundred_of_a_hundred(name: str) -> None:
    late = [overload(seed) if name == "overload" else strike(name, seed) for seed in range(100)]
    print(f"{name}, emulated board: 100 of 100, off after {max(late) / US:.1f} us at most")
    assert max(late) <= CHIP
    assert min(late) >= (-CHIP if name == "overload" else 0)


@pytest.mark.slow
def test_a_hundred_of_a_hundred_with_the_bridge_off() -> None:
    assert [brief(seed) for seed in range(100)] == ["over_current"] * 100
    print(f"current with the bridge off, emulated board: 100 of 100 of {BRIEF / US:.0f} us are told")
