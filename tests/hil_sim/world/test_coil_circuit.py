"""Copper, supply and driver of a coil against SciPy's solution of their equations, and what its faults do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from hil_sim import clib

L, R, V = 1.9e-4, 0.15, 120.0
PS = 10**12
US = 10**6
FULL_SCALE_V = 3.3 / 16.0


@pytest.fixture(scope="module")
def lib():
    return clib.load("build/libgf_rig.so", ["world/coil.h"])


def make(lib, amperes=10.0, **changes):
    """Make an enabled coil with a set-point, at rest."""
    ffi, library = lib
    values = dict(
        inductance_H=L,
        resistance_Ohm=R,
        supply_V=V,
        reference_A_per_V=16.0 / 3.3,
        sense_V_per_A=0.103125,
        sense_noise_V=0.0,
        lag_s=0.0,
        ambient_degC=20.0,
    )
    coil = ffi.new("coil_t *")
    library.coil_init(coil, ffi.new("coil_config_t *", values | changes))
    library.coil_reference(coil, amperes * FULL_SCALE_V, 0)
    library.coil_enable(coil, True, 0)
    return coil


def drive(library, coil, sign, time_ps):
    library.coil_input(coil, 1, sign > 0, time_ps)
    library.coil_input(coil, 2, sign < 0, time_ps)


def currents(library, coil, times_s):
    return np.array([library.coil_current(coil, round(t * PS)) for t in times_s])


@pytest.mark.parametrize(("degC", "factor"), [(0.0, 0.9214), (20.0, 1.0), (60.0, 1.1572)])
def test_copper_gains_393_millionths_a_hundredth_of_a_kelvin(lib, degC, factor):
    _, library = lib
    coil = make(lib, supply_V=1.0, ambient_degC=degC)
    drive(library, coil, 1, 0)
    assert library.coil_current(coil, PS) == pytest.approx(1.0 / (R * factor), rel=1e-9)


def test_a_supply_with_resistance_gives_and_takes_back(lib):
    """A reversal, L di/dt = v - R i, where the bus is V - Rs times the current that the bridge draws from it."""
    _, library = lib
    source = 1.5
    coil = make(lib, source_Ohm=source)
    drive(library, coil, 1, 0)
    drive(library, coil, -1, 100 * US)

    def falling(_, current):
        bus = V + source * current[0]  # It draws -i: it gives back what the coil had.
        return [(-bus - R * current[0]) / L]

    solved = solve_ivp(falling, (0.0, 3e-5), [10.0], rtol=1e-10, atol=1e-12, max_step=1e-6, dense_output=True)
    times = np.arange(1e-6, 2.9e-5, 1.3e-6)
    expected = np.maximum(solved.sol(times)[0], -10.0)
    np.testing.assert_allclose(currents(library, coil, times + 100e-6), expected, atol=1e-6)
    early = library.coil_current(coil, 101 * US)
    assert library.coil_bus(coil, 101 * US) == pytest.approx(V + source * early, rel=1e-9)
    late = library.coil_current(coil, 125 * US)
    assert late < 0.0
    assert library.coil_bus(coil, 125 * US) == pytest.approx(V + source * late, rel=1e-9)


def test_a_held_current_draws_its_power_from_the_bus(lib):
    _, library = lib
    source = 2.0
    coil = make(lib, source_Ohm=source, supply_V=30.0)
    drive(library, coil, 1, 0)
    bus = library.coil_bus(coil, 10**9)
    expected = brentq(lambda v: v - 30.0 + source * R * 100.0 / v, 15.0, 30.0)
    assert bus == pytest.approx(expected, rel=1e-9)


def test_a_sag_below_what_the_copper_needs_takes_the_current_down(lib):
    _, library = lib
    coil = make(lib)
    drive(library, coil, 1, 0)
    library.coil_supply(coil, 0.9, 10**9)  # 6 A.
    times = np.array([1e-4, 1e-3, 5e-3])
    expected = 6.0 + 4.0 * np.exp(-times * R / L)
    np.testing.assert_allclose(currents(library, coil, 1e-3 + times), expected, rtol=1e-9)
    library.coil_supply(coil, V, 2 * 10**11)
    assert library.coil_current(coil, 3 * 10**11) == 10.0


def test_errors_of_the_driver_add_up(lib):
    _, library = lib
    coil = make(lib, reference_offset_A=0.1, asymmetry=0.02, dc_error_A=0.03)
    drive(library, coil, 1, 0)
    assert library.coil_current(coil, 90 * US) == pytest.approx(10.1 * 1.02 + 0.03, rel=1e-12)
    drive(library, coil, -1, 100 * US)
    assert library.coil_current(coil, 190 * US) == pytest.approx(-10.1 * 0.98 + 0.03, rel=1e-12)
    drive(library, coil, 0, 200 * US)
    assert library.coil_current(coil, 290 * US) == 0.0
    library.coil_reference(coil, 0.0, 300 * US)
    assert coil.set_point_A == 0.0


def test_in_the_dead_time_the_diodes_conduct(lib):
    """From rest the current rises so much later; a reversal, whose diodes do what the bridge would, is the same."""
    _, library = lib
    plain, dead = make(lib), make(lib, dead_time_s=2e-6)
    for coil in (plain, dead):
        drive(library, coil, 1, 0)
        drive(library, coil, -1, 100 * US)
        drive(library, coil, 0, 200 * US)
        drive(library, coil, 1, 300 * US)
    rise = np.array([302.5e-6, 305e-6, 310e-6])
    assert library.coil_current(dead, 302 * US) == 0.0
    np.testing.assert_allclose(currents(library, dead, rise + 2e-6), currents(library, plain, rise), atol=1e-6)
    fall = np.arange(100e-6, 200e-6, 3e-6)
    np.testing.assert_allclose(currents(library, dead, fall), currents(library, plain, fall), atol=1e-9)


def test_dead_time_with_a_small_current_holds_zero_in_between(lib):
    _, library = lib
    coil = make(lib, amperes=0.3, dead_time_s=2e-6, lag_s=1.6e-6)
    drive(library, coil, 1, 0)
    drive(library, coil, -1, 100 * US)  # 0.3 A are gone after 0.5 us.
    assert library.coil_current(coil, 100 * US + 300_000) > 0.0
    assert library.coil_current(coil, 101 * US) == 0.0
    assert library.coil_current(coil, 102 * US) == 0.0
    assert library.coil_current(coil, 104 * US) == pytest.approx(-0.3, abs=1e-12)
    library.coil_reference(coil, 0.4 * FULL_SCALE_V, 201 * US)
    lagged = [library.coil_lagged(coil, library.coil_head(coil), t * US) for t in range(210, 220)]
    np.testing.assert_allclose(lagged, -0.4, atol=5e-4)


def test_the_copper_warms_up_as_heat_and_loss_say(lib):
    """Coded current for 100 s of virtual time in 10 ms chips, against the thermal equation with the true R(T)."""
    _, library = lib
    heat, loss, ambient = 8.0, 2.5, 35.0
    coil = make(lib, ambient_degC=ambient, thermal_resistance_K_per_W=loss, heat_capacity_J_per_K=heat)
    seconds, step = 100.0, 10**10
    for chip in range(int(seconds / 1e-2)):
        drive(library, coil, 1 if chip * 7919 % 13 < 6 else -1, chip * step)

    def warming(_, degC):
        return [(R * (1.0 + 0.00393 * (degC[0] - 20.0)) * 100.0 - (degC[0] - ambient) / loss) / heat]

    solved = solve_ivp(warming, (0.0, seconds), [ambient], rtol=1e-9, atol=1e-9)
    assert solved.y[0, -1] > ambient + 35.0
    assert library.coil_temperature(coil, round(seconds * PS)) == pytest.approx(solved.y[0, -1], abs=0.05)
    library.coil_enable(coil, False, round(seconds * PS))
    after = library.coil_temperature(coil, round((seconds + 20.0) * PS))
    assert after == pytest.approx(ambient + (solved.y[0, -1] - ambient) * np.exp(-20.0 / heat / loss), abs=0.05)


def test_a_coil_held_at_the_supplys_end_loses_current_as_it_warms(lib):
    """Nothing changes at its inputs: the looks at its sense let it take its resistance into account."""
    _, library = lib
    coil = make(lib, supply_V=1.2, thermal_resistance_K_per_W=2.0, heat_capacity_J_per_K=1.0)
    drive(library, coil, 1, 0)
    for k in range(1, 2000):
        library.coil_sense(coil, 1, k * 10**10 + 1)
    degC = library.coil_temperature(coil, 20 * PS)
    power = 1.2**2 / (R * (1.0 + 0.00393 * (degC - 20.0)))
    assert degC == pytest.approx(20.0 + 2.0 * power, rel=1e-3)
    assert library.coil_current(coil, 20 * PS) == pytest.approx(1.2 / (R * (1.0 + 0.00393 * (degC - 20.0))), rel=1e-3)


def test_shorted_turns_let_a_late_driver_overshoot(lib):
    """An edge sees the leakage alone, L1 (1 - k^2), and the copper of the turns that are left."""
    _, library = lib
    coil = make(lib, driver_delay_s=1e-6, shorted_fraction=0.8, shorted_coupling=0.5)
    drive(library, coil, 1, 0)
    assert library.coil_current(coil, 90 * US) == pytest.approx(10.0 + (V - R * 10.0) * 1e-6 / L, rel=1e-9)
    library.coil_fault(coil, library.COIL_SHORTED, True, 100 * US)
    inductance = L / (0.2**2 + 0.8**2 + 2 * 0.5 * 0.2 * 0.8) * 0.2**2 * (1 - 0.5**2)
    assert library.coil_current(coil, 190 * US) == pytest.approx(10.0 + (V - R * 2.0) * 1e-6 / inductance, rel=1e-9)


def test_a_runaway_goes_to_the_full_supply_or_to_the_drivers_limit(lib):
    _, library = lib
    free, limited = make(lib), make(lib, driver_limit_A=25.0)
    for coil in (free, limited):
        drive(library, coil, -1, 0)
        library.coil_fault(coil, library.COIL_RUNAWAY, True, 100 * US)
    slope = (library.coil_current(free, 101 * US) + 10.0) / 1e-6
    assert slope == pytest.approx(-(V - R * 10.0) / L, rel=1e-2)  # 0.62 A/us.
    assert library.coil_current(free, PS) == pytest.approx(-V / R, rel=1e-9)
    assert library.coil_current(limited, PS) == -25.0
    library.coil_enable(limited, False, 2 * PS)
    assert library.coil_current(limited, 2 * PS + 60 * US) == 0.0


def test_a_shorted_half_of_the_bridge_drives_whatever_is_asked(lib):
    _, library = lib
    coil = make(lib, driver_limit_A=15.9)
    library.coil_enable(coil, False, 0)
    library.coil_fault(coil, library.COIL_STUCK_ON, True, 0)
    assert library.coil_current(coil, 100 * US) == 15.9


@pytest.mark.parametrize(
    ("fault", "current", "sensed"), [("COIL_BRIDGE_SWAPPED", -10.0, -10.0), ("COIL_REVERSED", -10.0, 10.0)]
)
def test_wires_that_are_exchanged_turn_the_current(lib, fault, current, sensed):
    """The asymmetry is the driver's: it goes with the direction that the driver drives in."""
    _, library = lib
    coil = make(lib, asymmetry=0.01)
    library.coil_fault(coil, getattr(library, fault), True, 0)
    drive(library, coil, 1, 0)
    larger = 1.0 + 0.01 * np.sign(sensed)
    assert library.coil_current(coil, 90 * US) == pytest.approx(current * larger)
    assert library.coil_sense(coil, 2, 90 * US) == pytest.approx(1.65 + sensed * larger * 0.103125)
    library.coil_fault(coil, getattr(library, fault), False, 95 * US)
    assert library.coil_current(coil, 190 * US) == pytest.approx(10.1)


def test_a_held_sense_does_not_move(lib):
    _, library = lib
    coil = make(lib)
    drive(library, coil, 1, 0)
    seen = library.coil_sense(coil, 2, 90 * US)
    library.coil_fault(coil, library.COIL_SENSE_HELD, True, 95 * US)
    drive(library, coil, -1, 100 * US)
    assert library.coil_sense(coil, 2, 190 * US) == seen
    library.coil_fault(coil, library.COIL_SENSE_HELD, False, 200 * US)
    assert library.coil_sense(coil, 2, 290 * US) == pytest.approx(1.65 - 10.0 * 0.103125)


@pytest.mark.parametrize(("degC", "volts"), [(25.0, 1.65), (0.0, 2.5436), (85.0, 0.3235)])
def test_thermistor(lib, degC, volts):
    """B 3950 K by its definition, R = R25 exp(B (1/T - 1/298.15)), evaluated by hand: 33.6 and 1.087 kOhm."""
    assert lib[1].thermistor_volts(degC) == pytest.approx(volts, abs=2e-3)
