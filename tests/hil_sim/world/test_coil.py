"""The coil's current against a numerical solution of the same circuit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from hil_sim import clib
from tests.hil_sim.world.circuit import integrate

L, R, V, LAG = 1.9e-4, 0.15, 120.0, 1.6e-6
PS = 10**12


@pytest.fixture(scope="module")
def lib():
    return clib.load("build/libgf_rig.so", ["world/coil.h"])


def make(lib, **changes):
    ffi, library = lib
    values = dict(
        inductance_H=L,
        resistance_Ohm=R,
        supply_V=V,
        reference_A_per_V=16.0 / 3.3,
        sense_V_per_A=0.103125,
        sense_noise_V=0.0,
        lag_s=LAG,
        ambient_degC=20.0,
    )
    coil = ffi.new("coil_t *")
    library.coil_init(coil, ffi.new("coil_config_t *", values | changes))
    return coil


def drive(library, coil, level, time_ps):
    """Positive for +1, negative for -1, zero for 0."""
    library.coil_input(coil, 1, level > 0, time_ps)
    library.coil_input(coil, 2, level < 0, time_ps)


def test_chips_match_the_circuit(lib):
    _, library = lib
    coil = make(lib)
    library.coil_reference(coil, 10.0 / 16.0 * 3.3, 0)
    library.coil_enable(coil, True, 0)
    plan = [(2e-6, 10.0), (100e-6, -10.0), (108e-6, 10.0), (200e-6, 0.0), (300e-6, -10.0)]
    for start, target in plan:
        drive(library, coil, target, round(start * PS))
    times = np.arange(3.3e-6, 400e-6, 3.7e-6)
    expected = integrate(plan, 400e-6, times, inductance_H=L, resistance_Ohm=R, supply_V=V, lag_s=LAG)
    current = [library.coil_current(coil, round(t * PS)) for t in times]
    lagged = [library.coil_lagged(coil, library.coil_head(coil), round(t * PS)) for t in times]
    np.testing.assert_allclose(current, expected[:, 0], atol=2e-7)
    np.testing.assert_allclose(lagged, expected[:, 1], atol=2e-6)
    assert abs(current[20]) == pytest.approx(10.0, abs=1e-12)  # held, not merely near


def test_a_weak_supply_never_reaches_the_set_point(lib):
    _, library = lib
    coil = make(lib, supply_V=1.0, lag_s=0.0)
    library.coil_reference(coil, 10.0 / 16.0 * 3.3, 0)
    library.coil_enable(coil, True, 0)
    drive(library, coil, 1, 0)
    for t in (1e-4, 1e-3, 0.1):
        assert library.coil_current(coil, round(t * PS)) == pytest.approx(
            1.0 / R * (1.0 - np.exp(-t * R / L)), rel=1e-12
        )


def test_disabling_runs_the_current_down_against_the_supply_and_it_stays_down(lib):
    _, library = lib
    coil = make(lib)
    library.coil_reference(coil, 3.3, 0)
    library.coil_enable(coil, True, 0)
    drive(library, coil, 1, 0)
    library.coil_enable(coil, False, 100 * 10**6)
    fall_s = L / R * np.log((16.0 + V / R) / (V / R))
    before, after = 100e-6 + 0.99 * fall_s, 100e-6 + 1.01 * fall_s
    assert 0.0 < library.coil_current(coil, round(before * PS)) < 0.2
    assert library.coil_current(coil, round(after * PS)) == 0.0
    assert library.coil_current(coil, PS) == 0.0


def test_a_query_of_the_past_sees_the_past(lib):
    _, library = lib
    coil = make(lib)
    library.coil_reference(coil, 3.3, 0)
    library.coil_enable(coil, True, 0)
    for chip in range(100):
        drive(library, coil, 1 if chip % 2 else -1, chip * 100 * 10**6)
    head = library.coil_head(coil)
    past = [library.coil_lagged(coil, head, t * 10**6) for t in range(9000, 9900, 7)]
    for chip in range(100, 150):
        drive(library, coil, 1 if chip % 2 else -1, chip * 100 * 10**6)
    assert library.coil_head(coil) > head
    assert past == [library.coil_lagged(coil, library.coil_head(coil), t * 10**6) for t in range(9000, 9900, 7)]
    assert past == [library.coil_lagged(coil, head, t * 10**6) for t in range(9000, 9900, 7)]


def test_open_coil_has_no_current(lib):
    _, library = lib
    coil = make(lib, lag_s=0.0)
    library.coil_reference(coil, 3.3, 0)
    library.coil_enable(coil, True, 0)
    drive(library, coil, 1, 0)
    library.coil_fault(coil, library.COIL_OPEN, True, 10**9)
    assert library.coil_current(coil, 10**9 - 1) == pytest.approx(16.0)
    assert library.coil_current(coil, 10**9) == 0.0
    drive(library, coil, -1, 2 * 10**9)
    assert library.coil_current(coil, 3 * 10**9) == 0.0
    library.coil_fault(coil, library.COIL_OPEN, False, 4 * 10**9)
    assert library.coil_current(coil, 5 * 10**9) == pytest.approx(-16.0)


def test_sense_voltage_and_its_noise(lib):
    _, library = lib
    coil = make(lib, sense_noise_V=1e-3)
    library.coil_reference(coil, 3.3, 0)
    library.coil_enable(coil, True, 0)
    drive(library, coil, 1, 0)
    volts = np.array([library.coil_sense(coil, 9, 10**9 + 10**6 * k) for k in range(4000)])
    assert volts.mean() == pytest.approx(1.65 + 16.0 * 0.103125, abs=4e-3 / np.sqrt(4000))
    assert volts.std() == pytest.approx(1e-3, rel=0.05)
    library.coil_fault(coil, library.COIL_SENSE_LOW, True, 10**9)
    assert library.coil_sense(coil, 9, 2 * 10**9) == 0.0


def test_equal_time_constants_are_no_trap(lib):
    _, library = lib
    equal, near = make(lib, lag_s=L / R), make(lib, lag_s=L / R * 1.001)
    for coil in (equal, near):
        library.coil_reference(coil, 3.3, 0)
        library.coil_enable(coil, True, 0)
        drive(library, coil, 1, 0)
    values = [library.coil_lagged(equal, library.coil_head(equal), t * 10**6) for t in range(0, 3000, 50)]
    others = [library.coil_lagged(near, library.coil_head(near), t * 10**6) for t in range(0, 3000, 50)]
    np.testing.assert_allclose(values, others, atol=0.02)
    assert all(a < b for a, b in pairwise(values))
