"""The site file: what it means, and one sentence for each thing that can be wrong with it."""

import math

import numpy as np
import pytest

from goldfield.cli import main
from goldfield.errors import UserError
from goldfield.site import SensorSite, Survey, load
from tests.host.fake_sensor import SITE

GOOD = """\
[site]
name = "room"
chip_period_s = 97.75e-6
degree = 10
half_space = { point = [0.0, 0.0, 2.7], normal = [0.0, 0.0, -2.0] }

[sensor]
noise_T = 2.0e-7

[[beacon]]
id = "a"
position_m = [0.0, 0.0, 0.0]
axis = [0.0, 3.0, 4.0]
turns = 19
radius_m = 0.149
current_A = 10.0
code = 2

[[beacon]]
id = "square"
points_m = [
    [1.0, 1.0, 0.0],
    [1.5, 1.0, 0.0],
    [1.5, 1.5, 0.0],
    [1.0, 1.5, 0.0],
]
current_A = 2.0
code = 1024
"""


def write(tmp_path, text):
    path = tmp_path / "site.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_site_as_it_is_meant(tmp_path):
    site = load(write(tmp_path, GOOD))
    assert (site.name, site.degree, site.chips, site.codes) == ("room", 10, 1023, (2, 1024))
    assert site.cycle_s == pytest.approx(0.09999825)
    assert site.half_space is not None
    assert site.half_space.contains(np.array([9.0, 9.0, 0.0]))
    assert not site.half_space.contains(np.array([0.0, 0.0, 2.8]))
    circle, square = site.beacons
    np.testing.assert_allclose(circle.axis, [0.0, 0.6, 0.8])
    np.testing.assert_allclose(circle.moment_A_m2, 19 * 10 * math.pi * 0.149**2 * np.array([0.0, 0.6, 0.8]))
    np.testing.assert_allclose(square.position_m, [1.25, 1.25, 0.0])
    np.testing.assert_allclose(square.axis, [0.0, 0.0, 1.0])
    np.testing.assert_allclose(square.moment_A_m2, [0.0, 0.0, 0.5])
    assert site.beacon("square") is square


def test_an_id_may_be_a_whole_number(tmp_path):
    numbered = load(write(tmp_path, GOOD.replace('id = "square"', "id = 7")))
    assert numbered.beacon("7").turns == load(write(tmp_path, GOOD)).beacon("square").turns
    with pytest.raises(UserError, match='id is "7", which beacon 1 already has'):
        load(write(tmp_path, GOOD.replace('id = "square"', "id = 7").replace('id = "a"', 'id = "7"')))
    for wrong in ("1.5", "true", '""'):
        with pytest.raises(UserError, match="id must be a text in quotes"):
            load(write(tmp_path, GOOD.replace('id = "square"', f"id = {wrong}")))


def test_codes_are_shared_only_where_the_site_says_so(tmp_path):
    twice = GOOD.replace("code = 1024", "code = 2")
    assert twice != GOOD
    with pytest.raises(UserError, match=r'code is 2, which beacon "a" already has: .*shared_codes = true'):
        load(write(tmp_path, twice))
    for told, shared in (("true", True), ("false", False)):
        text = GOOD.replace("[site]", f"[site]\nshared_codes = {told}")
        assert load(write(tmp_path, text)).shared_codes == shared
    shared = twice.replace("[site]", "[site]\nshared_codes = true")
    assert load(write(tmp_path, shared)).codes == (2, 2)
    with pytest.raises(UserError, match="whose tau_s is another"):
        load(write(tmp_path, shared.replace("code = 2", "code = 2\ntau_s = 1e-5", 1)))
    tones = GOOD.replace("[site]", '[site]\nshared_codes = true\naccess = "fdma"')
    tones = tones.replace("code = 2\n", "frequency_Hz = 1000.017\n").replace(
        "code = 1024\n", "frequency_Hz = 2000.035\n"
    )
    with pytest.raises(UserError, match='shared_codes is for access = "cdma"'):
        load(write(tmp_path, tones))


def test_a_silent_file_is_not_taken_for_exact(tmp_path):
    site = load(write(tmp_path, GOOD))
    assert [beacon.survey for beacon in site.beacons] == [Survey(0.003, 0.005, 0.003)] * 2
    assert (site.sensor.gain_sd, site.sensor.axis_sd_rad) == (0.003, 0.005)
    assert site.assumed == (
        "[survey] position_sd_m = 0.003",
        "[survey] axis_sd_rad = 0.005",
        "[survey] current_sd = 0.003",
        "[sensor] gain_sd = 0.003",
        "[sensor] axis_sd_rad = 0.005",
    )


def test_a_beacon_s_own_survey_counts_before_that_of_all_and_that_before_the_default(tmp_path):
    text = GOOD.replace("[sensor]", "[survey]\nposition_sd_m = 0.01\ncurrent_sd = 0\n\n[sensor]\ngain_sd = 0.02")
    text = text.replace("code = 2\n", "code = 2\nposition_sd_m = 0.0\naxis_sd_rad = 0.02\n")
    site = load(write(tmp_path, text))
    assert site.beacons[0].survey == Survey(0.0, 0.02, 0.0)
    assert site.beacons[1].survey == Survey(0.01, 0.005, 0.0)
    assert (site.sensor.gain_sd, site.sensor.axis_sd_rad) == (0.02, 0.005)
    assert site.assumed == ("[survey] axis_sd_rad = 0.005", "[sensor] axis_sd_rad = 0.005")
    every = text.replace("code = 1024", "code = 1024\naxis_sd_rad = 0.499").replace("gain_sd", "axis_sd_rad=0\ngain_sd")
    assert load(write(tmp_path, every)).assumed == ()


@pytest.mark.parametrize(("key", "limit"), [("position_sd_m", 1.0), ("axis_sd_rad", 0.5), ("current_sd", 0.5)])
def test_errors_of_the_survey_have_limits(tmp_path, key, limit):
    for place in ("[survey]\n{}\n\n[sensor]", "{}\n"):
        old = "[sensor]" if "[" in place else "code = 1024\n"
        for value in (0, float(np.nextafter(limit, 0.0))):
            text = GOOD.replace(old, (old if place == "{}\n" else "") + place.format(f"{key} = {value!r}"))
            assert getattr(load(write(tmp_path, text)).beacons[1].survey, key) == value
        for value in (-1e-9, limit):
            text = GOOD.replace(old, (old if place == "{}\n" else "") + place.format(f"{key} = {value!r}"))
            with pytest.raises(UserError, match=f"{key} is .* from 0 to below {limit:g}"):
                load(write(tmp_path, text))


def test_site_and_sensor_in_python_are_exact_unless_told():
    assert Survey() == Survey(0.0, 0.0, 0.0)
    sensor = SensorSite(1e-9)
    assert (sensor.gain_sd, sensor.axis_sd_rad) == (0.0, 0.0)


def test_what_is_assumed_is_said_once(tmp_path, capsys):
    table = tmp_path / "fields.csv"
    table.write_text("epoch,t_s,beacon,bx_T,by_T,bz_T\n1,0,a,1e-7,0,0\n2,0.1,a,1e-7,0,0\n")
    exact = "position_sd_m = 0\naxis_sd_rad = 0\ncurrent_sd = 0\n"
    silent = write(tmp_path, GOOD)
    assert main(["locate", "--site", str(silent), str(table)]) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "[survey] position_sd_m = 0.003, " in said
    text = GOOD.replace("[sensor]", f"[survey]\n{exact}[sensor]\ngain_sd = 0\naxis_sd_rad = 0")
    assert main(["locate", "--site", str(write(tmp_path, text)), str(table)]) == 0
    assert capsys.readouterr().err == ""


def test_the_patents_coil_has_the_moment_that_is_quoted():
    assert np.linalg.norm(load(SITE).beacons[0].moment_A_m2) == pytest.approx(13.3, abs=0.06)  # maths.md, 2


FIRST = "[[beacon]] 1"
BAD = [
    ("degree = 10", "degre = 10", "site.toml:4: [site]: degre is no known key", 'did you mean "degree"'),
    ("noise_T = 2.0e-7", "noise_t = 2.0e-7", "site.toml:8: [sensor]: noise_t", 'did you mean "noise_T"'),
    ("noise_T = 2.0e-7", "noise_T = 2e-7\nmodel_error = 0", "site.toml:9: [sensor]: model_error is no", "[survey]"),
    ("noise_T = 2.0e-7", "noise_T = 2e-7\ngain_sd = 0.5", "site.toml:9: [sensor]: gain_sd is 0.5", "below 0.5"),
    ("noise_T = 2.0e-7", "noise_T = 2e-7\ngain_sd = -0.1", "site.toml:9: [sensor]: gain_sd is -0.1", "from 0"),
    ("noise_T = 2.0e-7", "noise_T = 2e-7\nhum_T = 1e-4", "site.toml:9: [sensor]: hum_T is 0.0001", "below 0.0001 T"),
    ("noise_T = 2.0e-7", "noise_T = 2e-7\nhum_T = -1e-9", "site.toml:9: [sensor]: hum_T is -1e-09", "from 0"),
    ("noise_T = 2.0e-7", "noise_T = 2e-7\naxis_sd_rad = 0.5", "site.toml:9: [sensor]: axis_sd_rad", "below 0.5 rad"),
    ("[sensor]", "[survey]\nposition_sd = 0\n[sensor]", "site.toml:8: [survey]: position_sd is", '"position_sd_m"'),
    ("code = 2\n", "code = 2\ncurent_sd = 0\n", f"site.toml:18: {FIRST}: curent_sd", '"current_sd"'),
    ("code = 2\n", "code = 2\ncurrent_sd = 'x'\n", f"site.toml:18: {FIRST}: current_sd must be", "finite number"),
    ("radius_m = 0.149", "radius = 0.149", f"site.toml:15: {FIRST}: radius", 'did you mean "radius_m"'),
    ("[sensor]", "[sensors]", "site.toml:7: sensors is no known key", 'did you mean "sensor"'),
    ("point = [0.0, 0.0, 2.7]", "pont = [0.0, 0.0, 2.7]", "site.toml:5: [site.half_space]: pont", '"point"'),
    ("degree = 10", "degree = 8", "site.toml:4: [site]: degree is 8", "5, 6, 7, 9, 10, 11"),
    ("degree = 10", "degree = 10.0", "site.toml:4: [site]: degree must be a whole number", "10.0"),
    ("degree = 10", "", "[site]: degree is missing", "site.toml:1"),
    ("chip_period_s = 97.75e-6", "chip_period_s = 0", "site.toml:3: [site]: chip_period_s is 0", "greater than zero"),
    ("degree = 10", "degree = 10\nambient_gradient_T_m = 0", "site.toml:5: [site]: ambient_gradient_T_m", "than zero"),
    ("degree = 10", "degree = 10\nambient_gradient_T_m = 20", "site.toml:5: [site]: ambient_gradient_T_m", "2e-05 T/m"),
    ("chip_period_s = 97.75e-6", "chip_period_s = nan", "site.toml:3: [site]: chip_period_s", "finite"),
    ("chip_period_s = 97.75e-6", "chip_period_s = true", "site.toml:3: [site]: chip_period_s", "number"),
    ("chip_period_s = 97.75e-6", f"chip_period_s = 1{'0' * 400}", "site.toml:3: [site]: chip_period_s", "number"),
    ('name = "room"', "name = 3", "site.toml:2: [site]: name must be a text", "3"),
    ("normal = [0.0, 0.0, -2.0]", "normal = [0, 0, 0]", "site.toml:5: [site.half_space]: normal", "no direction"),
    ("axis = [0.0, 3.0, 4.0]", "axis = [0.0, 0.0, 0.0]", f"site.toml:13: {FIRST}: axis", "no direction"),
    ("axis = [0.0, 3.0, 4.0]", "axis = [0.0, 3.0]", f"site.toml:13: {FIRST}: axis must be three", "[0.0, 3.0]"),
    ("axis = [0.0, 3.0, 4.0]", 'axis = "up"', f"site.toml:13: {FIRST}: axis must be three", '"up"'),
    ("turns = 19", "turns = -19", f"site.toml:14: {FIRST}: turns is -19", "greater than zero"),
    ("radius_m = 0.149", "", f"site.toml:10: {FIRST}: radius_m or points_m", "exactly one"),
    ("current_A = 10.0", "current_A = 0.0", f"site.toml:16: {FIRST}: current_A is zero", "leave the beacon out"),
    ("code = 2\n", "code = 1025\n", f"site.toml:17: {FIRST}: code is 1025", "0 to 1024"),
    ("code = 2\n", "code = -1\n", f"site.toml:17: {FIRST}: code is -1", "0 to 1024"),
    ("code = 1024", "code = 2", "site.toml:28: [[beacon]] 2: code is 2", 'beacon "a"'),
    ('id = "square"', 'id = "a"', 'site.toml:20: [[beacon]] 2: id is "a"', "beacon 1"),
    (
        "    [1.5, 1.0, 0.0],\n    [1.5, 1.5, 0.0],\n",
        "",
        "site.toml:21: [[beacon]] 2: points_m encloses no area",
        "three",
    ),
    ("    [1.5, 1.0, 0.0],", "    [1.5, 1.0],", "site.toml:21: [[beacon]] 2: points_m must be a list", "points"),
    ("current_A = 2.0", "axis = [0, 0, -1]\ncurrent_A = 2.0", "site.toml:21: [[beacon]] 2: points_m run", "right-hand"),
    ("[sensor]", "[sensor", "site.toml: is no valid TOML", "line 7"),
]


@pytest.mark.parametrize(
    ("old", "new", "place", "advice"), BAD, ids=[new.strip() or f"no {old}" for old, new, *_ in BAD]
)
def test_each_error_is_one_sentence_that_says_where(tmp_path, capsys, old, new, place, advice):
    assert GOOD.count(old) >= 1
    path = write(tmp_path, GOOD.replace(old, new, 1))
    assert main(["separate", "--site", str(path), "unused.csv"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert place in message
    assert advice in message


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"  \n", "is empty"),
        (b"\xff\xfe\x00\x01", "is no text"),
        (b"[site]\nname = \x00", "is no text"),
        (b"x = " + b"[" * 100_000, "nested too deeply"),
        (b"x = 1", "x is no known key; the keys here are site, sensor, survey, metal, beacon"),
        (b"sit = 1", 'did you mean "site"'),
        (b"beacon = []", "site is missing"),
        (b"site = 3\nsensor = 4\nbeacon = 5", "site must be a table"),
    ],
)
def test_files_that_are_no_site(tmp_path, content, words):
    with pytest.raises(UserError, match=words):
        load(write(tmp_path, content))


def test_paths_that_are_no_file(tmp_path):
    with pytest.raises(UserError, match="there is no such site file"):
        load(tmp_path / "none.toml")
    with pytest.raises(UserError, match="is a directory"):
        load(tmp_path)
