"""The reference driver of docs/hardware.md in ngspice, and the plant of ``hil_sim/world/coil.h`` told the same story.

A `Story` says what the board's pins and the supply do; `spice` plays it to ``docs/hardware/driver.cir``, `plant` to the
simulator's coil.
"""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

NETLIST = Path(__file__).resolve().parents[3] / "docs" / "hardware" / "driver.cir"
PS = 10**12
SET_POINT_A_PER_V = 16.0 / 3.3
SENSE_V_PER_A = 0.103125
CHIP_S = 97.75e-6
START_S = 10e-6
"""When a story's first chip begins."""
SETTLED_S = 6e-6
"""ngspice starts at 0 V nearly everywhere. What the netlist does before it has settled is cut away."""
PROBES = (
    "i(lcoil)",
    "v(sense)",
    "v(fault)",
    "v(coil_a)",
    "v(coil_b)",
    "v(xd.top)",
    "v(xd.shunt_a)",
    "v(xd.shunt_b)",
    "v(hv)",
    "i(vlv)",
)
SKIP = "ngspice is not installed: `make test` installs it, or `apt-get install ngspice`"

Steps = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Story:
    """What happens to a driver and its coil; times in seconds.

    Attributes
    ----------
    inputs : sequence of (time, direction)
        From each time on the inputs ask for +1, -1 or 0 times the set-point.
    enable : sequence of (time, 0 or 1)
    set_point_A : sequence of (time, A)
        What the set-point's voltage asks for.
    until_s : float
    inductance_H, resistance_Ohm, supply_V : float
        The coil and the high supply.
    """

    inputs: Steps
    until_s: float
    enable: Steps = ((5e-6, 1.0),)
    set_point_A: Steps = ((0.0, 10.0),)
    inductance_H: float = 1.9e-4
    resistance_Ohm: float = 0.15
    supply_V: float = 120.0


@dataclass(frozen=True)
class Trace:
    """What a circuit did: one array a quantity, all of the same shape."""

    time_s: FloatArray
    current_A: FloatArray
    sense_V: FloatArray
    fault_V: FloatArray
    coil_a_V: FloatArray
    coil_b_V: FloatArray
    top_V: FloatArray
    shunt_a_V: FloatArray
    shunt_b_V: FloatArray
    high_supply_V: FloatArray
    low_supply_A: FloatArray

    def at(self, quantity: str, times_s: FloatArray) -> FloatArray:
        """Return a quantity at given times, linear between ngspice's own."""
        return np.interp(times_s, self.time_s, getattr(self, quantity))

    def first(self, quantity: str, level: float, after_s: float, *, rising: bool) -> float:
        """Return when a quantity first passes a level after a time; infinite if it never does."""
        values = getattr(self, quantity) - level
        passed = (values >= 0.0) if rising else (values <= 0.0)
        found = np.flatnonzero(passed & (self.time_s > after_s))
        return float(self.time_s[found[0]]) if len(found) else float("inf")


CHIPS = Story(
    [(START_S + k * CHIP_S, sign) for k, sign in enumerate((1, -1, -1, 1))],
    START_S + 4 * CHIP_S,
)
STORIES = {
    "chips": CHIPS,
    "disabled": replace(CHIPS, inputs=CHIPS.inputs[:1], enable=((5e-6, 1.0), (60e-6, 0.0)), until_s=100e-6),
    "zero": replace(CHIPS, inputs=[(START_S, 1), (60e-6, 0)], until_s=100e-6),
    "sag": replace(CHIPS, inputs=CHIPS.inputs[:2], supply_V=96.0, until_s=START_S + 1.6 * CHIP_S),
    "lower": replace(CHIPS, inputs=CHIPS.inputs[:1], set_point_A=((0.0, 10.0), (60e-6, 5.0)), until_s=100e-6),
    "shorted": replace(CHIPS, inputs=CHIPS.inputs[:1], inductance_H=2e-6, resistance_Ohm=0.02, until_s=30e-6),
    "open": replace(CHIPS, inputs=CHIPS.inputs[:1], resistance_Ohm=1e6, until_s=60e-6),
    "full scale": replace(CHIPS, inputs=CHIPS.inputs[:1], set_point_A=((0.0, 10.0), (60e-6, 16.0)), until_s=110e-6),
    "cleared": replace(
        CHIPS,
        inputs=CHIPS.inputs[:1],
        enable=((5e-6, 1.0), (60e-6, 0.0), (65e-6, 1.0)),
        set_point_A=((0.0, 24.0), (60e-6, 10.0)),
        until_s=110e-6,
    ),
    "runaway": replace(CHIPS, inputs=CHIPS.inputs[:1], set_point_A=((0.0, 10.0), (60e-6, 24.0)), until_s=110e-6),
}


def _source(steps: Steps, scale: float = 1.0, before: float = 0.0) -> str:
    """Return the points of a piecewise linear source: each step takes 10 ns."""
    points, level = [f"0 {before}"], before
    for time, value in steps:
        points += [f"{time:.9g} {level:.9g}", f"{time + 1e-8:.9g} {value * scale:.9g}"]
        level = value * scale
    return "pwl(" + " ".join(points) + ")"


def deck(story: Story, output: Path) -> str:
    """Return the input of ngspice that plays a story and writes `PROBES` to a file.

    ``cshunt`` puts 2 pF on each node: strays that a board has too, without which the solver meets nodes of no charge.
    """
    one = [(time, float(value > 0)) for time, value in story.inputs]
    two = [(time, float(value < 0)) for time, value in story.inputs]
    return f"""reference driver
.include {NETLIST}
vhv supply 0 {story.supply_V}
rhv supply hv 1
vlv lv 0 5
vin1 in1 0 {_source(one, 3.3)}
vin2 in2 0 {_source(two, 3.3)}
ven enable 0 {_source(story.enable, 3.3)}
vsp setpoint 0 {_source(story.set_point_A, 1.0 / SET_POINT_A_PER_V)}
xd in1 in2 enable setpoint sense fault coil_a coil_b hv lv driver
lcoil coil_a middle {story.inductance_H}
rcoil middle coil_b {story.resistance_Ohm}
.options method=gear reltol=1e-3 abstol=1e-7 vntol=1e-5 itl4=200 cshunt=2e-12
.ic v(hv)={story.supply_V} v(supply)={story.supply_V} v(xd.top)=4.5
.tran 50n {story.until_s} 0 100n uic
.control
run
set wr_singlescale
wrdata {output} {" ".join(PROBES)}
quit
.endc
.end
"""


def spice(story: Story, folder: Path) -> Trace:
    """Play a story to the netlist.

    Raises
    ------
    FileNotFoundError
        If ngspice is not installed.
    RuntimeError
        If it gives up before the story's end; its words are in the message.
    """
    program = shutil.which("ngspice")
    if program is None:
        raise FileNotFoundError(SKIP)
    output = folder / "trace"
    (folder / "deck.cir").write_text(deck(story, output), encoding="utf-8")
    done = subprocess.run(
        [program, "-b", str(folder / "deck.cir")], cwd=NETLIST.parent, capture_output=True, text=True, check=False
    )
    columns = np.loadtxt(output) if output.exists() else np.zeros((0, 1 + len(PROBES)))
    if len(columns) == 0 or columns[-1, 0] < story.until_s * (1.0 - 1e-6):
        raise RuntimeError(f"ngspice gave up: {done.stdout[-500:]}{done.stderr[-500:]}")
    return Trace(*columns[columns[:, 0] > SETTLED_S].T.copy())


def plant(lib: tuple[Any, Any], story: Story, times_s: FloatArray) -> FloatArray:
    """Play a story to the simulator's coil and return its current at times, shape (n,), ampere."""
    ffi, library = lib
    config = dict(
        inductance_H=story.inductance_H,
        resistance_Ohm=story.resistance_Ohm,
        supply_V=story.supply_V,
        reference_A_per_V=SET_POINT_A_PER_V,
        sense_V_per_A=SENSE_V_PER_A,
        sense_noise_V=0.0,
        lag_s=0.0,
    )
    coil = ffi.new("coil_t *")
    library.coil_init(coil, ffi.new("coil_config_t *", config))
    changes = [(time, "input", value) for time, value in story.inputs]
    changes += [(time, "enable", value) for time, value in story.enable]
    changes += [(time, "set_point", value) for time, value in story.set_point_A]
    for time, what, value in sorted(changes):
        now = round(time * PS)
        if what == "input":
            library.coil_input(coil, 1, value > 0, now)
            library.coil_input(coil, 2, value < 0, now)
        elif what == "enable":
            library.coil_enable(coil, bool(value), now)
        else:
            library.coil_reference(coil, value / SET_POINT_A_PER_V, now)
    return np.array([library.coil_current(coil, round(time * PS)) for time in times_s])
