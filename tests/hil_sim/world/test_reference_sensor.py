"""The front end of docs/hardware.md in ngspice against what the simulator takes it for: a gain and a low-pass."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest

from tests.bench.circuit_values import BRIDGE_V, BRIDGE_V_PER_V_T
from tests.hil_sim.world.reference_circuit import NETLIST, SKIP

pytestmark = pytest.mark.skipif(shutil.which("ngspice") is None, reason=SKIP)

DECK = """front end
.include {netlist}
vref ref 0 1.65
vp33 p33 0 3.3
vcommon middle 0 4
vsignal bridge_p middle dc 0 ac 1 pulse(0 {step} 1u 1n 1n 1 2)
rreturn bridge_n middle 1m
xf bridge_p bridge_n ref pin p33 front_end
.options reltol=1e-6
.control
{analysis}
set wr_singlescale
wrdata {output} {vector}
quit
.endc
.end
"""
BANDWIDTH_HZ, RANGE_T = 100e3, 2e-4
"""Bandwidth and range in the scenarios of ``hil_sim/scenarios``."""


def run(folder, analysis: str, vector: str, step: float = 0.0) -> np.ndarray:
    """Return what ngspice writes: columns of the scale and the vector."""
    output = folder / "out"
    netlist = NETLIST.with_name("sensor.cir")
    text = DECK.format(netlist=netlist, analysis=analysis, vector=vector, output=output, step=step)
    (folder / "deck.cir").write_text(text, encoding="utf-8")
    done = subprocess.run(["ngspice", "-b", str(folder / "deck.cir")], capture_output=True, text=True, check=False)
    assert output.exists(), done.stdout[-500:] + done.stderr[-500:]
    return np.loadtxt(output)


def test_the_corner_lies_at_the_scenarios_bandwidth(tmp_path):
    table = run(tmp_path, "ac dec 200 100 10meg", "vm(pin)")
    relative = table[:, 1] / table[0, 1]
    corner = np.interp(-np.sqrt(0.5), -relative, table[:, 0])
    assert corner == pytest.approx(BANDWIDTH_HZ, rel=0.02)


def test_a_step_of_field_moves_the_pin_as_the_plant_does(tmp_path):
    """To 5 % of the step while it rises (the amplifier is 80 ns behind), and in gain to half a percent."""
    field_T = 1e-4
    table = run(tmp_path, "tran 5n 20u 0 5n", "v(pin)", step=field_T * BRIDGE_V * BRIDGE_V_PER_V_T)
    time_s = np.maximum(table[:, 0] - 1e-6, 0.0)
    plant = 1.65 * field_T / RANGE_T * (1.0 - np.exp(-2.0 * np.pi * BANDWIDTH_HZ * time_s))
    circuit = table[:, 1] - 1.65
    assert circuit[-1] == pytest.approx(plant[-1], rel=5e-3)
    assert np.abs(circuit - plant).max() < 0.05 * plant[-1]
