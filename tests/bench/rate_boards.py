"""The motions of the figures on a bench of boards: samples that the sensor streams, and when its messages leave it."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from goldfield.link.chips import SATURATED, Calibration
from goldfield_protocol import decode, encode, encode_frame
from goldfield_protocol.parameters import PARAMETERS
from hil_sim import clib
from hil_sim.bench import SimulatedBench
from tests.bench.motion_trials import CHIPS
from tests.bench.rate_world import HIGH_M, LOW_M, MOTIONS, SHAKE_MARGIN_M, Track

STREAMED_NOISE_T = {2e-7: 2e-7, 2e-8: 0.0}
"""Noise in front of the converter by the noise of a sample that is wanted: the converter of prigge8 adds 20 nT."""
SETTLE_CYCLES = 3
"""Cycles of the bench that are not looked at, after it has been switched on."""


def scenario_file(name, seed, noise_T, sensor="", events=""):
    """Write the scenario of one of `MOTIONS` and return its path; ``sensor`` and ``events`` are more lines of it."""
    speed, rate, shake = MOTIONS[name]
    margin = SHAKE_MARGIN_M if shake.size_m else 0.0
    low, high = (LOW_M + margin).tolist(), (HIGH_M - margin).tolist()
    motion = f'[motion]\nkind = "roaming"\nseed = {seed}\nlow_m = {low}\nhigh_m = {high}\nspeed_m_per_s = {speed}\n'
    motion += f"rate_rad_per_s = {rate}\n"
    if shake.size_m:
        motion += f"shake_Hz = {shake.frequency_Hz}\nshake_m = {shake.size_m}\nshake_rad = {shake.angle_rad}\n"
    text = (clib.ROOT / "hil_sim/scenarios/prigge8.toml").read_text()
    start, end = text.index("[motion]"), text.index("[coil]")
    text = text[:start] + motion + "\n" + text[end:] + events
    text = text.replace("noise_T = 2.0e-7", f"noise_T = {STREAMED_NOISE_T[noise_T]}", 1)
    text = text.replace("node = 100\n", f"node = 100\n{sensor}", 1).replace("seed = 1\n", f"seed = {seed + 1}\n", 1)
    path = Path(tempfile.mkdtemp(prefix="goldfield-figures-")) / "rate.toml"
    path.write_text(text)
    return str(path)


def open_bench(path, boards, link="serial", **options):
    """Open a bench of a scenario, with a site file of its own."""
    return SimulatedBench(path, boards, Path(tempfile.mkdtemp(prefix="goldfield-figures-")), link, **options)


def set_parameter(bench, name, value):
    """Set a parameter of the sensor by its serial port."""
    message = encode(
        "PARAM_SET",
        {"kind": 0, "value_unsigned": value},
        node=bench.scenario.sensor.node,
        index=PARAMETERS[name].first,
    )
    bench.rig.serial_write(encode_frame(*message))


def streamed(bench, seconds):
    """Return what a sensor that streams its chips sends in some whole cycles, with the truth at each chip's end.

    The scenario's sensor has ``stream = 1``.
    """
    sums = {}
    for _ in range(round(seconds / 0.05)):
        bench.rig.advance(0.05)
        for frame in bench.decoder.feed(bench.rig.serial_read()):
            message = decode(frame.identifier, frame.data)
            if message is not None and message.name == "CHIP":
                values = [message.signals[axis] for axis in "xyz"]
                key = int(message.signals["cycle_low"]), message.index
                sums[key] = [np.nan if value == SATURATED else value for value in values]
    first = min(cycle for cycle, _ in sums) + SETTLE_CYCLES
    last = max(cycle for cycle, _ in sums)  # this one is not whole
    keys = [(cycle, chip) for cycle in range(first, last) for chip in range(CHIPS)]
    missing = [np.nan] * 3
    calibration = Calibration(*bench.scenario.sensor.correction())
    samples = calibration.field_T(np.array([sums.get(key, missing) for key in keys]))
    numbers = np.array([cycle * CHIPS + chip for cycle, chip in keys])
    position, rotation = truth_of(bench, numbers)
    times_s = (numbers + 1.0) * bench.site.chip_period_s
    return Track(bench.site, samples, times_s, position, rotation, first)


def end_of_chips_s(bench, numbers):
    """Return the virtual times at which chips end, counted from chip 0 of cycle 0, shape (n,)."""
    edges = bench.rig.sync_edges_s()
    return np.interp((np.asarray(numbers) + 1.0) / CHIPS, np.arange(len(edges)), edges)


def truth_of(bench, numbers):
    """Return where the sensor really was at the ends of chips: positions, shape (n, 3), and n rotations."""
    position, rotation = bench.scenario.installed.motion_of(0).poses(end_of_chips_s(bench, numbers))
    return position, Rotation.from_quat(rotation.as_quat())
