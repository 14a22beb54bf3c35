"""`goldfield paper prigge`: the figures of maths.md within 1 dB, again by NumPy's pseudo-inverse and random draws."""

import json
import math

import numpy as np
import pytest

from goldfield.cli import main
from hil_sim.papers.prigge.comparison import (
    Setup,
    below_chip_rate,
    code_drives,
    coil_rise,
    conductor,
    figure_4,
    slot_drives,
    systems,
    tone_drives,
)
from tests.host.fake_sensor import CHIPS

SETUP = Setup()
PUBLISHED = {  # maths.md, 1: noise, mains rms and worst in dB, unit impulse
    "TDMA + quiet slot": (0.367, 2.7, 5.3, 0.099),
    "FDMA": (0.044, -math.inf, -math.inf, 0.002),
    "CDMA": (0.0313, -29.8, -23.1, 0.001),
}


@pytest.fixture(scope="module")
def figures():
    return {system.system: system for system in systems(SETUP)}


def within_a_decibel(value, published):
    return abs(20.0 * math.log10(value / published)) < 1.0


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_table_of_maths(figures, name):
    noise, mains, worst, impulse = PUBLISHED[name]
    system = figures[name]
    assert within_a_decibel(system.noise, noise)
    assert within_a_decibel(system.impulse, impulse)
    assert system.earth < 1e-9
    if math.isinf(mains):
        assert max(system.mains_rms_dB, system.mains_worst_dB) < -200.0
    else:
        assert system.mains_rms_dB == pytest.approx(mains, abs=1.0)
        assert system.mains_worst_dB == pytest.approx(worst, abs=1.0)


def test_factor_ten_at_equal_peak_and_none_at_equal_power(figures):
    slots, codes = figures["TDMA, no quiet slot"], figures["CDMA"]
    assert slots.noise / codes.noise == pytest.approx(10.0, rel=0.02)
    assert (slots.noise / slots.peak) / (codes.noise / codes.peak) == pytest.approx(1.0, abs=0.01)
    assert figures["TDMA + quiet slot"].noise / codes.noise == pytest.approx(11.7, rel=0.05)
    assert slots.earth == pytest.approx(1.0)


def test_mains_columns_reject_65_dB_for_less_than_one_percent_of_noise(figures):
    assert figures["CDMA + mains columns"].mains_rms_dB < -65.0
    assert figures["CDMA + mains columns"].noise / figures["CDMA"].noise < 1.01
    closer = systems(Setup(mains_error_Hz=0.02))[-1]
    assert closer.mains_rms_dB == pytest.approx(-79.0, abs=1.0)


@pytest.mark.parametrize(
    ("name", "drives"), [("TDMA + quiet slot", slot_drives), ("FDMA", tone_drives), ("CDMA", code_drives)]
)
def test_against_numpy(figures, name, drives):
    """Noise and hum drawn at random, separated by NumPy's pseudo-inverse."""
    columns = np.hstack([drives(SETUP), np.ones((1023, 1))])
    weights = np.linalg.pinv(columns)[:100]
    rng = np.random.default_rng(11)
    noise = weights @ rng.normal(size=(1023, 4000))
    assert noise.std() == pytest.approx(figures[name].noise, rel=0.02)
    if name != "FDMA":
        phase = rng.uniform(0.0, 2.0 * np.pi, size=2000)
        hum = np.sin(2.0 * np.pi * 60.0 * np.arange(1, 1024)[:, None] * 0.1 / 1023 + phase)
        ratio = np.sqrt(np.mean((weights @ hum) ** 2) / np.mean(hum**2))
        assert 20.0 * math.log10(ratio) == pytest.approx(figures[name].mains_rms_dB, abs=0.3)


def test_spectrum_against_an_oversampled_transform():
    drives = np.hstack([slot_drives(SETUP)[:, :1], tone_drives(SETUP)[:, 99:100], code_drives(SETUP)[:, :1]])
    points = 64
    dense = np.repeat(drives - drives.mean(axis=0), points, axis=0)
    energy = np.abs(np.fft.rfft(dense, axis=0)) ** 2
    expected = energy[:1023].sum(axis=0) / energy.sum(axis=0)
    np.testing.assert_allclose(below_chip_rate(drives), expected, atol=2e-4)


def test_conductor_against_its_steps():
    """The answer to each step, summed one by one over three cycles."""
    drive = CHIPS[:, 0].astype(float)
    steps = np.tile(drive - np.roll(drive, 1), 3)
    decay = np.exp(-(np.arange(40) + 1) / 0.8)
    expected = np.convolve(steps, decay)[2 * 1023 : 3 * 1023]
    np.testing.assert_allclose(conductor(drive[:, None], 0.8)[:, 0], expected, atol=1e-12)


def test_figure_4():
    sine, square, code = figure_4(0.3e-3)
    assert sine.below < 1e-9
    assert square.below < 1e-9
    assert code.below == pytest.approx(0.903, abs=0.001)  # main lobe of sinc^2
    assert code.eddy < square.eddy < sine.eddy
    assert square.eddy == pytest.approx(2.0 / (1.0 + math.exp(0.5 / 0.3)))  # geometric series of alternating steps


@pytest.mark.parametrize(("tau", "ignored", "range_mm"), [(0.1, -0.0045, 0.03), (0.2, -0.68, 4.5), (0.3, -3.56, 24.0)])
def test_bias_of_coil_rise_and_cures(tau, ignored, range_mm):
    """The figures of maths.md, 1; the cures below .01 % (known tau: rounding)."""
    rise = coil_rise(tau)
    assert 100.0 * rise.ignored == pytest.approx(ignored, rel=0.02)
    assert 1e3 * rise.range_m == pytest.approx(range_mm, rel=0.03)
    assert max(abs(rise.exact), abs(rise.sharp)) < 1e-12
    assert abs(rise.unknown) < 1e-4


def test_the_command(tmp_path, capsys):
    picture = tmp_path / "figure.png"
    assert main(["paper", "prigge", "--beacons", "20", "--figure", str(picture)]) == 0
    text = capsys.readouterr().out
    assert "11.99, 5.99, 0.98 by plain correlation" in text
    for word in ("TDMA + quiet slot", "equal average power", "FIG. 4", "coil rise"):
        assert word in text
    assert picture.read_bytes()[:4] == b"\x89PNG"
    assert main(["paper", "prigge", "--beacons", "20", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert [system["system"] for system in record["systems"]][1:4] == list(PUBLISHED)
    assert record["gain_equal_peak"] == pytest.approx(math.sqrt(1023 / (1023 // 21)), rel=1e-3)
    assert [rise["tau_chips"] for rise in record["coil_rise"]] == [0.1, 0.2, 0.3]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--degree", "8"], "--degree is 8"),
        (["--degree", "5"], "have no room in 31 chips"),
        (["--degree", "7"], "more than the 63 balanced codes of degree 7"),
        (["--beacons", "600"], "more than the 510 tones of 1023 samples"),
        (["--mains", "6000"], "above half the sample rate"),
        (["--figure", "/nowhere/figure.png", "--beacons", "3"], "cannot be written"),
    ],
)
def test_each_error_is_one_sentence(capsys, options, words):
    assert main(["paper", "prigge", *options]) == 2
    message = capsys.readouterr().err
    assert words in message
    assert message.count("\n") == 1
