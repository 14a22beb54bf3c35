"""One interface for all ways to tell beacons apart, against drives written down here and NumPy's least squares."""

import csv
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goldfield.access import Separator, SiteAccess, TemplateAccess
from goldfield.access.nuisance import Nuisance, constant
from goldfield.access.waveform import code_template
from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.locate import locate
from goldfield.site import Beacon, SensorSite, Site, load
from goldfield.site.drive import NO_CODE, NOTHING_ELSE, Code, Drive
from goldfield.types import Fields, Status
from tests.host.fake_sensor import ATTITUDE, CHIPS, EARTH_T, POSITION_M, SITE, beacon_fields, gold_chips

N = 1023
CHIP_S = 1e-4
NOISE_T = 2e-7


def site_of(drives, access="cdma", slots=0, codes=None, degree=10):
    """A site of like coils with these drives."""
    place, axis = np.zeros(3), np.array([0.0, 0.0, 1.0])
    codes = codes or [NO_CODE] * len(drives)
    beacons = [
        Beacon(f"b{index + 1}", place, axis, 19.0, 0.149, None, 10.0, code, drive)
        for index, (drive, code) in enumerate(zip(drives, codes, strict=True))
    ]
    return Site("trial", CHIP_S, degree, None, SensorSite(NOISE_T), tuple(beacons), access, slots)


def short_code(code, degree=5):
    """A code of degree 5 by two shift registers, stage by stage."""

    def register(taps):
        stages, out = [1] * degree, []
        for _ in range(2**degree - 1):
            out.append(stages[-1])
            stages = [sum(stages[tap - 1] for tap in taps) % 2, *stages[:-1]]
        return np.array(out)

    u, v = register((2, 5)), register((2, 3, 4, 5))
    return 1 - 2 * (u ^ v[(np.arange(31) + code) % 31])


def slots_of(count, slots):
    drives = np.zeros((N, count))
    for slot in range(count):
        drives[slot * (N // slots) : (slot + 1) * (N // slots), slot] = 1.0
    return drives


def tones_of(periods):
    return np.array([[np.cos(2.0 * np.pi * k * t / N) for k in periods] for t in range(N)])


PERIODS = [1, 2, 3, 4, 5, 7, 8, 9]
SUPERPOSED = [
    Drive(codes=(Code(2, 10), Code(3, 10))),
    Drive(codes=(Code(4, 10), Code(1, 5, hold=11), Code(2, 5, offset=4))),
    Drive(codes=(Code(2, 10, offset=2),)),
    Drive(codes=(Code(2, 10, offset=500),)),
]
WAYS = {
    "cdma": (site_of([NOTHING_ELSE] * 8, codes=range(2, 10)), CHIPS),
    "tdma": (site_of([Drive(slot=k) for k in range(8)], "tdma", 9), slots_of(8, 9)),
    "fdma": (site_of([Drive(periods=k) for k in PERIODS], "fdma"), tones_of(PERIODS)),
    "rotating": (
        site_of([Drive(periods=k, wave=wave) for k in PERIODS[:4] for wave in ("cosine", "sine")], "fdma"),
        np.stack([wave(2.0 * np.pi * k * np.arange(N) / N) for k in PERIODS[:4] for wave in (np.cos, np.sin)], axis=1),
    ),
    "superposed": (
        site_of(SUPERPOSED),
        np.stack(
            [
                (gold_chips(2) + gold_chips(3)) / 2,
                (gold_chips(4) + np.tile(np.repeat(short_code(1), 11), 3) + np.tile(np.roll(short_code(2), -4), 33))
                / 3,
                np.roll(gold_chips(2), -2),
                np.roll(gold_chips(2), -500),
            ],
            axis=1,
        ),
    ),
}


@pytest.fixture(params=WAYS)
def way(request):
    return WAYS[request.param]


def test_fields_offset_and_covariance_against_least_squares(way):
    site, drives = way
    rng = np.random.default_rng(3)
    samples = (
        drives @ rng.normal(scale=1e-6, size=(drives.shape[1], 3)) + EARTH_T + rng.normal(scale=NOISE_T, size=(N, 3))
    )
    columns = np.hstack([drives, np.ones((N, 1))])
    truth = np.linalg.lstsq(columns, samples, rcond=None)[0]
    access = SiteAccess(site)
    separation = access.from_samples(samples)
    np.testing.assert_allclose(separation.field_T, truth[:-1], atol=1e-18, rtol=1e-9)
    np.testing.assert_allclose(separation.offset_T, truth[-1], rtol=1e-9)
    covariance = np.linalg.inv(columns.T @ columns)[:-1, :-1] * NOISE_T**2
    np.testing.assert_allclose(access.covariance_T2, covariance, rtol=1e-9, atol=1e-12 * covariance.max())
    np.testing.assert_allclose(separation.sigma_T, np.sqrt(np.diag(covariance)), rtol=1e-9)


def test_an_offset_of_the_drive_is_no_beacons_field(way):
    site, drives = way
    fields = np.arange(3.0 * drives.shape[1]).reshape(-1, 3) * 1e-7
    separation = SiteAccess(site).from_samples((drives + 0.7) @ fields + EARTH_T)
    np.testing.assert_allclose(separation.field_T, fields, atol=1e-15)
    np.testing.assert_allclose(separation.offset_T, EARTH_T + 0.7 * fields.sum(axis=0), rtol=1e-9)


def test_missing_samples_cost_only_what_they_hold(way):
    site, drives = way
    fields = np.arange(3.0 * drives.shape[1]).reshape(-1, 3) * 1e-7
    samples = drives @ fields + EARTH_T
    samples[np.random.default_rng(4).choice(N, 300, replace=False), 1] = np.nan
    samples[:, 2] = np.nan
    separation = SiteAccess(site).from_samples(samples)
    np.testing.assert_allclose(separation.field_T[:, :2], fields[:, :2], atol=1e-14)
    assert np.isnan(separation.field_T[:, 2]).all()
    assert (separation.sigma_T > np.sqrt(np.diag(SiteAccess(site).covariance_T2))).all()


def test_a_missing_slot_costs_one_beacon():
    site, drives = WAYS["tdma"]
    fields = np.arange(24.0).reshape(8, 3) * 1e-7
    samples = drives @ fields + EARTH_T
    samples[drives[:, 3] == 1.0] = np.nan
    separation = SiteAccess(site).from_samples(samples)
    np.testing.assert_allclose(np.delete(separation.field_T, 3, axis=0), np.delete(fields, 3, axis=0), atol=1e-15)
    assert np.isnan(separation.field_T[3]).all()
    assert np.isinf(separation.sigma_T).tolist() == [index == 3 for index in range(8)]


def test_plain_codes_are_separated_as_by_the_sensors_sums():
    site, drives = WAYS["cdma"]
    samples = drives @ beacon_fields() + EARTH_T + np.random.default_rng(6).normal(scale=NOISE_T, size=(N, 3))
    by_templates = SiteAccess(site).from_samples(samples)
    by_sums = Separator(10, site.codes, NOISE_T).from_correlations(
        CHIPS.T @ samples / N, samples.mean(axis=0), np.zeros(8)
    )
    np.testing.assert_allclose(by_templates.field_T, by_sums.field_T, atol=1e-16)
    np.testing.assert_allclose(by_templates.sigma_T, by_sums.sigma_T, rtol=1e-9)


@pytest.mark.parametrize("name", ["cdma", "tdma", "fdma"])
def test_location_does_not_care(name):
    """The same coils, told apart in three ways: the same pose."""
    site, drives = WAYS[name]
    separation = SiteAccess(site).from_samples(drives @ beacon_fields() + EARTH_T)
    fields = Fields(0, 0.0, tuple(f"b{i}" for i in range(1, 9)), separation.field_T, separation.sigma_T)
    pose = locate(load(SITE), fields)
    assert pose.status == Status.OK
    np.testing.assert_allclose(pose.position_m, POSITION_M, atol=1e-6)
    assert abs(np.dot(pose.orientation_xyzw, ATTITUDE.as_quat())) == pytest.approx(1.0, abs=1e-9)


def test_a_code_that_does_not_fit_begins_anew_with_every_cycle():
    expected = np.concatenate([np.repeat(short_code(1), 2)] * 17)[:N]
    np.testing.assert_array_equal(code_template(N, [Code(1, 5, hold=2)]), expected)


def test_without_a_quiet_slot_the_ambient_field_stays_in():
    site = site_of([Drive(slot=k) for k in range(11)], "tdma", 11)
    access = SiteAccess(site)
    separation = access.from_samples(slots_of(11, 11) @ np.ones((11, 3)) * 1e-6 + EARTH_T)
    assert not access.has_offset
    np.testing.assert_allclose(separation.field_T, np.tile(EARTH_T + 1e-6, (11, 1)), rtol=1e-12)
    assert np.isnan(separation.offset_T).all()


CONFLICTS = [
    (
        site_of([Drive(codes=(Code(2, 10, 5),)), NOTHING_ELSE, Drive(codes=(Code(2, 10, 5),))], codes=[-1, 2, -1]),
        "b1 b3",
    ),
    (site_of([Drive(slot=0), Drive(slot=4), Drive(slot=4), Drive(slot=1)], "tdma", 9), "b2 b3"),
    (site_of([Drive(periods=3), Drive(periods=2), Drive(periods=3)], "fdma"), "b1 b3"),
    (site_of([NOTHING_ELSE, Drive(codes=(Code(4, 10), Code(4, 10))), NOTHING_ELSE], codes=[3, -1, 4]), "b2 b3"),
    # Three beacons of which none equals another: (c2 + c3) / 2 is the mean of c2 and c3.
    (site_of([Drive(codes=(Code(2, 10), Code(3, 10))), NOTHING_ELSE, NOTHING_ELSE], codes=[-1, 2, 3]), "b1 b2 b3"),
]


@pytest.mark.parametrize(("site", "names"), CONFLICTS, ids=[names for _, names in CONFLICTS])
def test_the_beacons_in_conflict_are_named(site, names):
    with pytest.raises(UserError, match="cannot be told apart in a cycle of 1023 chips") as caught:
        SiteAccess(site)
    assert [word for word in str(caught.value).replace(",", "").split() if word.startswith('"')] == [
        f'"{name}"' for name in names.split()
    ]


def test_conflicts_with_what_is_no_beacon():
    with pytest.raises(UserError, match='"flat" and a constant field cannot'):
        TemplateAccess(["flat"], np.full((31, 1), 0.5), [constant(31)], 1.0)
    with pytest.raises(UserError, match='"dead" cannot be measured'):
        TemplateAccess(["dead"], np.zeros((31, 1)), [constant(31)], 1.0)
    dependent = Nuisance("a pair", np.tile(np.arange(31.0)[:, None], (1, 2)))
    lone = TemplateAccess(["good"], short_code(3)[:, None].astype(float), [constant(31), dependent], 1.0)
    np.testing.assert_allclose(lone.from_samples(short_code(3)[:, None] * np.ones(3)).field_T, 1.0)


@settings(max_examples=25)
@given(st.lists(st.tuples(st.integers(0, 32), st.integers(0, 30)), min_size=1, max_size=29, unique=True))
def test_separable_if_and_only_if_numpy_finds_full_rank(assignment):
    """Shared codes at any offsets: the check agrees with the rank by singular values."""
    drives = [Drive(codes=(Code(code, 5, offset=offset),)) for code, offset in assignment]
    site = site_of(drives, degree=5)
    columns = np.stack([code_template(31, drive.codes) for drive in drives] + [np.ones(31)], axis=1)
    if np.linalg.matrix_rank(columns) == columns.shape[1]:
        separation = SiteAccess(site).from_samples(columns @ np.ones((columns.shape[1], 3)))
        np.testing.assert_allclose(separation.field_T, 1.0, atol=1e-6)
    else:
        with pytest.raises(UserError, match="cannot be told apart"):
            SiteAccess(site)


def test_the_command_separates_time_slots(tmp_path, capsys):
    table, site = tmp_path / "samples.csv", tmp_path / "site.toml"
    text = SITE.read_text().replace("degree = 10", 'degree = 10\naccess = "tdma"\nslots = {slots}')
    for slot in range(8):
        text = text.replace(f"code = {slot + 2}\n", f"slot = {slot}\n")
    with table.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["chip", "bx_T", "by_T", "bz_T"])
        rows.writerows([t, *row] for t, row in enumerate(slots_of(8, 9) @ beacon_fields() + EARTH_T))
    site.write_text(text.replace("{slots}", "9"))
    assert main(["separate", "--site", str(site), str(table), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert sorted(record) == ["cycle", "fields", "offset_T"]
    np.testing.assert_allclose([field["b_T"] for field in record["fields"]], beacon_fields(), atol=1e-15)
    np.testing.assert_allclose(record["offset_T"], EARTH_T, atol=1e-15)
    site.write_text(text.replace("{slots}", "9").replace("slot = 7", "slot = 6"))
    assert main(["separate", "--site", str(site), str(table)]) == 2
    assert 'site.toml: the fields of the beacons "b7" and "b8" cannot be told apart' in capsys.readouterr().err
