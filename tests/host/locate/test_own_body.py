"""A sensor beside a metal ball whose field, in time, is the exact one: located with and without the correction."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield import site as sites
from goldfield.access import SiteAccess
from goldfield.access.eddy import eddy_frequencies, eddy_weights
from goldfield.access.rise import filtered
from goldfield.access.waveform import site_templates
from goldfield.cli import main
from goldfield.field import FieldModel
from goldfield.field.conductor import Material, body_file
from goldfield.locate import Locator
from goldfield.locate.own_body import OwnBody, locate_beside
from goldfield.sensor.fields_table import read_fields
from goldfield.types import Fields, Status
from hil_sim.world.sphere import Sphere
from tests.host.fake_sensor import gold_chips
from tests.host.locate.relaxing_sphere import added, answers, relaxations

SITE_FILE = Path(__file__).parent.parent / "prigge8_site.toml"
SITE = sites.load(SITE_FILE)
NOISE_T = 2e-8
EARTH_T = np.array([2.0e-5, 0.0, -4.5e-5])
CENTRE_M = np.array([0.02, 0.0, -0.2])
BALLS = {
    "copper": Sphere(CENTRE_M, 0.1, 59.9e6),
    "steel": Sphere(CENTRE_M, 0.1, 5e6, 100.0),
    "graphite": Sphere(CENTRE_M, 0.1, 1e5),
}


def site_of(tmp_path, access):
    """The site file of the cube with its beacons told apart in another way."""
    text = SITE_FILE.read_text()
    if access == "tones":
        text = text.replace("degree = 10\n", 'degree = 10\naccess = "fdma"\n')
        for row, periods in enumerate((1, 2, 3, 4, 6, 7, 8, 9)):
            text = text.replace(f"code = {row + 2}\n", f"frequency_Hz = {periods / SITE.cycle_s!r}\n")
    if access == "slots":
        text = text.replace("degree = 10\n", 'degree = 10\naccess = "tdma"\nslots = 9\n')
        for row in range(8):
            text = text.replace(f"code = {row + 2}\n", f"slot = {row}\n")
    path = tmp_path / "site.toml"
    path.write_text(text)
    return path


def drives_of(access):
    """What the beacons drive, written down anew, shape (1023, 8)."""
    chip = np.arange(1023)
    if access == "tones":
        return np.cos(2.0 * np.pi * np.outer(chip, (1, 2, 3, 4, 6, 7, 8, 9)) / 1023)
    if access == "slots":
        return (chip[:, None] // 113 == np.arange(8)).astype(float)
    return np.stack([gold_chips(beacon.code) for beacon in SITE.beacons], axis=1).astype(float)


def body_toml(tmp_path, ball):
    path = tmp_path / "body.toml"
    path.write_text(
        f'[[conductor]]\nshape = "ball"\ncentre_m = {ball.centre_m.tolist()}\nradius_m = {ball.radius_m}\n'
        f"conductivity_S_m = {ball.conductivity_S_m}\nrelative_permeability = {ball.relative_permeability}\n"
    )
    return path


def samples_of(ball, answer, drives, position, rotation, rng):
    """One cycle of samples: the beacons as exact loops, dipoles for the ball, its exact answer, the earth, noise."""
    model = FieldModel(SITE.beacons)
    total = drives @ (model.field(position) @ rotation) + EARTH_T @ rotation
    total += added(ball, answer, (model.centre_m - position) @ rotation, model.moment_A_m2 @ rotation)
    return total + NOISE_T * rng.standard_normal(total.shape)


@pytest.fixture(scope="module")
def copper():
    """The model of the copper ball among the coded beacons."""
    ball = BALLS["copper"]
    conductor = body_file.Conductor(Material(ball.conductivity_S_m), ball.centre_m, ball.radius_m, None, np.eye(3))
    return OwnBody(SITE, [conductor])


def test_the_sphere_in_time_is_the_sphere_at_any_frequency():
    """The truth of these tests against the series: order by order, from far below to far above its skin's frequency."""
    for ball in BALLS.values():
        frequencies = np.array([0.1, 3.0, 50.0, 300.0])
        for n in (1, 2, 4):
            tau, amplitude = relaxations(ball, n, 1e-5)
            x = 2j * np.pi * np.outer(frequencies, tau)
            summed = ball.susceptibilities(0.0, n)[n - 1] + (x / (1.0 + x)) @ amplitude
            series = [ball.susceptibilities(frequency, n)[n - 1] for frequency in frequencies]
            np.testing.assert_allclose(summed, series, atol=5e-3)


def relaxation_part(site, tau_chips):
    """Part of a relaxation of beacon i (columns) that is found in the field of beacon j (rows), shape (n, n)."""
    templates = site_templates(site)
    return SiteAccess(site).weights @ (templates - filtered(templates, tau_chips))


@pytest.mark.parametrize("access", ["codes", "tones", "slots"])
def test_parts_of_relaxations_are_composed_of_a_few_frequencies(tmp_path, access):
    site = sites.load(site_of(tmp_path, access))
    frequency_Hz = eddy_frequencies(site)
    weights = eddy_weights(site, frequency_Hz)
    for tau_chips in np.logspace(-2.0, 5.0, 15):
        x = 2.0 * np.pi * site.chip_period_s * tau_chips * frequency_Hz
        composed = (weights * ((x * x + 1j * x) / (1.0 + x * x))).sum(axis=2).real
        np.testing.assert_allclose(composed, relaxation_part(site, tau_chips), atol=0.006)


@pytest.mark.parametrize(
    ("metal", "access", "limit"),
    [("copper", "codes", 0.01), ("copper", "tones", 0.01), ("copper", "slots", 0.02), ("steel", "slots", 0.04)],
)
def test_what_the_body_adds_is_the_exact_field(tmp_path, metal, access, limit):
    site, ball, drives = sites.load(site_of(tmp_path, access)), BALLS[metal], drives_of(access)
    position, rotation = np.array([0.8, 1.2, 0.9]), Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    model = FieldModel(site.beacons)
    answer = answers(ball, drives, site.chip_period_s)
    samples = added(ball, answer, (model.centre_m - position) @ rotation, model.moment_A_m2 @ rotation)
    truth = SiteAccess(site).weights @ samples
    body = OwnBody(site, body_file.load(body_toml(tmp_path, ball)))
    error = np.linalg.norm(body.secondary(position, rotation) - truth, axis=1)
    assert (np.linalg.norm(truth, axis=1) > 0.03 * np.linalg.norm(model.field(position), axis=1)).all()
    assert (error < limit * np.linalg.norm(truth, axis=1)).all()


def test_from_samples_beside_a_ball_to_poses(tmp_path, capsys):
    ball, drives, rng = BALLS["copper"], drives_of("codes"), np.random.default_rng(7)
    middle = np.mean([beacon.position_m for beacon in SITE.beacons], axis=0)
    truth = [(middle + rng.uniform(-0.4, 0.4, 3), turn) for turn in Rotation.random(6, rng=rng)]
    table, fields = tmp_path / "samples.csv", tmp_path / "fields.csv"
    answer = answers(ball, drives, SITE.chip_period_s)
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["chip", "bx_T", "by_T", "bz_T"])
        for place, turn in truth:
            cycle = samples_of(ball, answer, drives, place, turn.as_matrix(), rng)
            writer.writerows([chip, *row] for chip, row in enumerate(cycle.tolist()))
    assert main(["separate", "--site", str(SITE_FILE), str(table), "--fields", str(fields), "--json"]) == 0
    capsys.readouterr()

    def located(*options):
        assert main(["locate", "--site", str(SITE_FILE), str(fields), "--json", *options]) == 0
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    without = [pose for pose in located() if pose["status"] == "ok" and not pose["excluded"]]
    assert not without  # at least integrity says so
    # As a locator that knows nothing of the body, all beacons trusted:
    trusting = Locator(SITE).fit_all(list(read_fields(SITE, str(fields))))
    errors = np.linalg.norm(trusting - [place for place, _ in truth], axis=1)
    assert errors.min() > 0.003
    assert np.median(errors) > 0.01
    for pose, (place, turn) in zip(located("--own-body", str(body_toml(tmp_path, ball))), truth, strict=True):
        assert np.linalg.norm(pose["position_m"] - place) < 0.001
        assert (Rotation.from_quat(pose["orientation_xyzw"]) * turn.inv()).magnitude() < 0.003


def test_a_failed_epoch_stays_failed(copper):
    fields = Fields(0, 0.0, ("nobody",), np.ones((1, 3)), np.ones(1))
    assert locate_beside(Locator(SITE), copper, fields).status is Status.FAILED


def test_a_turned_box_is_the_box_seen_from_a_turned_sensor():
    edges, centre = np.array([0.1, 0.2, 0.15]), np.array([0.05, -0.1, -0.3])
    turn = Rotation.from_rotvec([0.4, -0.7, 0.2]).as_matrix()
    copper = Material(59.9e6)
    straight = OwnBody(SITE, [body_file.Conductor(copper, centre, None, edges, np.eye(3))])
    turned = OwnBody(SITE, [body_file.Conductor(copper, turn @ centre, None, edges, turn)])
    position = np.array([1.0, 0.9, 0.8])
    seen = turned.secondary(position, turn.T)  # B_site = R B_sensor: the straight sensor's frame is the site's
    np.testing.assert_allclose(seen, straight.secondary(position, np.eye(3)) @ turn.T, atol=2e-3 * np.abs(seen).max())


BAD = [
    ("shape", 'shape = "cone"', "shape is", "ball and box"),
    ("radius_m", "edges_m = [1, 1, 1]", "edges_m is no known key", "relative_permeability, radius_m"),
    ("radius_m", "radius_m = 0.19", "centre_m puts the sensor", "a sixth"),
    ("conductivity_S_m", "conductivity_S_m = 0", "conductivity_S_m is 0", "greater than zero"),
    ("relative_permeability", "relative_permeability = 0.5", "relative_permeability is 0.5", "at least 1"),
    ("shape", 'shape = "box"\nedges_m = [0.1, 0.1, 0.5]', "radius_m is no known key", "edges_m"),
    ("radius_m", "", "radius_m is missing", ":1"),
]


@pytest.mark.parametrize(("key", "line", "complaint", "advice"), BAD, ids=[complaint for *_, complaint, _ in BAD])
def test_a_wrong_body_is_one_sentence(tmp_path, capsys, key, line, complaint, advice):
    path = body_toml(tmp_path, BALLS["copper"])
    path.write_text("\n".join(line if row.startswith(key) else row for row in path.read_text().splitlines()))
    told(capsys, path, complaint, advice)


def told(capsys, path, *words, options=()):
    assert main(["locate", "--site", str(SITE_FILE), "unused.csv", "--own-body", str(path), *options]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    for word in (path.name, *words) if not options else words:
        assert word in message


def test_what_the_model_does_not_hold_for_is_said(tmp_path, capsys):
    flat = tmp_path / "flat.toml"
    flat.write_text(
        '[[conductor]]\nshape = "box"\ncentre_m = [0, 0, -0.3]\nedges_m = [0.2, 0.2, 0.002]\nconductivity_S_m = 3e7\n'
    )
    told(capsys, flat, "flat or long box")
    soft = body_toml(tmp_path, Sphere(CENTRE_M, 0.01, 1e5, 50.0))
    told(capsys, soft, "permeable and only")
    told(capsys, soft, "--own-body and --track are both given", options=["--track"])
