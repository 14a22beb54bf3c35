"""Shorted turns of a coil against SciPy's solution of the two loops and against coupled inductors in ngspice."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil_sim import clib
from tests.hil_sim.world.reference_circuit import SKIP

L, R, V, LAG = 1.9e-4, 0.15, 120.0, 1.6e-6
PS, US = 10**12, 10**6
SHORTS = [(0.5, 0.9), (0.1, 0.9), (0.1, 0.5), (0.025, 0.98)]
"""Share of the turns that are shorted, and their coupling to the rest."""


@pytest.fixture(scope="module")
def lib():
    return clib.load("build/libgf_rig.so", ["world/coil.h"])


def make(lib, share, coupling, amperes=10.0, **changes):
    """Make an enabled coil with a set-point, at rest, and with its turns shorted from the start."""
    ffi, library = lib
    values = dict(
        inductance_H=L,
        resistance_Ohm=R,
        supply_V=V,
        reference_A_per_V=1.0,
        sense_V_per_A=0.103125,
        lag_s=LAG,
        ambient_degC=20.0,
        shorted_fraction=share,
        shorted_coupling=coupling,
    )
    coil = ffi.new("coil_t *")
    library.coil_init(coil, ffi.new("coil_config_t *", values | changes))
    library.coil_fault(coil, library.COIL_SHORTED, True, 0)
    library.coil_reference(coil, amperes, 0)
    library.coil_enable(coil, True, 0)
    return coil


def drive(library, coil, sign, time_ps):
    library.coil_input(coil, 1, sign > 0, time_ps)
    library.coil_input(coil, 2, sign < 0, time_ps)


def loops(share, coupling):
    """Return the two loops' matrix of inductances, and their resistances."""
    turns = np.array([1.0 - share, share])
    shape = np.outer(turns, turns) * np.array([[1.0, coupling], [coupling, 1.0]])
    return L * shape / shape.sum(), R * turns


def looked_at(library, coil, times_s):
    looks = (library.coil_current, library.coil_second)
    found = [[look(coil, round(t * PS)) for t in times_s] for look in looks]
    found.append([library.coil_lagged(coil, library.coil_head(coil), round(t * PS)) for t in times_s])
    return np.array(found)


@pytest.mark.parametrize(("share", "coupling"), SHORTS)
def test_chips_match_the_coupled_loops(lib, share, coupling):
    """Two chips of 97.75 us, driven and held, with the field behind the sensor's low-pass."""
    _, library = lib
    coil = make(lib, share, coupling)
    chip = 97.75e-6
    drive(library, coil, 1, 0)
    drive(library, coil, -1, round(chip * PS))
    inductances, ohms = loops(share, coupling)
    inverse = np.linalg.inv(inductances)
    turns = np.array([1.0 - share, share])
    times = np.arange(0.7e-6, 2 * chip, 0.61e-6)
    expected = np.zeros((3, len(times)))
    state = np.zeros(3)
    for start, target in ((0.0, 10.0), (chip, -10.0)):
        volts = np.copysign(V, target)

        def driven(_, y, volts=volts):
            slope = inverse @ (np.array([volts, 0.0]) - ohms * y[:2])
            return [*slope, (turns @ y[:2] - y[2]) / LAG]

        def held(_, y):
            return [0.0, -ohms[1] * y[1] / inductances[1, 1], (turns @ y[:2] - y[2]) / LAG]

        def arrived(_, y, target=target):
            return y[0] - target

        arrived.terminal = True
        now = start
        for slope, events in ((driven, arrived), (held, None)):
            solved = solve_ivp(
                slope,
                (now, start + chip),
                state,
                "Radau",
                events=events,
                dense_output=True,
                rtol=1e-9,
                atol=1e-10,
                max_step=1e-6,
            )
            inside = (times >= now) & (times <= solved.t[-1])
            expected[:, inside] = solved.sol(times[inside])
            now, state = solved.t[-1], solved.y[:, -1].copy()
    np.testing.assert_allclose(looked_at(library, coil, times), expected, atol=2e-5)


@pytest.mark.skipif(shutil.which("ngspice") is None, reason=SKIP)
@pytest.mark.parametrize(("share", "coupling"), SHORTS)
def test_coupled_inductors_of_ngspice_agree(lib, tmp_path: Path, share, coupling):
    """A bridge that drives all the time, out of a supply of 1.2 V and .3 Ohm that never reaches 10 A."""
    _, library = lib
    supply, source = 1.2, 0.3
    coil = make(lib, share, coupling, supply_V=supply, source_Ohm=source)
    signs = [(0.0, 1), (300e-6, -1), (400e-6, 1)]
    for time, sign in signs:
        drive(library, coil, sign, round(time * PS))
    inductances, ohms = loops(share, coupling)
    points, level = [], 0.0
    for time, sign in signs:
        points += [f"{max(time - 5e-10, 0.0)} {level}", f"{time + 5e-10} {sign * supply}"]
        level = sign * supply
    (tmp_path / "deck.cir").write_text(
        f"""shorted turns
vbridge bridge 0 pwl({" ".join(points)})
rbridge bridge a {source + ohms[0]}
lone a 0 {inductances[0, 0]}
ltwo b 0 {inductances[1, 1]}
kboth lone ltwo {coupling}
rtwo b 0 {ohms[1]}
.options method=gear reltol=1e-6 abstol=1e-9
.tran 20n 600u 0 20n uic
.control
run
set wr_singlescale
wrdata {tmp_path / "trace"} i(lone) i(ltwo)
quit
.endc
.end
""",
        encoding="utf-8",
    )
    subprocess.run(["ngspice", "-b", str(tmp_path / "deck.cir")], capture_output=True, check=True)
    trace = np.loadtxt(tmp_path / "trace")
    times = np.arange(5e-6, 595e-6, 1.7e-6)
    theirs = np.array([np.interp(times, trace[:, 0], trace[:, i]) for i in (1, 2)])
    np.testing.assert_allclose(looked_at(library, coil, times)[:2], theirs, atol=2e-3)
    assert np.ptp(theirs[1]) > 0.1


@pytest.mark.parametrize(("share", "coupling"), SHORTS)
def test_a_held_current_makes_the_field_of_the_turns_that_are_left(lib, share, coupling):
    _, library = lib
    coil = make(lib, share, coupling)
    drive(library, coil, 1, 0)
    assert library.coil_current(coil, PS) == 10.0
    assert library.coil_second(coil, PS) == pytest.approx(0.0, abs=1e-9)
    assert library.coil_lagged(coil, library.coil_head(coil), PS) == pytest.approx(10.0 * (1.0 - share), rel=1e-12)


def test_a_short_that_comes_and_goes_keeps_the_flux(lib):
    """It begins with the current of all turns, which dies away with L2 / R2; the flux that is left ends up in all."""
    _, library = lib
    share, coupling = 0.5, 0.9
    coil = make(lib, share, coupling, lag_s=0.0)
    library.coil_fault(coil, library.COIL_SHORTED, False, US)
    drive(library, coil, 1, 2 * US)
    library.coil_fault(coil, library.COIL_SHORTED, True, 100 * US)
    assert library.coil_second(coil, 100 * US) == 10.0
    assert library.coil_lagged(coil, library.coil_head(coil), 100 * US) == pytest.approx(10.0)
    inductances, ohms = loops(share, coupling)
    second = 10.0 * np.exp(-200e-6 * ohms[1] / inductances[1, 1])
    assert library.coil_second(coil, 300 * US) == pytest.approx(second, rel=1e-9)
    library.coil_enable(coil, False, 300 * US)
    library.coil_fault(coil, library.COIL_SHORTED, False, 300 * US)
    flux = inductances.sum(axis=0) @ [10.0, second]
    assert library.coil_current(coil, 300 * US) == pytest.approx(flux / L, rel=1e-9)
    assert library.coil_second(coil, 300 * US) == 0.0


def test_a_wire_that_breaks_leaves_its_flux_to_the_shorted_turns(lib):
    _, library = lib
    coil = make(lib, 0.5, 0.9)
    drive(library, coil, 1, 0)
    library.coil_fault(coil, library.COIL_OPEN, True, PS)
    inductances, _ = loops(0.5, 0.9)
    assert library.coil_current(coil, PS) == 0.0
    assert library.coil_second(coil, PS) == pytest.approx(10.0 * inductances[0, 1] / inductances[1, 1], rel=1e-6)


def test_shorted_turns_heat_the_coil(lib):
    """A code on half a coil: the heat of both loops, by trapezia over what they carry."""
    _, library = lib
    share, coupling, capacity = 0.5, 0.9, 1e-4
    coil = make(lib, share, coupling, thermal_resistance_K_per_W=1e9, heat_capacity_J_per_K=capacity)
    chip = 97_750_000
    for number in range(20):
        drive(library, coil, 1 if number % 2 else -1, number * chip)
    times = np.linspace(0.0, 20 * chip, 40001)
    both = np.array([[look(coil, round(t)) for t in times] for look in (library.coil_current, library.coil_second)])
    power = R * ((1.0 - share) * both[0] ** 2 + share * both[1] ** 2)
    assert np.sum(share * both[1] ** 2) > 0.1 * np.sum(both[0] ** 2)
    heat = np.trapezoid(power, times * 1e-12)
    # The resistance rises by .39 % a kelvin on the way, which is some 150 K.
    assert library.coil_temperature(coil, 20 * chip) - 20.0 > heat / capacity
    cold = make(lib, share, coupling, thermal_resistance_K_per_W=1e9, heat_capacity_J_per_K=1.0)
    for number in range(20):
        drive(library, cold, 1 if number % 2 else -1, number * chip)
    assert library.coil_temperature(cold, 20 * chip) - 20.0 == pytest.approx(heat, rel=0.01)
