"""Measure the reference circuit in ngspice beside the plant: ``make circuit-figures``.

It writes docs/hardware/figures.md, which docs/hardware.md quotes, and draws docs/hardware/edges.png.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from hil_sim import clib
from tests.bench.circuit_values import computed
from tests.hil_sim.world.reference_circuit import CHIP_S, NETLIST, START_S, STORIES, FloatArray, Trace, plant, spice

Rows = list[tuple[str, str, str]]
Played = dict[str, tuple[Trace, FloatArray]]
HEAD = """# Figures of the reference circuit

`make circuit-figures` writes this file: the netlist `driver.cir` in ngspice, beside the plant of `hil_sim/world/coil.c`
that is given the same coil, supply and pins. Times count from what causes them.

| what | circuit | plant |
| --- | --- | --- |
"""


def play() -> Played:
    """Play each story to netlist and plant; the plant's current stands at the netlist's times."""
    lib = clib.load("build/libgf_rig.so", ["world/coil.h", "world/noise.h"])
    played = {}
    for name, story in STORIES.items():
        with tempfile.TemporaryDirectory() as folder:
            trace = spice(story, Path(folder))
        played[name] = (trace, plant(lib, story, trace.time_s))
        print(f"played {name}: {len(trace.time_s)} points", flush=True)
    return played


def passes(times_s: FloatArray, values: FloatArray, level: float, after_s: float) -> float:
    """Return when values first fall to a level after a time, in microseconds from it; nan if they never do."""
    found = np.flatnonzero((times_s > after_s) & (values <= level))
    return float((times_s[found[0]] - after_s) * 1e6) if len(found) else float("nan")


def chip_rows(played: Played) -> Rows:
    """Return the rows of chip ends and edges."""
    trace, ours = played["chips"]
    rows: Rows = []
    for chip in range(4):
        end = START_S + (chip + 1) * CHIP_S
        times = np.linspace(end - 12e-6, end - 1e-7, 4001)
        current, held = trace.at("current_A", times), np.interp(times, trace.time_s, ours).mean()
        rows.append(
            (
                f"chip {chip + 1}: mean of its last 12 us",
                f"{current.mean():.4f} A ({np.ptp(current):.4f} A peak to peak)",
                f"{held:.4f} A",
            )
        )
    swings = np.count_nonzero(np.diff(np.sign(current - current.mean()))) / 2 / (times[-1] - times[0])
    rows.append(("ripple of the hold, frequency", f"{swings / 1e3:.0f} kHz", "none"))
    for name, volts in (("chips", 120), ("sag", 96)):
        trace, ours = played[name]
        reversal = START_S + CHIP_S
        for level in (5.0, 0.0, -5.0, -9.9, -9.99):
            pair = [f"{passes(trace.time_s, v, level, reversal):.2f} us" for v in (trace.current_A, ours)]
            rows.append((f"reversal at {volts} V passes {level:g} A after", *pair))
        largest = np.abs(trace.current_A - ours).max()
        rows.append((f"largest difference on an edge at {volts} V", f"{largest:.2f} A", ""))
    trace, _ = played["chips"]
    late = trace.time_s > START_S + CHIP_S
    step = np.diff(trace.time_s[late], append=trace.time_s[-1])
    rows.append(
        ("mean current from the 5 V", f"{-np.sum(trace.low_supply_A[late] * step) / np.sum(step):.2f} A", "none")
    )
    spike = max(trace.shunt_a_V.max(), trace.shunt_b_V.max()) / 10e-3
    rows.append(("largest current in a shunt, while capacitances charge", f"{spike:.0f} A", "not modelled"))
    return rows


def off_rows(played: Played) -> Rows:
    """Return the rows of what ends a current in order."""
    rows: Rows = []
    for name, words in (("disabled", "enable taken away"), ("zero", "inputs made equal")):
        trace, ours = played[name]
        pair = [f"{passes(trace.time_s, v, 0.001, 60e-6):.2f} us" for v in (trace.current_A, ours)]
        rows.append((f"{words} at 10 A: no current after", *pair))
        rows.append((f"{words}: current beyond zero", f"{-trace.current_A.min():.2f} A", f"{-ours.min() + 0.0:.2f} A"))
        ringing = trace.time_s[(np.abs(trace.current_A) > 0.01)][-1] - 60e-6
        rows.append((f"{words}: below 10 mA for good after", f"{ringing * 1e6:.1f} us", ""))
    trace, _ = played["disabled"]
    volts = trace.at("high_supply_V", np.array([59.9e-6, 90e-6]))
    rows.append(("the fly-back lifts the high supply by", f"{volts[1] - volts[0]:.3f} V", "not modelled"))
    trace, ours = played["lower"]
    pair = [f"{passes(trace.time_s, v, 5.05, 60e-6):.2f} us" for v in (trace.current_A, ours)]
    rows.append(("set-point from 10 to 5 A: within 1 % after", *pair))
    spike = max(trace.shunt_a_V.max(), trace.shunt_b_V.max()) / 10e-3
    rows.append(("the same: largest current in a shunt, while a body diode recovers", f"{spike:.0f} A", "not modelled"))
    trace, ours = played["full scale"]
    late = np.linspace(95e-6, 109e-6, 4001)
    rows.append(
        (
            "set-point of 3.3 V: current",
            *(f"{np.interp(late, trace.time_s, v).mean():.3f} A" for v in (trace.current_A, ours)),
        )
    )
    return rows


def fault_rows(played: Played) -> Rows:
    """Return the rows of faults."""
    rows: Rows = []
    for name, cause, words in (
        ("shorted", START_S, "coil shorted (2 uH, 20 mOhm)"),
        ("runaway", 60e-6, "set-point runs to 24 A"),
    ):
        trace, ours = played[name]
        fault = trace.first("fault_V", 1.65, cause, rising=False)
        rows.append(
            (f"{words}: largest current", f"{np.abs(trace.current_A).max():.1f} A", f"{np.abs(ours).max():.1f} A")
        )
        rows.append(
            (
                f"{words}: 18 A reached after",
                f"{1e6 * (trace.first('current_A', 18.0, cause, rising=True) - cause):.2f} us",
                "",
            )
        )
        rows.append((f"{words}: fault wire low after", f"{1e6 * (fault - cause):.2f} us", "never"))
        gone = trace.time_s[np.abs(trace.current_A) > 0.1][-1] - cause
        rows.append((f"{words}: below 0.1 A for good after", f"{1e6 * gone:.1f} us", "never"))
    trace, ours = played["open"]
    rows.append(
        (
            "coil open: largest current",
            f"{1e3 * np.abs(trace.current_A).max():.1f} mA",
            f"{1e3 * np.abs(ours).max():.1f} mA",
        )
    )
    return rows


def draw(played: Played) -> None:
    """Draw edges and faults."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7), layout="constrained")
    axes = figure.subplots(2, 2)
    reversal = (START_S + CHIP_S) * 1e6
    panels = (
        ("chips", "Reversal at 120 V", (reversal - 5, reversal + 60)),
        ("disabled", "Enable taken away", (55, 90)),
        ("runaway", "Set-point runs to 24 A", (55, 110)),
        ("shorted", "Coil shorted", (9, 16)),
    )
    for axis, (name, title, (left, right)) in zip(axes.flat, panels, strict=True):
        trace, ours = played[name]
        inside = (trace.time_s * 1e6 >= left) & (trace.time_s * 1e6 <= right)
        axis.plot(trace.time_s[inside] * 1e6 - left, trace.current_A[inside], label="circuit (ngspice)")
        axis.plot(trace.time_s[inside] * 1e6 - left, ours[inside], "--", label="plant")
        axis.plot(trace.time_s[inside] * 1e6 - left, (trace.sense_V[inside] - 1.65) / 0.103125, lw=0.7, label="sense")
        axis.set(title=title, xlabel="us", ylabel="A")
        axis.grid(alpha=0.3)
    axes[0, 0].legend()
    figure.savefig(NETLIST.with_name("edges.png"), dpi=80, metadata={"Software": None})


def main() -> int:
    """Play, write, draw."""
    played = play()
    rows = [*chip_rows(played), *off_rows(played), *fault_rows(played)]
    text = HEAD + "".join(f"| {' | '.join(row)} |\n" for row in rows)
    text += "\nBy arithmetic (`tests/bench/circuit_values.py`):\n\n| what | value |\n| --- | --- |\n"
    text += "".join(f"| {words} | {value} |\n" for words, value in computed())
    NETLIST.with_name("figures.md").write_text(text, encoding="utf-8")
    draw(played)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
