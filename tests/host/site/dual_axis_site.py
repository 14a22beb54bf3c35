"""A site file of boards that drive three dual-axis beacons, in the room of Zheng et al. 2022."""

import numpy as np

N = 1023
CHIP_S = 97.75e-6
NOISE_T = 3e-9
EARTH_T = np.array([2.0e-5, 0.0, -4.5e-5])
PLACES = ((0.0, 0.0, 0.0), (6.2, 0.54, 0.0), (3.2, 4.28, 0.0))
PERIODS = (3, 2, 4)
TURNS, RADIUS_M, CURRENT_A = 55, 0.23, 8.0

HEAD = f"""\
[site]
name = "hall"
chip_period_s = {CHIP_S}
degree = 10
access = "fdma"
{{site}}
[sensor]
noise_T = {NOISE_T}
gain_sd = 0.0
axis_sd_rad = 0.0

[survey]
position_sd_m = 0.0
axis_sd_rad = 0.0
current_sd = 0.0
"""
BEACON = """
[[beacon]]
id = "{id}"
position_m = {place}
axis = {axis}
turns = 55
radius_m = 0.23
current_A = {current}
frequency_Hz = {frequency}
{keys}
"""


def coils():
    """Keys of the six coils, the sine's negative current turned round twice."""
    for name, place, periods in zip("abc", PLACES, PERIODS, strict=True):
        frequency = periods / (N * CHIP_S)
        given = {"place": list(place), "frequency": repr(frequency)}
        yield {**given, "id": f"{name}.cos", "axis": [1, 0, 0], "current": 8.0, "keys": ""}
        yield {**given, "id": f"{name}.sin", "axis": [0, -2, 0], "current": -8.0, "keys": 'wave = "sine"'}


def write(tmp_path, rows, site=""):
    path = tmp_path / "hall.toml"
    path.write_text(HEAD.format(site=site) + "".join(BEACON.format(**row) for row in rows))
    return path
