"""Time constants and polarity of coils from raw samples, against circuits solved in time and magpylib's fields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.calibration.coils import calibrate_coils
from goldfield.errors import UserError
from hil_sim import scenario

PLACE_M = np.array([0.9, 1.2, 0.8])
TURN = Rotation.from_rotvec([0.5, -1.1, 0.7])
TAUS_US = np.array([0.0, 5.0, 20.0, 35.0, 60.0, 100.0, 200.0, 500.0])


@pytest.fixture(scope="module")
def bench():
    return scenario.load_scenario("prigge8")


@pytest.fixture
def site(bench, tmp_path):
    path = tmp_path / "site.toml"
    path.write_text(scenario.site_toml(bench))
    return sites.load(path)


def codes(bench):
    """Return the chips of all beacons, shape (N, n), from the definition: two Fibonacci registers, all ones."""
    registers = {}
    for name, taps in (("u", (3, 10)), ("v", (2, 3, 6, 8, 9, 10))):
        state, out = [1] * 10, []
        for _ in range(1023):
            out.append(state[9])
            state = [sum(state[tap - 1] for tap in taps) % 2, *state[:9]]
        registers[name] = np.array(out)
    bits = [registers["u"] ^ np.roll(registers["v"], -beacon.code) for beacon in bench.beacons]
    return 1.0 - 2.0 * np.array(bits).T


def samples(bench, *, taus_us, signs=None, cycles=4, noise_T=2e-7, seed=1):
    """Return samples at the ends of the chips of currents that follow their drives exponentially."""
    random = np.random.default_rng(seed)
    signs = np.ones(8) if signs is None else signs
    chips = codes(bench)
    total = np.zeros((1023, 3))
    for column, (beacon, tau_us, sign) in enumerate(zip(bench.beacons, taus_us, signs, strict=True)):
        field = TURN.inv().apply(beacon.geometry.field_per_ampere(PLACE_M[None])[0]) * beacon.circuit.current_A * sign
        current, response = 0.0, []
        rest = np.exp(-scenario.CHIP_PERIOD_S * 1e6 / tau_us) if tau_us else 0.0
        for chip in [*chips[:, column], *chips[:, column]]:  # the second cycle goes on from the first
            current = chip + (current - chip) * rest
            response.append(current)
        total += np.outer(response[1023:], field)
    total += np.array([2e-5, 1e-5, -4e-5])
    return total + noise_T * random.normal(size=(cycles, 1023, 3))


def test_time_constants(bench, site):
    found = calibrate_coils(site, samples(bench, taus_us=TAUS_US), PLACE_M)
    for coil, tau_us in zip(found, TAUS_US, strict=True):
        if coil.tau_sd_s is None:
            assert coil.tau_s == 0.0
            assert tau_us * 1e-6 < coil.tau_below_s
        else:
            assert abs(coil.tau_s - tau_us * 1e-6) < 4.0 * coil.tau_sd_s
            assert coil.tau_sd_s < 0.15 * coil.tau_s
    assert [coil.tau_sd_s is not None for coil in found[3:]] == [True] * 5
    assert found[0].tau_sd_s is None


def test_the_deviations_are_those_of_the_errors(bench, site):
    """Chi-square of 80 over ten recordings, both sides at 1e-4."""
    taus_us = np.full(8, 80.0)
    total = 0.0
    for seed in range(10):
        for coil in calibrate_coils(site, samples(bench, taus_us=taus_us, seed=seed), PLACE_M):
            total += ((coil.tau_s - 80e-6) / coil.tau_sd_s) ** 2
    assert 40.0 < total < 135.0


@pytest.mark.parametrize("place_m", [PLACE_M, None])
def test_one_reversed_coil(bench, site, place_m):
    signs = np.array([1, 1, 1, -1, 1, 1, 1, 1])
    found = calibrate_coils(site, samples(bench, taus_us=np.zeros(8), signs=signs), place_m)
    assert [coil.reversed for coil in found] == [False] * 3 + [True] + [False] * 4


@pytest.mark.parametrize("signs", [[-1, 1, -1, 1, -1, 1, 1, 1], [-1] * 8, [1, -1, -1, -1, -1, -1, -1, 1]])
def test_any_number_of_reversed_coils_at_a_known_place(bench, site, signs):
    found = calibrate_coils(site, samples(bench, taus_us=np.zeros(8), signs=np.array(signs)), PLACE_M)
    assert [coil.reversed for coil in found] == [sign < 0 for sign in signs]


def test_many_reversed_coils_at_an_unknown_place_are_not_told(bench, site):
    signs = np.array([-1, 1, -1, 1, -1, 1, 1, 1])
    found = calibrate_coils(site, samples(bench, taus_us=np.zeros(8), signs=signs))
    assert {coil.reversed for coil in found} == {None}


def test_a_wrong_place_tells_nothing(bench, site):
    found = calibrate_coils(site, samples(bench, taus_us=np.zeros(8)), np.array([2.5, 0.2, 0.1]))
    assert {coil.reversed for coil in found} == {None}


def test_missing_samples_are_made_up_by_other_cycles(bench, site):
    chips = samples(bench, taus_us=TAUS_US)
    chips[0, 5:40] = np.nan
    assert abs(calibrate_coils(site, chips, PLACE_M)[5].tau_s - 100e-6) < 1e-5
    chips[:, 7] = np.nan
    with pytest.raises(UserError, match="some chips are missing in every cycle: record more cycles"):
        calibrate_coils(site, chips)


def test_tones_have_no_edges(bench, site):
    with pytest.raises(UserError, match="coils driven by tones show no edges"):
        calibrate_coils(replace(site, access="fdma"), samples(bench, taus_us=TAUS_US))
