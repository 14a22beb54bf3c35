"""Tones of any frequency and unknown phase: against SciPy's least squares, with and without a reference channel."""

import csv
import json
import math

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from goldfield.access.tones import ToneAccess
from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.site import load
from tests.bench import locate_trials as bench

PERIOD_S = 1.0 / 9600.0
SAMPLES = 960
FREQUENCIES = (1012.3, 1111.1, 1234.5, 1400.0, 1523.7, 1690.2, 1777.7, 1900.9)
NOISE_T = 2e-9
FIELD_T = np.array([1.0, -2.0, 0.5]) * 1e-7


def site_text(count=8, more="", phases=None):
    lines = [
        f'[site]\nname = "recorded"\naccess = "fdma"\nphase = "unknown"\nchip_period_s = {PERIOD_S!r}\n'
        f"samples = {SAMPLES}\n[sensor]\nnoise_T = {NOISE_T}\ngain_sd = 0.0\naxis_sd_rad = 0.0\n"
        "[survey]\nposition_sd_m = 0.0\naxis_sd_rad = 0.0\ncurrent_sd = 0.0\n"
    ]
    cube = bench.prigge_cube().beacons
    for beacon, frequency in zip(cube[:count], FREQUENCIES, strict=False):
        place, row = beacon.position_m.tolist(), len(lines) - 1
        axis = np.eye(3)[row % 3].tolist()
        lines.append(
            f'[[beacon]]\nid = "{beacon.id}"\nposition_m = {place}\naxis = {axis}\nturns = 19\nradius_m = 0.149\n'
            f"current_A = 1.0\nfrequency_Hz = {frequency}\n"
            + ("" if phases is None else f"phase_rad = {float(phases[row])!r}\n")
            + more
        )
    return "\n".join(lines)


@pytest.fixture
def site(tmp_path):
    def read(**options):
        path = tmp_path / "site.toml"
        path.write_text(site_text(**options))
        return load(path)

    return read


def tones(fields, phases, window=0, noise_T=NOISE_T, rng=None):
    """Samples, shape (N, 3), of tones with these phases at the first sample of window 0."""
    t = (window * SAMPLES + np.arange(SAMPLES)) * PERIOD_S
    samples = np.tile([2e-5, -1e-5, 4e-5], (SAMPLES, 1))
    for field, phase, frequency in zip(fields, phases, FREQUENCIES, strict=False):
        samples = samples + np.cos(2 * np.pi * frequency * t + phase)[:, None] * field
    return samples if rng is None else samples + noise_T * rng.normal(size=samples.shape)


def by_scipy(samples, count, start):
    """Field and phase of each tone and the constant, all fitted at once."""
    t = np.arange(SAMPLES) * PERIOD_S

    def residual(unknowns):
        fields, phases, constant = unknowns[: 3 * count].reshape(-1, 3), unknowns[3 * count : -3], unknowns[-3:]
        waves = np.cos(2 * np.pi * np.outer(t, FREQUENCIES[:count]) + phases)
        return ((samples - waves @ (fields * 1e-7) - constant * 1e-5) / NOISE_T).ravel()

    return least_squares(residual, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x


@pytest.mark.parametrize("seed", [1, 2])
def test_fields_and_phases_are_scipys_least_squares(site, seed):
    rng = np.random.default_rng(seed)
    fields, phases = 1e-7 * rng.normal(size=(3, 3)), rng.uniform(-1.2, 1.2, size=3)
    samples = tones(fields, phases, rng=rng)
    cycle = ToneAccess(site(count=3)).cycle(samples)
    found = by_scipy(samples, 3, np.concatenate([(fields * 1e7).ravel(), phases, [2.0, -1.0, 4.0]]))
    np.testing.assert_allclose(cycle.separation.field_T, found[:9].reshape(3, 3) * 1e-7, atol=1e-3 * NOISE_T)
    np.testing.assert_allclose(cycle.phase_rad, found[9:12], atol=1e-5)
    np.testing.assert_allclose(cycle.separation.offset_T, found[-3:] * 1e-5, atol=0.1 * NOISE_T)


def test_the_errors_are_as_large_as_sigma_says(site):
    rng, known = np.random.default_rng(3), site(count=2)
    fields, errors = np.stack([FIELD_T, FIELD_T[::-1]]), []
    for _ in range(300):
        separation = ToneAccess(known).cycle(tones(fields, [0.4, -1.0], rng=rng)).separation
        errors.append((separation.field_T - fields) / separation.sigma_T[:, None])
    assert np.mean(np.square(errors)) == pytest.approx(1.0, abs=0.1)


def test_noise_alone_is_enlarged_as_the_module_says(site):
    rng, access = np.random.default_rng(4), ToneAccess(site(count=1))
    separations = [access.cycle(NOISE_T * rng.normal(size=(SAMPLES, 3))).separation for _ in range(400)]
    ratio = np.sqrt(np.mean([(s.field_T[0] / s.sigma_T[0]) ** 2 for s in separations]))
    assert ratio == pytest.approx(1.3, abs=0.05)


@pytest.mark.parametrize(
    ("phase", "told", "sign"), [(1.5, 0.0, 1), (1.65, 0.0, -1), (1.65, math.pi, 1), (-3.0, 0.0, -1), (-3.0, 3.0, 1)]
)
def test_of_two_opposite_phases_the_one_nearer_to_the_file_s_is_meant(site, phase, told, sign):
    cycle = ToneAccess(site(count=1, phases=[told])).cycle(tones([FIELD_T], [phase]))
    np.testing.assert_allclose(cycle.separation.field_T[0], sign * FIELD_T, atol=1e-13)
    expected = phase if sign > 0 else phase + math.pi
    assert math.remainder(cycle.phase_rad[0] - expected, 2 * math.pi) == pytest.approx(0.0, abs=1e-6)


def test_signs_follow_a_clock_that_drifts_and_a_sensor_that_turns(site):
    """The phase goes round twice in 40 windows while the field reverses: it is the field that is followed."""
    access = ToneAccess(site(count=1))
    for window in range(40):
        field = FIELD_T * [1.0, math.cos(0.1 * window), 1.0]
        cycle = access.cycle(tones([field], [0.1 * math.pi * window], window))
        np.testing.assert_allclose(cycle.separation.field_T[0], field, atol=1e-13)


def test_a_reference_channel_decides_the_sign(site):
    rng, known = np.random.default_rng(5), site(count=2)
    access = ToneAccess(known)
    for window in range(5):  # phases jump from window to window: nothing but the channel can tell
        phases = rng.uniform(-np.pi, np.pi, size=2)
        fields = np.stack([FIELD_T, -FIELD_T])
        samples = tones(fields, phases, window, rng=rng)
        current = 3e7 * (tones([FIELD_T, FIELD_T], phases, window)[:, 0] - 2e-5) + 0.01 * rng.normal(size=SAMPLES) + 7.0
        cycle = access.cycle(samples, current)
        np.testing.assert_allclose(cycle.separation.field_T, fields, atol=5 * cycle.separation.sigma_T.max())
        np.testing.assert_allclose(np.exp(1j * cycle.phase_rad), np.exp(1j * phases), atol=0.01)


def test_a_tone_that_the_reference_does_not_hold_has_no_field(site):
    rng = np.random.default_rng(6)
    samples = tones([FIELD_T, FIELD_T], [0.3, 0.4], rng=rng)
    current = tones([FIELD_T], [0.3])[:, 0] * 1e7 + 0.01 * rng.normal(size=SAMPLES)
    separation = ToneAccess(site(count=2)).cycle(samples, current).separation
    assert np.isfinite(separation.field_T[0]).all()
    assert np.isnan(separation.field_T[1]).all()
    assert separation.sigma_T[1] == math.inf


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("value", ["", "nan", "0", "1"])
def test_a_reference_without_any_tone_is_said(tmp_path, capsys, value):
    path, table = tmp_path / "site.toml", tmp_path / "samples.csv"
    path.write_text(site_text())
    site = load(path)
    samples = tones(bench.magpylib_fields(site, np.array([[0.9, 1.2, 0.7]]))[0], np.zeros(8), 0)
    rows = [f"{chip},{x},{y},{z},{value}" for chip, (x, y, z) in enumerate(samples.tolist())]
    table.write_text("\n".join(["chip,bx_T,by_T,bz_T,reference", *rows]) + "\n")
    assert main(["separate", "--site", str(path), str(table), "--json"]) == 0
    captured = capsys.readouterr()
    assert "cycle 0: reference does not hold the tone of " in captured.err
    assert {entry["b_T"][0] for entry in json.loads(captured.out)["fields"]} == {None}


def test_a_reference_in_counts_of_a_converter_is_one(tmp_path, capsys):
    path, table = tmp_path / "site.toml", tmp_path / "samples.csv"
    path.write_text(site_text())
    site = load(path)
    truth = bench.magpylib_fields(site, np.array([[0.9, 1.2, 0.7]]))[0]
    samples, counts = tones(truth, np.zeros(8), 0), 1e9 * tones(np.ones((8, 3)), np.zeros(8), 0)[:, 0]
    rows = [f"{k},{x},{y},{z},{c}" for k, ((x, y, z), c) in enumerate(zip(samples.tolist(), counts, strict=True))]
    table.write_text("\n".join(["chip,bx_T,by_T,bz_T,reference", *rows]) + "\n")
    assert main(["separate", "--site", str(path), str(table), "--json"]) == 0
    fields = [entry["b_T"] for entry in json.loads(capsys.readouterr().out)["fields"]]
    np.testing.assert_allclose(fields, truth, rtol=1e-3, atol=1e-12)


def test_missing_samples_and_a_missing_axis(site):
    rng = np.random.default_rng(7)
    samples = tones([FIELD_T], [0.3], rng=rng)
    samples[100:300, 0] = np.nan
    samples[:, 2] = np.nan
    separation = ToneAccess(site(count=1)).cycle(samples).separation
    assert np.isnan(separation.field_T[0, 2])
    assert (np.abs(separation.field_T[0, :2] - FIELD_T[:2]) < 5 * separation.sigma_T[0]).all()
    whole = ToneAccess(site(count=1)).cycle(tones([FIELD_T], [0.3], rng=rng)).separation
    assert separation.sigma_T[0] > 1.05 * whole.sigma_T[0]


def test_a_hum_is_taken_out(site):
    hum = 1e-6 * np.cos(2 * np.pi * 50.2 * np.arange(1, SAMPLES + 1) * PERIOD_S + 0.5)[:, None]
    cycle = ToneAccess(site(count=1), 50.0).cycle(tones([FIELD_T], [0.3]) + hum)
    assert cycle.mains_Hz == pytest.approx(50.2, abs=1e-3)
    np.testing.assert_allclose(cycle.separation.field_T[0], FIELD_T, atol=1e-11)


@pytest.mark.parametrize("reference", [True, False])
def test_a_recording_becomes_poses(tmp_path, capsys, reference):
    rng = np.random.default_rng(8)
    phases = rng.uniform(-np.pi, np.pi, size=8)
    path, table, fields = (tmp_path / name for name in ("site.toml", "samples.csv", "fields.csv"))
    path.write_text(site_text(phases=None if reference else phases + rng.uniform(-1.0, 1.0, size=8)))
    site = load(path)
    position, rotation = np.array([0.9, 1.2, 0.7]), Rotation.from_rotvec([0.3, -0.5, 0.2])
    truth = rotation.inv().apply(bench.magpylib_fields(site, position[None])[0])
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["chip", "bx_T", "by_T", "bz_T", *(["reference"] if reference else [])])
        for window in range(3):
            samples = tones(truth, phases, window, rng=rng)
            current = tones(np.ones((8, 3)), phases, window)[:, :1] if reference else np.empty((SAMPLES, 0))
            rows = enumerate(np.hstack([samples, current]).tolist(), start=window * SAMPLES)
            writer.writerows([chip, *row] for chip, row in rows)
    assert main(["separate", "--site", str(path), str(table), "--fields", str(fields), "--json"]) == 0
    first = json.loads(capsys.readouterr().out.splitlines()[0])
    turned = np.exp(1j * np.array([entry["phase_rad"] for entry in first["fields"]]))
    np.testing.assert_allclose(turned, np.exp(1j * phases), atol=0.05)
    assert main(["locate", "--site", str(path), str(fields), "--json"]) == 0
    poses = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [pose["status"] for pose in poses] == ["ok"] * 3
    for pose in poses:
        assert np.linalg.norm(pose["position_m"] - position) < 2e-3


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('phase = "unknown"', 'phase = "maybe"'), 'phase is "maybe"; phases are known or unknown'),
        (('phase = "unknown"', 'phase = "known"'), 'samples is for tones with phase = "unknown"'),
        (("samples = 960", "samples = 960\ndegree = 10"), "samples and degree are both given"),
        (("samples = 960", "samples = 7"), "samples is 7; a window has 8 to 200000 samples"),
        (("samples = 960", 'samples = 960\ntone = "square"'), 'tone is "square", but only sines have one phase'),
        (("frequency_Hz = 1012.3", "frequency_Hz = 4800.0"), "frequency_Hz is 4800; it is below 4800 Hz"),
        (("frequency_Hz = 1012.3", 'frequency_Hz = 1012.3\nwave = "sine"'), "wave is of no use"),
        (('access = "fdma"\nphase = "unknown"', 'access = "cdma"'), 'samples belongs to access = "fdma"'),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, change, words):
    path = tmp_path / "site.toml"
    path.write_text(site_text(count=1).replace(*change))
    with pytest.raises(UserError) as caught:
        load(path)
    assert words in str(caught.value)


def test_tones_too_near_to_each_other_are_named(site):
    near = site(count=2)
    object.__setattr__(near.beacons[1].drive, "frequency_Hz", FREQUENCIES[0])
    with pytest.raises(UserError, match='"b0" and "b1" cannot be told apart'):
        ToneAccess(near)
