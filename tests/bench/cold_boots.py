"""Cold boots of emulated boards: a master, a beacon and a sensor on one sync wire, each time otherwise.

Crystals differ by up to 100 ppm and drift with time and temperature; boards get power at different moments, from
regulators of 3.3 V that are off by up to 1 %. They are also the converters' reference: at 3 % the middle of the current
sense, 1.65 V, reads as half an ampere before any drive, and trips. After each boot every board must run, with the
sensor locked from its first locked cycle on, no edge rejected and nothing counted.

    python -m tests.bench.cold_boots --boots 200 --cycles-per-instruction 2.5 --seed 12
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from goldfield_protocol import FrameDecoder, Message, decode
from hil_sim.options import cycles
from hil_sim.rig import Rig
from tests.command import whole_number
from tests.hil.reference_coil import COIL
from tests.hil.scenario_text import scenario_of

LENGTH_S = 2.6
"""Virtual time of a boot: all boards have told their counters twice."""
RUNNING, POWER_ON = 3, 0
SPREAD_S = 0.25
"""Within this time all boards get power; a follower locks after four edges of the wire, .3 s."""
NAMES = ("sensor", "master", "follower")

SCENARIO = """
name = "cold boot"
seed = {seed}
power_on_spread_s = {spread}
[ambient]
earth_T = [2e-5, 0.0, -4.5e-5]
[sensor]
node = 100
noise_T = 2e-7
range_T = 2e-4
{sensor}
[motion]
kind = "still"
position_m = [0.5, 0.6, 0.7]
rotation_vector_rad = [0.1, -0.2, 0.3]
{coil}[[beacon]]
id = "master"
node = 1
code = 2
position_m = [0.0, 0.0, 0.0]
sync_master = true
{master}
[[beacon]]
id = "follower"
node = 2
code = 3
position_m = [1.0, 0.0, 0.0]
{follower}
"""


def _clock(random: np.random.Generator) -> str:
    """Return the keys of a board's clock."""
    values = {
        "crystal_ppm": random.uniform(-50.0, 50.0),
        "crystal_ppm_per_s": random.uniform(-0.05, 0.05),
        "crystal_ppm_per_K": random.uniform(-1.0, 1.0),
        "temperature_degC": random.uniform(0.0, 60.0),
        "temperature_K_per_s": random.uniform(0.0, 0.1),
    }
    return "\n".join(f"{key} = {value:.6f}" for key, value in values.items())


def _complaints(board: str, messages: list[Message]) -> list[str]:
    """Return what is wrong with a boot by what a board says."""
    found = [f"{board} counts {int(m.index)}: {m.signals['value']:g}" for m in messages if m.name == "COUNTER"]
    beats = [m.signals for m in messages if m.name == "HEARTBEAT"]
    if len(beats) < 3 or beats[-1]["state"] != RUNNING or beats[-1]["errors"] != 0:
        found.append(f"{board} does not run: {dict(beats[-1]) if beats else 'no heartbeat'}")
    resets = [m.signals["cause"] for m in messages if m.name == "RESET_REPORT" and m.index == 0]
    if resets != [POWER_ON]:
        found.append(f"{board} started by {resets}")
    if board == "sensor":
        locked = [bool(m.signals["locked"]) for m in messages if m.name == "EPOCH_STATUS"]
        first = locked.index(True) if True in locked else len(locked)
        if len(locked) - first < 5 or not all(locked[first:]):
            found.append(f"sensor locked {locked}")
    return found


def boot(seed: int, cycles: float | str) -> tuple[list[str], float]:
    """Boot once; return what is wrong, and when the sensor's first locked cycle was told, s."""
    random = np.random.default_rng([12, seed])
    clocks = {name: _clock(random) for name in NAMES}
    scenario = scenario_of(SCENARIO.format(coil=COIL, seed=seed, spread=SPREAD_S, **clocks))
    decoders = [FrameDecoder() for _ in NAMES]
    messages: list[list[Message]] = [[] for _ in NAMES]
    first_s = float("nan")
    with Rig(scenario, "emulated", cycles_per_instruction=cycles, threads=1) as rig:
        for number, volts in enumerate(random.uniform(0.99, 1.01, len(NAMES)) * 3.3):
            rig.supply(number, float(volts))
        for _ in range(round(LENGTH_S / 0.05)):
            rig.advance(0.05)
            for number, decoder in enumerate(decoders):
                frames = decoder.feed(rig.serial_read(number))
                messages[number] += [m for m in (decode(f.identifier, f.data) for f in frames) if m is not None]
            told = [m for m in messages[0] if m.name == "EPOCH_STATUS" and m.signals["locked"]]
            if told and np.isnan(first_s):
                first_s = rig.now_s
    wrong = [words for name, said in zip(NAMES, messages, strict=True) for words in _complaints(name, said)]
    wrong += [f"{n}: damaged frames" for n, d in zip(NAMES, decoders, strict=True) if d.bad_crc]
    return wrong, first_s


def main() -> int:
    """Boot many times, and print how it went."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--boots", type=whole_number(1), default=200)
    parser.add_argument("--cycles-per-instruction", type=cycles, default=2.5, metavar="X", help="1 to 100, or m4")
    parser.add_argument("--seed", type=whole_number(), default=12, help="of the first boot; each other takes the next")
    arguments = parser.parse_args()
    began, good, times = time.process_time(), 0, []
    for number in range(arguments.boots):
        wrong, first_s = boot(arguments.seed + number, arguments.cycles_per_instruction)
        good += not wrong
        times.append(first_s)
        if wrong:
            print(f"seed {arguments.seed + number}: {'; '.join(wrong)}", flush=True)
        if number % 10 == 9 or number == arguments.boots - 1:
            print(f"{good} of {number + 1} boots good, {time.process_time() - began:.0f} s of processor", flush=True)
    print(
        f"{good} of {arguments.boots} cold boots at {arguments.cycles_per_instruction} cycles an "
        f"instruction: all run, nothing is counted; the sensor's first locked cycle after "
        f"{np.nanmedian(times):.2f} s (median), {np.nanmax(times):.2f} (worst)"
    )
    return 0 if good == arguments.boots else 1


if __name__ == "__main__":
    sys.exit(main())
