"""The site file of dual-axis beacons: what it says, and a sentence with file, line and key for what is wrong."""

import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield.site import rotating as rotating_site

GOOD = """[sensor]
noise_T = 3e-9

[[beacon]]
id = "a"
position_m = [0, 0, 0]
turns = 55
radius_m = 0.23
current_A = 8
frequency_Hz = 25

[[beacon]]
id = "b"
position_m = [6, 0, 0]
x_axis = [0, 2, 0]
y_axis = [-1, 0.01, 0]
turns = 55
radius_m = 0.23
current_A = 8
frequency_Hz = 20
"""


def load(tmp_path, text):
    path = tmp_path / "room.toml"
    path.write_text(text)
    return rotating_site.load(path)


def test_a_good_file_is_read(tmp_path):
    site = load(tmp_path, GOOD)
    assert (site.noise_T, site.frequency_Hz, [b.id for b in site.beacons]) == (3e-9, (25.0, 20.0), ["a", "b"])
    np.testing.assert_allclose(site.beacons[1].frame, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(site.up, [0, 0, 1])
    assert site.strength_T_m3[0] == pytest.approx(1e-7 * 55 * 8 * np.pi * 0.23**2, rel=1e-6)
    assert [coil.axis.tolist() for coil in site.beacons[0].coils()] == [[1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("frequency_Hz = 20", "frequency_Hz = 25", r'room.toml:20: \[\[beacon\]\] 2: frequency_Hz is 25, as of "a"'),
        ('id = "b"', 'id = "a"', r'room.toml:13: \[\[beacon\]\] 2: id is "a", as of another'),
        ("radius_m = 0.23\n", "", r"\[\[beacon\]\] 1: radius_m is missing"),
        ("turns = 55\n", "turn = 55\n", 'turn is no known key; did you mean "turns"'),
        ("y_axis = [-1, 0.01, 0]", "y_axis = [-1, 1, 0]", "y_axis is not at right angles to x_axis"),
        ("y_axis = [-1, 0.01, 0]", "y_axis = [1, 0, 0]", "y_axis with x_axis puts the beacon's z"),
        ("current_A = 8", "current_A = 0", "current_A is 0; it must be greater than zero"),
        ("noise_T = 3e-9", "noise_T = ", "is no valid TOML"),
    ],
)
def test_a_wrong_file_is_told(tmp_path, old, new, message):
    text = GOOD.replace(old, new, 1)
    with pytest.raises(UserError, match=message):
        load(tmp_path, text)
