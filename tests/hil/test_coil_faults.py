"""Faults of coil and driver in the plant of the simulator, on emulated boards at random phases of chip and code.

The driver's own protection, which acts first (docs/hardware.md), is not part of the plant: what is shown here is the
second, the firmware's, from three looks at the current in a chip. ``make protections`` lets each fault come a hundred
times.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from goldfield_protocol import FrameDecoder, decode
from hil_sim.rig import Rig
from tests.firmware.host_rig import CHIPS, PIN_ENABLE, PIN_SYNC_OUT, US, chip_seconds, gold_chips
from tests.hil.reference_coil import COIL
from tests.hil.scenario_text import scenario_of

CHIP = round(chip_seconds(0.0) * 1e12)
BEACON = 1
LEAD = 40 * US
"""The beacon is the sync master, which lives two quanta ahead of the present (lockstep.h): a fault begins there."""
DRIVES_S = 0.33
"""The beacon has its full current by then."""
LOOK = 4 * US
"""When a chip's edge is looked at."""
LAST_LOOK = 94 * US
"""Behind the last look at a chip."""
QUANTUM_S = 2e-5
"""The least step of the simulation."""
WAY = 12 * US
"""What lies between a measurement and the end of the drive: conversion and interrupt."""

SCENARIO = """
name = "coil faults"
seed = 3
[sensor]
node = 100
range_T = 2e-4
[motion]
kind = "still"
position_m = [0.5, 0.6, 0.7]
{coil}[[beacon]]
id = "b"
node = 1
code = {code}
position_m = [0.0, 0.0, 0.0]
sync_master = true
"""

CODE = 2
TWO_FALLS = max(
    [number for number in range(start + 1, start + 200) if turns[number % CHIPS]][1] - start
    for turns in [gold_chips(CODE) != np.roll(gold_chips(CODE), 1)]
    for start in range(CHIPS)
)
"""Most chips until the current has begun to turn twice."""

FAULTS = {
    "coil_open": (CHIP, {"open_coil"}),
    "coil_shorted": (TWO_FALLS * CHIP + LOOK + WAY, {"excess"}),
    "driver_runaway": (CHIP, {"over_current", "excess"}),
    "driver_stuck": (CHIP, {"over_current", "excess", "open_coil"}),
    "sense_shorted": (CHIP, {"over_current"}),
}
"""In which time a fault ends the drive, and for which causes. It is seen by the first look that finds a current beyond
a limit. One that is too large is looked for behind the edge, amid the chip and before its end, 8, 41 and 49 us apart;
one that is missing amid the chip and before its end. A driver that is stuck in the direction that is asked for is a
runaway; where the other is asked for, the current first falls short. Whatever the code asks for, it is beyond 16 A half
a chip later: 49 us bring 30 A."""
CAUSES = {1: "over_current", 2: "open_coil", 5: "excess"}


When = Callable[[Rig, int], None]
"""Goes on until a fault shall come, with a moment, ps, at which the code began."""


def at_random(seed: int) -> When:
    """Return what goes on for up to a cycle."""
    random = np.random.default_rng([17, seed])
    return lambda rig, _: rig.advance(float(random.uniform(0.0, 0.1)))


def behind_a_look(turns: bool) -> When:
    """Return what goes on until just behind the last look at a chip, with a next one that turns the current or not."""
    code = gold_chips(CODE)

    def go(rig: Rig, code_began: int) -> None:
        while True:
            rig.advance(QUANTUM_S)
            chip, place = divmod(round(rig.now_s * 1e12) + LEAD - code_began, CHIP)
            if LAST_LOOK < place < LAST_LOOK + 2 * US and turns == (code[chip % CHIPS] != code[(chip + 1) % CHIPS]):
                return

    return go


def off_after(kind: str, when: When) -> tuple[int, str]:
    """Let a fault come when it shall; return how long after it the drive ended, ps, and why."""
    scenario = scenario_of(SCENARIO.format(code=CODE, coil=COIL))
    decoder, why = FrameDecoder(), 0
    with Rig(scenario, "emulated", threads=1) as rig:
        rig.watch_pins()
        rig.advance(DRIVES_S)
        rises = [(int(change["pin"]), int(change["time_ps"])) for change in rig.pin_changes(BEACON) if change["level"]]
        assert [pin for pin, _ in rises if pin == PIN_ENABLE] == [PIN_ENABLE]
        when(rig, [time for pin, time in rises if pin == PIN_SYNC_OUT][-1])
        begun = round(rig.now_s * 1e12) + LEAD
        rig.fault(BEACON, kind)
        rig.advance(3e-3)
        [off] = [int(c["time_ps"]) for c in rig.pin_changes(BEACON) if c["pin"] == PIN_ENABLE and not c["level"]]
        rig.advance(0.05)
        for frame in decoder.feed(rig.serial_read(BEACON)):
            message = decode(frame.identifier, frame.data)
            if message is not None and message.name == "DRIVE_HEALTH":
                why = int(message.signals["cause"])
    return off - begun, CAUSES.get(why, str(why))


@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_of_the_plant_ends_the_drive(kind: str) -> None:
    longest, causes = FAULTS[kind]
    for seed in range(2):
        late, why = off_after(kind, at_random(seed))
        assert 0 <= late <= longest
        assert why in causes


@pytest.mark.long
@pytest.mark.parametrize("turns", [True, False])
@pytest.mark.parametrize("kind", [kind for kind, (longest, _) in FAULTS.items() if longest == CHIP])
def test_a_fault_that_begins_behind_a_look_is_seen_amid_the_next_chip(kind: str, turns: bool) -> None:
    late, why = off_after(kind, behind_a_look(turns))
    assert 0 <= late <= CHIP * 6 // 10
    assert why in FAULTS[kind][1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAULTS)
def test_a_hundred_of_a_hundred_of_the_plant(kind: str) -> None:
    longest, causes = FAULTS[kind]
    told = [off_after(kind, at_random(seed)) for seed in range(100)]
    worst = max(late for late, _ in told)
    print(f"{kind}, plant and emulated board: 100 of 100, off after {worst / US:.1f} us at most")
    assert 0 <= min(late for late, _ in told) <= worst <= longest
    assert {why for _, why in told} <= causes
