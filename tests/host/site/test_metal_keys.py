"""The keys of a site file that tell of metal."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import goldfield
from goldfield.errors import UserError

SITE = """
[site]
name = "hall"
chip_period_s = 0.003
degree = 5

[sensor]
noise_T = 2e-8
{metal}
[[beacon]]
id = "b1"
position_m = [0, 0, 2]
axis = [0, 0, 1]
turns = 20
radius_m = 0.15
current_A = 10
code = 2
{beacon}
"""

METAL = """
[metal]
degree = 1
centre_m = [1, 2, 3]
radius_m = 2.5
sd_T_A = 3e-10
walked_m = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]

[[metal.body]]
position_m = [4, 0, 1]
polarisability_A_m2_T = [1, 2, 3, 0.1, 0.2, 0.3]
"""


def _load(folder: Path, metal: str = METAL, beacon: str = "metal_T_A = [1e-9, 2e-9, 3e-9]") -> goldfield.Site:
    path = folder / "hall.toml"
    path.write_text(SITE.format(metal=metal, beacon=beacon))
    return goldfield.load_site(path)


def test_everything_is_read(tmp_path: Path) -> None:
    site = _load(tmp_path)
    metal, of_beacon = site.metal, site.beacons[0].metal
    assert metal is not None
    assert of_beacon is not None
    assert of_beacon.metal is metal
    assert of_beacon.harmonics_T_A.tolist() == [1e-9, 2e-9, 3e-9]
    assert metal.centre_m.tolist() == [1.0, 2.0, 3.0]
    assert (metal.radius_m, metal.degree, metal.sd_T_A, len(metal.walked_m)) == (2.5, 1, 3e-10, 4)
    assert metal.body_m.tolist() == [[4.0, 0.0, 1.0]]
    assert metal.polarisability_A_m2_T.tolist() == [[[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]]]
    assert site.beacons[0].unknown_T == pytest.approx(3e-9)


def test_without_metal_there_is_none(tmp_path: Path) -> None:
    site = _load(tmp_path, "", "")
    assert site.metal is None
    assert site.beacons[0].metal is None
    assert site.beacons[0].unknown_T == 0.0


def test_bodies_alone_need_no_coefficients(tmp_path: Path) -> None:
    site = _load(tmp_path, METAL.replace("degree = 1\n", ""), "")
    assert site.beacons[0].metal is not None
    assert site.beacons[0].metal.harmonics_T_A.shape == (0,)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("degree = 1", "degree = 6", r"\[metal\]: degree is 6: it must be 0 to 5"),
        ("degree = 1", "degree = 2", r"metal_T_A has 3 coefficients: \[metal\] degree = 2 needs 8"),
        ("sd_T_A = 3e-10", "sd_T_A = -3e-10", "sd_T_A is -3e-10: a standard deviation is 0 or more"),
        (", [0, 0, 1]]", "]", "walked_m enclose no room"),
        ("[0, 0, 1]]\n", "[1, 1, 0]]\n", "walked_m enclose no room"),
        ("radius_m = 2.5\nsd", "sd", "radius_m is missing"),
        ("[1, 2, 3, 0.1, 0.2, 0.3]", "[1, 2, 3]", "polarisability_A_m2_T has 3 numbers: it needs six"),
        ("sd_T_A = 3e-10", "sd = 3e-10", "sd"),
    ],
)
def test_mistakes_are_told_with_their_place(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in METAL
    with pytest.raises(UserError, match=words) as refused:
        _load(tmp_path, METAL.replace(old, new))
    assert "hall.toml" in str(refused.value)


def test_coefficients_need_their_table(tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"metal_T_A needs a table \[metal\]"):
        _load(tmp_path, "")


SQUARE = "points_m = [[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]]"


@pytest.mark.parametrize(
    ("coil", "place", "words"),
    [
        ("radius_m = 0.15", "[0.15, 0, 2]", "the wire of a beacon's coil"),
        ("radius_m = 0.15", "[0, -0.1509, 2]", "the wire"),
        ("radius_m = 0.15", "[0, -0.1511, 2]", ""),
        ("radius_m = 0.15", "[0, 0, 2.0009]", "the centre of a beacon's coil"),
        (SQUARE, "[0.3, -1, 2.0009]", "the wire"),
        (SQUARE, "[-1, 0.3, 2]", "the wire"),  # of the segment that closes it
        (SQUARE, "[0.3, -1, 2.0011]", ""),
    ],
)
def test_no_body_is_in_a_coil(tmp_path: Path, coil: str, place: str, words: str) -> None:
    metal = METAL.replace("position_m = [4, 0, 1]", f"position_m = {place}")
    path = tmp_path / "site.toml"
    text = SITE.format(metal=metal, beacon="metal_T_A = [1, 2, 3]").replace("radius_m = 0.15", coil)
    path.write_text(text.replace("position_m = [0, 0, 2]\naxis = [0, 0, 1]\n", "") if coil == SQUARE else text)
    if not words:
        goldfield.load_site(path)
        return
    with pytest.raises(UserError, match=words):
        goldfield.load_site(path)


def test_nine_bodies_are_too_many(tmp_path: Path) -> None:
    body = METAL[METAL.index("[[metal.body]]") :]
    with pytest.raises(UserError, match="stands 9 times: at most 8"):
        _load(tmp_path, METAL + 8 * body)
    assert len(_load(tmp_path, METAL + 7 * body).metal.body_m) == 8  # type: ignore[union-attr]


def test_numbers_must_be_finite(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="metal_T_A"):
        _load(tmp_path, METAL, "metal_T_A = [1e-9, nan, 0]")
    assert np.isfinite(_load(tmp_path).beacons[0].metal.harmonics_T_A).all()  # type: ignore[union-attr]
