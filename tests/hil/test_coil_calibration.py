"""Time constants from a simulated bench's raw samples: the low-pass before the sensor's converter delays all coils."""

from __future__ import annotations

import math

import numpy as np
import pytest

from goldfield.calibration.coils import calibrate_coils
from goldfield.link.chips import Calibration, ChipAssembler
from goldfield_protocol import FrameDecoder, decode
from hil_sim import scenario
from hil_sim.bench import SimulatedBench

CYCLES = 4


@pytest.mark.parametrize("bandwidth_Hz", [2000.0, 3500.0])
def test_a_low_pass_is_found_as_the_time_constant_of_every_coil(tmp_path, bandwidth_Hz):
    """The inductance is so small that the swing of the current takes a microsecond of a chip's 98."""
    text = scenario.find("prigge8").read_text()
    for old, new in (
        ("bandwidth_Hz = 100e3", f"bandwidth_Hz = {bandwidth_Hz}"),
        ("inductance_H = 1.9e-4", "inductance_H = 5.7e-6"),
        ("pose = 1", "stream = 1\npose = 0"),
    ):
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "bench.toml"
    path.write_text(text)
    bench = SimulatedBench(str(path), "host", tmp_path)
    try:
        begin = len(bench.stream)
        bench.advance((CYCLES + 6) * bench.site.cycle_s)  # the master looks for a leader first
        zero, matrix = bench.scenario.sensor.correction()
        assembler, calibration = ChipAssembler(bench.site.chips), Calibration(zero, matrix)
        cycles = []
        for frame in FrameDecoder().feed(bytes(bench.stream[begin:])):
            message = decode(frame.identifier, frame.data)
            if message is not None and message.node == bench.scenario.sensor.node:
                cycles += [calibration.field_T(sums) for sums in assembler.feed(message)]
        place_m = bench.scenario.motion.poses(np.zeros(1))[0][0]
        found = calibrate_coils(bench.site, np.array(cycles[-CYCLES:]), place_m)
    finally:
        bench.close()
    expected_s = 1.0 / (2.0 * math.pi * bandwidth_Hz)
    for coil in found:
        assert coil.reversed is False
        assert coil.tau_s == pytest.approx(expected_s, abs=2e-6 + 4.0 * coil.tau_sd_s)
        assert coil.tau_sd_s < 0.15 * expected_s
