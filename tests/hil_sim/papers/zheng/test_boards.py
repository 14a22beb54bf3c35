"""Boards that drive dual-axis beacons: from a site file of pairs and raw chips to poses, against magpylib's loops."""

import csv
import json

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.cli import main
from tests.host.site.dual_axis_site import (
    CHIP_S,
    CURRENT_A,
    EARTH_T,
    NOISE_T,
    PERIODS,
    PLACES,
    RADIUS_M,
    TURNS,
    N,
    coils,
    write,
)


def chips(position_m, rotation, seed=0, tau_chips=0.0):
    """One cycle of what a sensor at rest samples, shape (N, 3); the rise by summing the answers to earlier chips."""
    rng = np.random.default_rng(seed)
    total = np.tile(EARTH_T, (N, 1))
    for place, periods in zip(PLACES, PERIODS, strict=True):
        turn = 2.0 * np.pi * periods * np.arange(-100, N) / N
        for axis, wave in (("x", np.cos(turn)), ("y", np.sin(turn))):
            loop = magpylib.current.Circle(current=CURRENT_A * TURNS, diameter=2.0 * RADIUS_M, position=place)
            loop.rotate_from_angax(90, "y" if axis == "x" else "x", anchor=None)
            if axis == "y":
                loop.rotate_from_angax(180, "x", anchor=None)
            if tau_chips:
                kernel = np.exp(-np.arange(100) / tau_chips) * (1.0 - np.exp(-1.0 / tau_chips))
                wave = np.convolve(wave, kernel)[: len(turn)]
            total = total + wave[100:, None] * loop.getB(position_m)
    return total @ rotation.as_matrix() + NOISE_T * rng.standard_normal((N, 3))


def table(path, cycles, places=None):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["chip", "bx_T", "by_T", "bz_T"] + ([] if places is None else ["x_m", "y_m", "z_m"]))
        for index, cycle in enumerate(cycles):
            place = [] if places is None else list(places[index])
            writer.writerows([chip, *row, *place] for chip, row in enumerate(cycle.tolist()))
    return path


def lines(capsys, *arguments):
    assert main(list(map(str, arguments))) == 0
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


POSITION_M = np.array([2.9, 1.6, 0.7])
ATTITUDE = Rotation.from_rotvec([0.3, -0.8, 1.9])


def turned_deg(record):
    return np.degrees((Rotation.from_quat(record["orientation_xyzw"]) * ATTITUDE.inv()).magnitude())


@pytest.mark.parametrize(
    ("algorithm", "limit_m", "limit_deg"), [("ellipse", 0.01, 0.2), ("axes", 0.06, 1.0)], ids=["ellipse", "axes"]
)
def test_poses_from_raw_chips_without_a_map(tmp_path, capsys, algorithm, limit_m, limit_deg):
    site = write(tmp_path, coils())
    samples = table(
        tmp_path / "samples.csv", [chips(POSITION_M, ATTITUDE, seed) for seed in range(3)], places=[POSITION_M] * 3
    )
    command = ("paper", "zheng", "locate", samples, "--site", site, "--algorithm", algorithm, "--json")
    records = lines(capsys, *command)
    assert [record["window"] for record in records] == [0, 1, 2]
    assert max(record["error_m"] for record in records) < limit_m
    assert max(turned_deg(record) for record in records) < limit_deg
    by_fft = lines(capsys, *command, "--separation", "fft")
    np.testing.assert_allclose(by_fft[1]["position_m"], records[1]["position_m"], atol=1e-9)


def test_separate_and_locate_take_the_pairs_as_any_beacons(tmp_path, capsys):
    site, fields = write(tmp_path, coils()), tmp_path / "fields.csv"
    samples = table(tmp_path / "samples.csv", [chips(POSITION_M, ATTITUDE, 7)])
    (whole,) = lines(capsys, "paper", "zheng", "locate", samples, "--site", site, "--json")
    lines(capsys, "separate", "--site", site, samples, "--fields", fields, "--json")
    (pose,) = lines(capsys, "locate", "--site", site, fields, "--json")
    (tracked,) = lines(capsys, "locate", "--site", site, fields, "--json", "--track")
    for record, limit_m in ((pose, 2e-4), (tracked, 1e-3)):  # a tracker must allow for motion within the cycle
        assert record["status"] == "ok"
        np.testing.assert_allclose(record["position_m"], whole["position_m"], atol=limit_m)


def test_the_rise_of_the_coils_is_known(tmp_path, capsys):
    """Two chips of time constant turn a field of four periods by 3 degrees."""
    samples = table(tmp_path / "samples.csv", [chips(POSITION_M, ATTITUDE, tau_chips=2.0)], places=[POSITION_M])
    slow = [{**row, "keys": row["keys"] + f"\ntau_s = {2.0 * CHIP_S}"} for row in coils()]
    (known,) = lines(capsys, "paper", "zheng", "locate", samples, "--site", write(tmp_path, slow), "--json")
    assert known["error_m"] < 0.01
    assert turned_deg(known) < 0.2
    assert (
        main(["paper", "zheng", "locate", str(samples), "--site", str(tmp_path / "hall.toml"), "--separation", "fft"])
        == 2
    )
    assert "tau_s" in capsys.readouterr().err
    (ignored,) = lines(capsys, "paper", "zheng", "locate", samples, "--site", write(tmp_path, coils()), "--json")
    assert turned_deg(ignored) > 0.5


def test_under_the_ceiling_the_half_space_tells_the_side(tmp_path, capsys):
    below = POSITION_M * [1.0, 1.0, -1.0]
    samples = table(tmp_path / "samples.csv", [chips(below, ATTITUDE)], places=[below])
    site = write(tmp_path, coils(), "half_space = { point = [0, 0, 0], normal = [0.1, 0, -1] }")
    for algorithm, limit_m in (("ellipse", 0.01), ("axes", 0.06)):
        for separation in ("least-squares", "fft"):
            (record,) = lines(
                capsys, "paper", "zheng", "locate", samples, "--site", site, "--json",
                "--algorithm", algorithm, "--separation", separation,
            )  # fmt: skip
            assert record["error_m"] < limit_m
            assert turned_deg(record) < 1.0


def test_a_survey_with_boards(tmp_path, capsys):
    site, fingerprints = write(tmp_path, coils()), tmp_path / "map.csv"
    places = [(x, y, 0.5) for x in (2.0, 2.5, 3.0, 3.5) for y in (1.0, 1.5, 2.0)]
    level = Rotation.identity()
    twice = [place for place in places for _ in range(2)]
    survey = table(
        tmp_path / "survey.csv", [chips(np.array(place), level, seed) for seed, place in enumerate(twice)], twice
    )
    assert main(["paper", "zheng", "survey", str(survey), "--map", str(fingerprints), "--site", str(site)]) == 0
    assert "12 points, 3 beacons" in capsys.readouterr().out
    target = np.array([2.7, 1.6, 0.5])
    samples = table(tmp_path / "samples.csv", [chips(target, ATTITUDE)], places=[target])
    for algorithm, limit_m in (("lines", 0.2), ("regions", 0.2), ("nearest", 0.4), ("local", 0.1)):
        (record,) = lines(
            capsys, "paper", "zheng", "locate", samples, "--site", site, "--json",
            "--algorithm", algorithm, "--map", fingerprints,
        )  # fmt: skip
        assert record["error_m"] < limit_m


def test_a_cycle_that_cannot_be_located_is_a_line_too(tmp_path, capsys):
    site = write(tmp_path, coils())
    blind = chips(POSITION_M, ATTITUDE)
    blind[:, 1] = np.nan
    holes = chips(POSITION_M, ATTITUDE)
    holes[5:60, 0] = np.nan
    samples = table(tmp_path / "samples.csv", [blind, holes])
    samples.write_text(samples.read_text().replace("nan", ""))
    first, second = lines(capsys, "paper", "zheng", "locate", samples, "--site", site, "--json")
    assert first["position_m"] is None
    np.testing.assert_allclose(second["position_m"], POSITION_M, atol=0.01)
    assert main(["paper", "zheng", "locate", str(samples), "--site", str(site)]) == 0
    assert "not located" in capsys.readouterr().out


def test_other_sites_are_told(tmp_path, capsys):
    assert main(["paper", "zheng", "compare", "--site", str(write(tmp_path, coils()))]) == 2
    assert "is a site of boards" in capsys.readouterr().err
    missing = tmp_path / "none.toml"
    assert main(["paper", "zheng", "locate", "x.csv", "--site", str(missing)]) == 2
    assert "there is no such site file" in capsys.readouterr().err
