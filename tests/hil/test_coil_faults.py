"""Faults of coil and driver in the plant of the simulator, on emulated boards at random phases of chip and code.

The driver's own protection, which acts first (docs/hardware.md), is not part of the plant: what is shown here is the
second, the firmware's, from a look at the current once a chip. ``make protections`` lets each fault come a hundred
times.
"""

from __future__ import annotations

import numpy as np
import pytest

from goldfield_protocol import FrameDecoder, decode
from hil_sim.rig import Rig
from tests.firmware.host_rig import CHIPS, PIN_ENABLE, US, chip_seconds, gold_chips
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
WAY = 12 * US
"""What lies between a measurement and the end of the drive: conversion and interrupt."""
RISE = 4 * US
"""Until a current that runs away is beyond the 12 A of `over_current`: (12 - 10) A at 120 V / 190 uH are 3.2 us."""
TURN = 8 * US
"""Until one that runs the wrong way is below the half of 10 A that `open_coil` asks for: 5 A are 7.9 us."""

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
    "coil_open": (CHIP + WAY, {"open_coil"}),
    "coil_shorted": (TWO_FALLS * CHIP + LOOK + WAY, {"excess"}),
    "driver_runaway": (CHIP + RISE, {"over_current", "excess"}),
    "driver_stuck": (CHIP + TURN + WAY, {"over_current", "excess", "open_coil"}),
    "sense_shorted": (CHIP, {"over_current"}),
}
"""In which time a fault ends the drive, and for which causes. It is seen by the first measurement that finds a current
beyond a limit. One that is too large is looked at twice a chip, 8 and 90 us apart; where the code turns between them it
is below the limit once more, and seen by the second. One that is missing is looked at once a chip. A driver that is
stuck in the direction that is asked for is a runaway; where the other is asked for, the current first falls short.
Whatever the code asks for, it is beyond 16 A a chip later: 97.75 us bring 61 A."""
CAUSES = {1: "over_current", 2: "open_coil", 5: "excess"}


def off_after(kind: str, seed: int) -> tuple[int, str]:
    """Let a fault come; return how long after it the drive ended, ps, and why."""
    scenario = scenario_of(SCENARIO.format(code=CODE, coil=COIL))
    random = np.random.default_rng([17, seed])
    decoder, why = FrameDecoder(), 0
    with Rig(scenario, "emulated", threads=1) as rig:
        rig.watch_pins()
        rig.advance(DRIVES_S + float(random.uniform(0.0, 0.1)))
        assert [bool(change["level"]) for change in rig.pin_changes(BEACON) if change["pin"] == PIN_ENABLE] == [True]
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
        late, why = off_after(kind, seed)
        assert 0 <= late <= longest
        assert why in causes


@pytest.mark.slow
@pytest.mark.parametrize("kind", FAULTS)
def test_a_hundred_of_a_hundred_of_the_plant(kind: str) -> None:
    longest, causes = FAULTS[kind]
    told = [off_after(kind, seed) for seed in range(100)]
    worst = max(late for late, _ in told)
    print(f"{kind}, plant and emulated board: 100 of 100, off after {worst / US:.1f} us at most")
    assert 0 <= min(late for late, _ in told) <= worst <= longest
    assert {why for _, why in told} <= causes
