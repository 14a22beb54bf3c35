"""Coil rise: exact templates, sharpened samples, unknown time constants; the current itself is solved by SciPy here."""

import json
import math

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

from goldfield.access import Separator, SiteAccess
from goldfield.access.epoch import EpochSeparator
from goldfield.access.rise import filtered, remainder, sharpened
from goldfield.cli import main
from goldfield.link.reports import Report
from goldfield.site import Beacon, SensorSite, Site
from goldfield.site.drive import Drive
from tests.host.fake_sensor import CHIPS, CODES, EARTH_T, SITE, beacon_fields

N, CHIP_S, NOISE_T = 1023, 97.75e-6, 2e-7
TAU = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.0, 0.35])  # in chips, of eight different coils


def current(drive, tau_chips, points=8):
    """Current at the end of each chip of a second cycle, as SciPy solves tau i' + i = c in continuous time."""
    held = np.tile(np.repeat(drive.astype(float), points), 2)
    time = np.arange(len(held) + 1) / points
    solved = lsim(([1.0], [tau_chips, 1.0]), np.append(held, held[0]), time, interp=False)[1]
    return solved[points * N :: points][1:]


CURRENTS = np.stack([current(c, tau) if tau else c.astype(float) for c, tau in zip(CHIPS.T, TAU, strict=True)], axis=1)


@pytest.mark.parametrize("tau", [0.05, 0.35, 10.0])
@pytest.mark.parametrize("shape", [(1,), (N,), (N, 4)])
def test_templates_are_those_of_the_filter_of_scipy_to_rounding(shape, tau):
    """A Fourier transform rounds by the machine's precision times the logarithm of its length (Schatzman, 1996)."""
    drive, e = np.random.default_rng(5).standard_normal(shape), remainder(tau)
    last = lfilter([1.0 - e], [1.0, -e], drive, axis=0)[-1] / (1.0 - e ** len(drive))
    expected = lfilter([1.0 - e], [1.0, -e], drive, axis=0, zi=e * last[None])[0]
    rounding = np.finfo(float).eps * (1.0 + np.log2(len(drive))) * np.abs(drive).max()
    np.testing.assert_allclose(filtered(drive, tau), expected, rtol=0.0, atol=rounding)


def site_of(tau_chips):
    beacons = [
        Beacon(
            f"b{code}", np.zeros(3), np.array([0.0, 0.0, 1.0]), 19.0, 0.149, None, 10.0, code, Drive(tau_s=t * CHIP_S)
        )
        for code, t in zip(CODES, tau_chips, strict=True)
    ]
    return Site("slow", CHIP_S, 10, None, SensorSite(NOISE_T), tuple(beacons))


@pytest.mark.parametrize("tau", [0.1, 0.3, 1.0, 5.0])
def test_filter_against_the_solved_current(tau):
    np.testing.assert_allclose(filtered(CHIPS[:, 0].astype(float), tau), current(CHIPS[:, 0], tau), atol=1e-9)


def test_no_rise_changes_nothing():
    assert filtered(CHIPS, 0.0) is CHIPS
    np.testing.assert_array_equal(sharpened(CHIPS.astype(float), 0.0), CHIPS)


def test_sharpening_undoes_the_filter():
    np.testing.assert_allclose(sharpened(filtered(CHIPS.astype(float), 0.7), 0.7), CHIPS, atol=1e-12)


def test_exact_templates_of_eight_different_coils():
    fields = beacon_fields()
    samples = CURRENTS @ fields + EARTH_T
    separation = SiteAccess(site_of(TAU)).from_samples(samples)
    np.testing.assert_allclose(separation.field_T, fields, atol=1e-9 * np.abs(fields).max())
    ignored = SiteAccess(site_of(np.zeros(8))).from_samples(samples)
    assert np.linalg.norm(ignored.field_T[5]) / np.linalg.norm(fields[5]) - 1.0 == pytest.approx(-0.036, abs=0.004)


def test_the_sensors_plain_sums_suffice():
    """Plain correlations of slow coils: exact fields, through the separator and through a report."""
    fields = beacon_fields()
    samples = CURRENTS @ fields + EARTH_T
    sums, mean = CHIPS.T @ samples / N, samples.mean(axis=0)
    separator = Separator(10, CODES, NOISE_T, TAU.tolist())
    by_sums = separator.from_correlations(sums, mean, np.zeros(8))
    np.testing.assert_allclose(by_sums.field_T, fields, atol=1e-9 * np.abs(fields).max())
    np.testing.assert_allclose(by_sums.offset_T, EARTH_T, atol=1e-15)
    np.testing.assert_allclose(separator.from_samples(samples).field_T, fields, atol=1e-9 * np.abs(fields).max())
    report = Report(7, 0.7, chips=N, offset_T=mean, correlation_T=dict(zip(CODES, sums, strict=True)))
    np.testing.assert_allclose(EpochSeparator(site_of(TAU)).fields(report).field_T, by_sums.field_T, atol=1e-18)


def test_sigma_is_what_noise_makes():
    """In 150 cycles of noise the spread equals sigma within 5 %, for sums and for samples."""
    rng = np.random.default_rng(8)
    separator = Separator(10, CODES, NOISE_T, TAU.tolist())
    by_sums, by_samples = [], []
    for _ in range(150):
        noise = rng.normal(scale=NOISE_T, size=(N, 3))
        sums = separator.from_correlations(CHIPS.T @ noise / N, noise.mean(axis=0), np.zeros(8))
        by_sums.append(sums.field_T / sums.sigma_T[:, None])
        samples = separator.from_samples(noise)
        by_samples.append(samples.field_T / samples.sigma_T[:, None])
    assert np.sqrt(np.mean(np.square(by_sums))) == pytest.approx(1.0, abs=0.05)
    assert np.sqrt(np.mean(np.square(by_samples))) == pytest.approx(1.0, abs=0.05)


def test_sigma_of_sums_is_that_of_their_weights():
    """Slow coils, a whole chip and more, against the weights of the samples written out."""
    tau = np.linspace(0.3, 1.7, 8)
    templates = np.stack([filtered(c.astype(float), t) for c, t in zip(CHIPS.T, tau, strict=True)], axis=1)
    centred = CHIPS - CHIPS.mean(axis=0)
    weights = np.linalg.solve(centred.T @ templates, centred.T)
    np.testing.assert_allclose(weights @ templates, np.eye(8), atol=1e-12)
    separation = Separator(10, CODES, NOISE_T, tau.tolist()).from_correlations(
        np.zeros((8, 3)), np.zeros(3), np.zeros(8)
    )
    np.testing.assert_allclose(separation.sigma_T, NOISE_T * np.sqrt((weights**2).sum(axis=1)), rtol=1e-9)


def test_unknown_time_constants():
    """maths.md: worst .019 % of the field without noise; the time constants follow to 1 % of a chip."""
    fields = beacon_fields()
    cycle = SiteAccess(site_of(np.zeros(8)), unknown_rise=True).cycle(CURRENTS @ fields + EARTH_T)
    error = np.linalg.norm(cycle.separation.field_T - fields, axis=1) / np.linalg.norm(fields, axis=1)
    assert error.max() < 4e-4
    assert error[TAU <= 0.3].max() < 1.9e-4
    assert np.abs(cycle.tau_s / CHIP_S - TAU)[TAU >= 0.15].max() < 0.01
    assert cycle.tau_s[6] < 0.1 * CHIP_S  # e is below 1e-4 for such a coil: its tau hides in what others leave
    access = SiteAccess(site_of(np.zeros(8)), unknown_rise=True)
    np.testing.assert_allclose(np.sqrt(np.diag(access.covariance_T2)), NOISE_T * math.sqrt(3.0 / N), rtol=0.06)


def test_the_command_takes_tau_from_the_site_or_finds_it(tmp_path, capsys):
    table, site = tmp_path / "samples.csv", tmp_path / "site.toml"
    samples = CURRENTS @ beacon_fields() + EARTH_T
    lines = [f"{t},{','.join(repr(float(v)) for v in row)}" for t, row in enumerate(samples)]
    table.write_text("\n".join(["chip,bx_T,by_T,bz_T", *lines]))
    text = SITE.read_text()
    for code, tau in zip(CODES, TAU, strict=True):
        text = text.replace(f"code = {code}\n", f"code = {code}\ntau_s = {float(tau * CHIP_S)!r}\n")
    site.write_text(text)

    def fields(*options):
        assert main(["separate", "--site", str(site), str(table), "--json", *options]) == 0
        return json.loads(capsys.readouterr().out)["fields"]

    np.testing.assert_allclose([f["b_T"] for f in fields()], beacon_fields(), atol=1e-14)
    found = fields("--unknown-rise")
    assert found[5]["tau_s"] == pytest.approx(0.3 * CHIP_S, rel=0.02)
    np.testing.assert_allclose(found[5]["b_T"], beacon_fields()[5], rtol=1e-3)
