"""Dual-axis boards on the whole chain: planned sinusoids in two coils, raw chips of the sensor, poses at the bound."""

import csv
import json
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from goldfield.access import SiteAccess
from goldfield.access.waveform import site_templates
from goldfield.cli import main
from goldfield.link.chips import Calibration, ChipAssembler
from goldfield.site import load
from goldfield_protocol import FrameDecoder, decode
from hil_sim.bench import SimulatedBench
from hil_sim.scenario import SCENARIOS
from tests.hil.bound import bound_of_alike, check_at_the_bound

pytestmark = pytest.mark.slow  # on emulated boards: `make test-host-boards` runs it too

CYCLES = 20
"""Cycles that are judged: the soft start was over 1.1 s before the first of them."""

FAR = chi2.isf(1e-6, 3)
"""Square of an error over its own deviation that one of a million poses exceeds."""


@pytest.fixture(scope="module")
def recorded(rig_kind, tmp_path_factory):
    """The site file, a table of raw chips of a sensor at rest among the first three boards of zheng6, and the truth."""
    directory = tmp_path_factory.mktemp("zheng3")
    head, *beacons = (SCENARIOS / "zheng6.toml").read_text().split("[[beacon]]")
    scenario = directory / "zheng3.toml"
    scenario.write_text("[[beacon]]".join([head, *beacons[:3]]))
    bench = SimulatedBench(str(scenario), rig_kind, directory)
    try:
        already = len(bench.stream)
        bench.advance((CYCLES + 2) * bench.site.cycle_s)
        assembler, node = ChipAssembler(bench.site.chips), bench.scenario.sensor.node
        messages = [
            decode(frame.identifier, frame.data) for frame in FrameDecoder().feed(bytes(bench.stream[already:]))
        ]
        own = [message for message in messages if message is not None and message.node == node]
        cycles = [sums.copy() for message in own for sums in assembler.feed(message)]
        truth = bench.rig.truth()[-1]
    finally:
        bench.rig.close()
    whole = [sums for sums in cycles if np.isfinite(sums).all()][-CYCLES:]
    assert len(whole) == CYCLES
    calibration = Calibration(*bench.scenario.sensor.correction())
    samples = [calibration.field_T(sums) for sums in whole]
    table = directory / "samples.csv"
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["chip", "bx_T", "by_T", "bz_T", "x_m", "y_m", "z_m"])
        for cycle in samples:
            writer.writerows([chip, *row, *truth.position_m] for chip, row in enumerate(cycle.tolist()))
    site_file = directory / "site.toml"
    return load(site_file), site_file, table, samples, truth


def located(capsys, site_file, table, *options):
    assert main(["paper", "zheng", "locate", str(table), "--site", str(site_file), "--json", *options]) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def turn_rad(record, truth):
    """Attitude error as a rotation vector."""
    turn = Rotation.from_quat(record["orientation_xyzw"]) * Rotation.from_quat(truth.orientation_xyzw).inv()
    return turn.as_rotvec()


def sample_noise_T(site, samples):
    """What is left of the samples beside fields, a constant and the hum: noise of surroundings and converter."""
    mains = np.array([wave(1e2 * np.pi * k * site.chip_period_s * np.arange(site.chips))
                      for k in (1, 3) for wave in (np.sin, np.cos)]).T  # fmt: skip
    columns = np.hstack([site_templates(site), mains, np.ones((site.chips, 1))])
    rest = [cycle - columns @ np.linalg.lstsq(columns, cycle, rcond=None)[0] for cycle in samples]
    return float(np.std(rest))


def test_the_site_file_knows_the_noise(recorded):
    site, _, _, samples, _ = recorded
    assert sample_noise_T(site, samples) == pytest.approx(site.sensor.noise_T, rel=0.05)


def test_poses_are_at_the_bound(recorded, capsys):
    """That of sinusoids: the fields that they tell are as uncertain as those of codes times the root of two."""
    site, site_file, table, _, truth = recorded
    records = located(capsys, site_file, table)
    assert len(records) == CYCLES
    poses = [
        SimpleNamespace(epoch=0, position_m=np.array(one["position_m"]), orientation_xyzw=one["orientation_xyzw"])
        for one in records
    ]
    bound = bound_of_alike(site, truth, SiteAccess(site).covariance_T2)
    print(f"noise {site.sensor.noise_T * 1e9:.1f} nT a sample")
    check_at_the_bound(site, poses, {0: truth}, bound=bound)


def test_range_and_elevation_alone_and_the_paper_s_separation(recorded, capsys):
    _, site_file, table, _, truth = recorded
    for options in (("--algorithm", "axes"), ("--separation", "fft")):
        for record in located(capsys, site_file, table, *options):
            assert record["error_m"] < 0.04
            assert np.degrees(np.linalg.norm(turn_rad(record, truth))) < 0.5


def test_separate_and_locate_as_of_any_beacons(recorded, capsys, tmp_path):
    site, site_file, table, samples, truth = recorded
    fields = tmp_path / "fields.csv"
    assert main(["separate", "--site", str(site_file), str(table), "--fields", str(fields), "--json"]) == 0
    separated = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    weights = SiteAccess(site).weights
    first = np.array([entry["b_T"] for entry in separated[0]["fields"]])
    np.testing.assert_allclose(first, weights @ (samples[0] - samples[0].mean(axis=0)), atol=1e-13)
    for options in ((), ("--track",)):
        assert main(["locate", "--site", str(site_file), str(fields), "--json", *options]) == 0
        poses = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
        assert len(poses) == CYCLES
        for pose in poses:
            error_m, cov_m2 = np.array(pose["position_m"]) - truth.position_m, np.array(pose["position_cov_m2"])
            assert error_m @ np.linalg.solve(cov_m2, error_m) < FAR
            assert np.sqrt(np.trace(cov_m2)) < 0.006
