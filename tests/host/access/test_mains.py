"""Hum of the mains: columns, the search for its frequency, and what it costs."""

import json

import numpy as np
import pytest

from goldfield.access import SiteAccess
from goldfield.access.nuisance import mains, mains_frequency
from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.site import load
from tests.host.fake_sensor import CHIPS, EARTH_T, SITE, beacon_fields

N, CHIP_S, NOISE_T = 1023, 97.75e-6, 2e-7
TIME_S = (np.arange(N) + 1) * CHIP_S
KNOWN = np.hstack([CHIPS, np.ones((N, 1))])


def hum(frequency_Hz, amplitude_T=5e-7, seed=0):
    """Half a microtesla of hum with a third harmonic of a quarter, each axis with its own phase."""
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, size=(2, 3))
    angle = 2.0 * np.pi * frequency_Hz * TIME_S[:, None]
    return amplitude_T * (np.sin(angle + phase[0]) + 0.25 * np.sin(3.0 * angle + phase[1]))


def samples_with(hum_T, seed=1, noise_T=NOISE_T):
    return CHIPS @ beacon_fields() + EARTH_T + hum_T + np.random.default_rng(seed).normal(scale=noise_T, size=(N, 3))


def test_columns_take_a_hum_of_known_frequency_out():
    access = SiteAccess(load(SITE), mains_Hz=50.0, harmonics=3)
    cycle = access.cycle(samples_with(hum(50.123), noise_T=1e-15))
    assert cycle.mains_Hz == pytest.approx(50.123, abs=1e-4)
    error = np.abs(cycle.separation.field_T - beacon_fields()).max()
    ignored = np.abs(
        SiteAccess(load(SITE)).from_samples(samples_with(hum(50.123), noise_T=1e-15)).field_T - beacon_fields()
    )
    assert error < 1e-12
    assert ignored.max() > 1e-8


@pytest.mark.parametrize("frequency", [49.55, 49.93, 50.0, 50.31, 50.45])
def test_search_in_noise(frequency):
    """Half a microtesla in 0.2 uT of noise: within 0.2 Hz from a single cycle of 0.1 s."""
    found = [
        mains_frequency(samples_with(hum(frequency, seed=k), seed=k), KNOWN, CHIP_S, 50.0, harmonics=3)
        for k in range(10)
    ]
    assert np.abs(np.array(found) - frequency).max() < 0.2
    assert np.sqrt(np.mean((np.array(found) - frequency) ** 2)) < 0.1


def test_mains_cost_less_than_one_percent_of_noise_and_the_error_is_noise():
    site = load(SITE)
    plain, without = SiteAccess(site), SiteAccess(site, mains_Hz=60.0, harmonics=3)
    ratio = np.sqrt(np.diag(without.covariance_T2) / np.diag(plain.covariance_T2))
    assert ratio.max() < 1.01
    errors = []
    for seed in range(40):
        separation = without.from_samples(samples_with(hum(60.0 + 0.4 * np.sin(seed), seed=seed), seed=seed))
        errors.append((separation.field_T - beacon_fields()) / separation.sigma_T[:, None])
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(1.0, abs=0.06)


def test_an_axis_that_was_not_measured_is_not_searched():
    samples = samples_with(hum(50.2))
    samples[5, 0] = np.nan
    samples[:, 1] = np.nan
    assert mains_frequency(samples, KNOWN, CHIP_S, 50.0) == pytest.approx(50.2, abs=0.3)
    assert mains_frequency(np.full((N, 3), np.nan), KNOWN, CHIP_S, 50.0) == 50.0
    assert 49.5 <= mains_frequency(np.zeros((N, 3)), KNOWN, CHIP_S, 50.0) <= 50.5


def test_columns_are_the_waves_of_the_harmonics():
    angle = 2.0 * np.pi * 50.0 * TIME_S
    waves = np.stack([np.cos(angle), np.sin(angle), np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=1)
    np.testing.assert_allclose(mains(N, CHIP_S, 50.0, harmonics=2).columns, waves, atol=1e-12)


def test_tones_and_mains_that_are_the_same_are_refused(tmp_path):
    """Beacons with 5 and 15 whole periods, a hum with 5 and its harmonics: only the constant phases differ."""
    text = SITE.read_text().replace("degree = 10", 'degree = 10\naccess = "fdma"')
    for code, periods in zip(range(2, 10), (1, 2, 3, 4, 5, 6, 7, 15), strict=True):
        text = text.replace(f"code = {code}\n", f"frequency_Hz = {periods / (N * CHIP_S)!r}\n")
    path = tmp_path / "tones.toml"
    path.write_text(text)
    same = 5.0 / (N * CHIP_S)
    with pytest.raises(UserError, match=r'"b5" and the mains at 50\.0009 Hz cannot be told apart'):
        SiteAccess(load(path), mains_Hz=same)


def test_the_command_takes_the_mains_out(tmp_path, capsys):
    table = tmp_path / "samples.csv"
    lines = [f"{t},{','.join(repr(float(v)) for v in row)}" for t, row in enumerate(samples_with(hum(50.2)))]
    table.write_text("\n".join(["chip,bx_T,by_T,bz_T", *lines]))
    arguments = ["separate", "--site", str(SITE), str(table)]

    assert main([*arguments, "--mains", "50", "--harmonics", "3", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["mains_Hz"] == pytest.approx(50.2, abs=0.2)
    error = np.abs(np.array([field["b_T"] for field in record["fields"]]) - beacon_fields())
    assert error.max() < 5 * record["fields"][0]["sigma_T"]
    assert main([*arguments, "--mains", "50"]) == 0
    assert "mains at 50." in capsys.readouterr().out
    assert main([*arguments, "--harmonics", "3"]) == 2
    assert "without --mains" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*arguments, "--mains", "fifty"])
    assert "fifty is no frequency" in capsys.readouterr().err
