"""Scenario files: what they mean, and what they say when they are wrong."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pytest

from goldfield import site as sites
from goldfield.access import SiteAccess
from goldfield.errors import UserError
from goldfield.site import rotating as rotating_site
from goldfield_protocol.parameters import parse_page
from hil_sim import scenario
from hil_sim.clib import ROOT
from hil_sim.world.motion import Line, Still, Waypoints
from tests.hil.from_the_box import hall
from tests.hil_sim.rig.fakes import small, write_scenario

COUNTS_PER_T = 2048 / 2e-4


@pytest.mark.parametrize("file", sorted(scenario.SCENARIOS.glob("*.toml")), ids=lambda file: file.stem)
def test_the_shipped_scenarios_load_and_give_a_site(file, tmp_path):
    loaded = scenario.load_scenario(file.stem)
    assert loaded.name == file.stem
    site = tmp_path / "site.toml"
    site.write_text(scenario.site_toml(loaded))
    read = sites.load(site)
    SiteAccess(read)  # raises if the beacons cannot be told apart
    if all(beacon.plain_code is not None for beacon in loaded.beacons):
        assert read.codes == tuple(beacon.code for beacon in loaded.beacons)
    # A beacon of two coils is two of the site's.
    pairs = [(beacon, coil) for beacon in loaded.beacons for coil in beacon.coils]
    for written, (beacon, coil) in zip(read.beacons, pairs, strict=True):
        np.testing.assert_array_equal(written.position_m, coil.position_m)
        np.testing.assert_array_equal(written.axis, coil.axis)
        assert written.id.partition(".")[0] == beacon.id
        assert written.current_A == beacon.circuit.current_A
        periods = beacon.periods if beacon.rotating_periods is None else beacon.rotating_periods
        assert (written.drive.slot, written.drive.periods) == (beacon.slot, periods)
        assert written.drive.codes == beacon.codes


def test_more_codes_than_a_list_holds(tmp_path):
    """From the first on that does not fit, the sensor chooses what it reports."""
    pages = []
    for beacons in (64, 65):
        path = tmp_path / "hall.toml"
        path.write_text(hall(beacons, sited=beacons))
        pages.append(parse_page(scenario.parameter_page(scenario.load_scenario(str(path)), 0)))
    listed, choosing = pages
    assert (listed["code_count"], listed["code_list"]) == (64, list(range(2, 66)))
    assert "strongest" not in listed
    assert (choosing["code_count"], choosing["strongest"]) == (0, 16)
    assert not choosing.get("code_list")
    path.write_text(path.read_text().replace("pose = 0", "pose = 1"))
    with pytest.raises(UserError, match="sensor does not fit the boards' parameters"):
        scenario.load_scenario(str(path))


def test_shared_codes_are_said_to_be_meant(tmp_path):
    path = tmp_path / "hall.toml"
    text = hall(6).replace("code = 7\n", "code = 2\n")
    path.write_text(text)
    with pytest.raises(UserError, match="take another, or set shared_codes = true"):
        scenario.load_scenario(str(path))
    shared = text.replace("seed =", "shared_codes = true\nseed =", 1)
    path.write_text(shared)
    loaded = scenario.load_scenario(str(path))
    page = parse_page(scenario.parameter_page(loaded, 0))
    assert (page["code_count"], page["strongest"]) == (0, 16)
    site = tmp_path / "site.toml"
    site.write_text(scenario.site_toml(loaded))
    assert [beacon.code for beacon in sites.load(site).beacons] == [2, 3, 4, 5, 6, 2]
    path.write_text(shared.replace("pose = 0", "pose = 1"))
    with pytest.raises(UserError, match="the board needs a code for each beacon: set pose = 0"):
        scenario.load_scenario(str(path))


def test_the_site_tells_of_a_hum_that_the_noise_does_not_hide(tmp_path):
    """Its peaks are 10, 20 and 10 nT on the axes, and 0.3 of that thrice as fast: 10.4 nT in the mean of all."""
    path, text = tmp_path / "hum.toml", scenario.find("prigge8").read_text()
    for noise_T, told in (("1.0e-7", 1.04e-8), ("1.1e-7", 0.0)):
        path.write_text(text.replace("noise_T = 2.0e-7", f"noise_T = {noise_T}"))
        (tmp_path / "site.toml").write_text(scenario.site_toml(scenario.load_scenario(str(path))))
        assert sites.load(tmp_path / "site.toml").sensor.hum_T == told


def test_boards_of_slots_and_tones(tmp_path):
    slot = parse_page(scenario.parameter_page(scenario.load_scenario("slots8"), 8))
    assert (slot["waveform"], slot["slots"], slot["slot"]) == (1, 9, 7)
    tone = parse_page(scenario.parameter_page(scenario.load_scenario("tones8"), 8))
    assert (tone["waveform"], tone["periods"]) == (2, 9)
    text = scenario.find("slots8").read_text()
    path = tmp_path / "wrong.toml"
    for old, new, words in (
        ("slot = 7", "slot = 9", "slot is 9; it must be below the scenario's slots"),
        ("slot = 7", "slot = 7\nperiods = 3", "slot and periods are both given: a beacon drives one of them"),
        ("slot = 7\n", "", "is driven otherwise than the first beacon"),
        ("slots = 9", "slots = 0", "slots is 0; it must lie in 1 to 1023"),
    ):
        path.write_text(text.replace(old, new))
        with pytest.raises(UserError, match=re.escape(words)):
            scenario.load(path)


def test_a_beacon_of_two_coils(tmp_path):
    loaded = scenario.load_scenario("zheng6")
    page = parse_page(scenario.parameter_page(loaded, 3))
    assert (page["waveform"], page["periods"], page["degree"], page["amplitude"]) == (3, 6, 11, 8.0)
    assert parse_page(scenario.parameter_page(loaded, 0))["degree"] == 11
    path = tmp_path / "site.toml"
    path.write_text(scenario.site_toml(loaded))
    site = sites.load(path)
    assert [beacon.id for beacon in site.beacons[4:6]] == ["m3.cos", "m3.sin"]
    assert [beacon.drive.wave for beacon in site.beacons[4:6]] == ["cosine", "sine"]
    assert [beacon.axis.tolist() for beacon in site.beacons[4:6]] == [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    assert site.chips == 2047
    # Turns of the paper's beacons, in a second: within 0.1 % of 25, 20, 30, 15, 10 and 5.
    turns = [beacon.drive.periods / site.cycle_s for beacon in site.beacons[::2]]
    np.testing.assert_allclose(turns, [25, 20, 30, 15, 10, 5], rtol=1e-3)
    paper = rotating_site.load(ROOT / "hil_sim/papers/zheng/data/zheng6.toml")
    for own, printed in zip(loaded.beacons, paper.beacons, strict=True):
        np.testing.assert_array_equal(own.geometry.position_m, printed.position_m)
        assert (own.geometry.turns, own.geometry.radius_m) == (printed.turns, printed.radius_m)
    # Grover's formula for the inductance, and copper's resistance, as the file says.
    inductance = 4e-7 * np.pi * 55**2 * 0.23 * (np.log(8 * 0.23 / 0.01) - 2)
    assert loaded.beacons[0].circuit.inductance_H == pytest.approx(inductance, rel=0.01)
    assert loaded.beacons[0].circuit.resistance_Ohm == pytest.approx(1.72e-8 * 55 * 2 * np.pi * 0.23 / 2e-6, rel=0.03)


def test_superposed_codes():
    loaded = scenario.load_scenario("superposed")
    page = parse_page(scenario.parameter_page(loaded, 3))
    assert page["waveform"] == 4
    assert page["codes"] == [10, 5, 0, 1, 5, 3, 20, 33]
    sensor = parse_page(scenario.parameter_page(loaded, 0))
    assert sensor["code_count"] == 0
    assert "code" not in page


@pytest.mark.parametrize(
    ("name", "old", "new", "words"),
    [
        ("zheng6", "second_axis = [0.0, 1.0, 0.0]", "", "second_axis and rotating_periods belong together: give both"),
        ("zheng6", "rotating_periods = 4", "code = 4", "second_axis and rotating_periods belong together: give both"),
        ("zheng6", "second_axis = [0.0, 1.0, 0.0]", "second_axis = [0.1, 1.0, 0.0]", "is not at right angles to axis"),
        ("zheng6", "rotating_periods = 6", "rotating_periods = 1024", "is 1024; it must lie in 1 to 1023"),
        ("zheng6", "degree = 11 ", "degree = 8 ", "degree is 8; codes exist for 5, 6, 7, 9, 10, 11"),
        ("zheng6", "pose = 0", "pose = 1", "pose is 1, but the board can tell apart plain codes alone: set pose = 0"),
        (
            "zheng6",
            "rotating_periods = 6",
            "rotating_periods = 6\nperiods = 1",
            "periods and rotating_periods are both",
        ),
        ("superposed", "{ code = 8 }", "{ code = 8, degree = 6 }", "lasts 63 chips: a cycle of 1023 is no multiple"),
        ("superposed", "hold = 11", "hold = 12", "has a code that lasts 372 chips: a cycle of 1023 is no multiple"),
        ("superposed", "{ code = 11 }, {", "{ code = 20 }, { code = 11 }, {", "lists 5 codes; a board superposes at"),
        ("superposed", "{ code = 8 }", "{ code = 1025 }", "code is 1025; codes of degree 10 are 0 to 1024"),
        ("superposed", "codes = [{ code = 8 }]", "", "code is missing; give one, or codes, slot, periods or rotating"),
    ],
)
def test_what_a_beacon_cannot_drive(tmp_path, name, old, new, words):
    text = scenario.find(name).read_text()
    assert old in text
    path = tmp_path / "wrong.toml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(UserError, match=re.escape(words)) as caught:
        scenario.load(path)
    assert "wrong.toml" in str(caught.value)


def test_the_committed_site_is_that_of_the_scenario():
    committed = (ROOT / "host" / "sites" / "prigge8.toml").read_text()
    assert committed.partition("\n")[2] == scenario.site_toml(scenario.load_scenario("prigge8"))


def test_parameter_pages(tmp_path):
    loaded = small(tmp_path)
    assert parse_page(scenario.parameter_page(loaded, 2)) == {"node": 2, "code": 3, "amplitude": 10.0, "sync_master": 0}
    assert parse_page(scenario.parameter_page(loaded, 1))["sync_master"] == 1
    sensor = parse_page(scenario.parameter_page(loaded, 0))
    assert (sensor["node"], sensor["code_count"], sensor["code_list"]) == (100, 3, [2, 3, 4])


@pytest.mark.parametrize("calibration", ["exact", "nominal"])
def test_calibration_undoes_the_front_end(tmp_path, calibration):
    errors = "2e-4\ngain_error = [0.01, -0.02, 0.015]\nmisalignment_rad = [0.01, -0.005, 0.008]\n"
    errors += "offset_T = [3e-6, -2e-6, 1e-6]"
    loaded = small(tmp_path, range_T=f'{errors}\ncalibration = "{calibration}"')
    page = parse_page(scenario.parameter_page(loaded, 0))
    field = np.array([2e-5, -3e-5, 4e-5])
    # Axes written out: x leans by .01 toward y and by -.005 toward z, y by .008 toward z.
    axes = [np.array([1, 0.01, -0.005]), np.array([0, 1, 0.008]), np.array([0, 0, 1.0])]
    sensed = [gain * (a @ field) / np.linalg.norm(a) for gain, a in zip([1.01, 0.98, 1.015], axes, strict=True)]
    counts = 2048 + np.add(sensed, [3e-6, -2e-6, 1e-6]) * COUNTS_PER_T
    zero = np.array([page["zero_x"], page["zero_y"], page["zero_z"]])
    error = np.array(page["calibration"]).reshape(3, 3) @ (counts - zero) - field
    assert np.abs(error).max() < 1e-10 if calibration == "exact" else np.abs(error).max() > 1e-6


def test_motions(tmp_path):
    assert isinstance(small(tmp_path).motion, Still)
    assert isinstance(small(tmp_path, kind='"line"\nvelocity_m_per_s = [1.0, 0.0, 0.0]').motion, Line)
    path = write_scenario(tmp_path)
    before, after = path.read_text().split("[motion]")
    table = """[motion]
kind = "waypoints"
times_s = [0.0, 1.0]
positions_m = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]]
rotation_vectors_rad = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
"""
    path.write_text(before + table + after[after.index("[coil]") :])
    assert isinstance(scenario.load(path).motion, Waypoints)


def test_a_beacon_overrides_the_coils_defaults_and_may_be_a_wire(tmp_path):
    text = "2\npoints_m = [[0, 0, 0], [0.3, 0, 0], [0.3, 0.2, 0], [0, 0.2, 0], [0, 0, 0]]\ncurrent_A = 5.0"
    path = write_scenario(tmp_path, code=text)
    loaded = scenario.load(path)
    wire, circle = loaded.beacons[0], loaded.beacons[1]
    assert (wire.circuit.current_A, circle.circuit.current_A) == (5.0, 10.0)
    assert wire.geometry.turns == 1.0
    assert circle.geometry.turns == 19.0
    np.testing.assert_allclose(wire.geometry.axis, [0, 0, 1])
    site = tomllib.loads(scenario.site_toml(loaded))
    assert site["beacon"][0]["points_m"][2] == [0.3, 0.2, 0.0]
    assert "radius_m" not in site["beacon"][0]


EVENTS = """
[[event]]
time_s = 2.0
moves = "b"
by_m = [0.01, 0.0, -0.02]

[[event]]
time_s = 3.0
sheet = { centre_m = [0.0, 0.0, -0.3], normal = [0.0, 0.0, 2.0], side_m = 0.5 }
"""


def eventful(directory, text=EVENTS):
    path = write_scenario(directory)
    path.write_text(path.read_text() + text)
    return scenario.load(path)


def test_events(tmp_path):
    loaded = eventful(tmp_path)
    assert loaded.at(1.99) is loaded
    moved = loaded.at(2.0)
    np.testing.assert_allclose(moved.beacons[1].geometry.position_m, [1.01, 0.0, -0.02])
    assert [moved.beacons[row] for row in (0, 2)] == [loaded.beacons[row] for row in (0, 2)]
    assert loaded.metal_at(2.99) == ()
    (sheet,) = loaded.metal_at(3.0)
    assert sheet.normal.tolist() == [0.0, 0.0, 1.0]
    assert scenario.site_toml(loaded) == scenario.site_toml(scenario.load(write_scenario(tmp_path)))


def test_a_bus_is_clean_unless_the_scenario_says_otherwise(tmp_path):
    assert scenario.load(write_scenario(tmp_path)).can == scenario.CanBus()
    loaded = eventful(tmp_path, "[can]\nbit_error_probability = 1e-5\ndelay_s = 2e-7\n")
    assert (loaded.can.bit_error_probability, loaded.can.delay_s) == (1e-5, 2e-7)


def test_the_bench_has_the_rates_of_its_links_and_its_boards_have_them_in_their_pages(tmp_path):
    plain = scenario.load(write_scenario(tmp_path))
    assert plain.links == scenario.Links(1_000_000, 2_000_000)
    loaded = eventful(tmp_path, "[links]\ncan_bit_s = 125000\nserial_baud = 460800\n")
    assert loaded.links == scenario.Links(125_000, 460_800)
    for board in range(4):
        page = parse_page(scenario.parameter_page(loaded, board))
        assert (page["can_rate"], page["serial_rate"]) == (3, 2)
        assert not {"can_rate", "serial_rate"} & {*parse_page(scenario.parameter_page(plain, board))}


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("can_bit_s = 800000", "[links]: can_bit_s is 800000; the boards do 1000000, 500000, 250000, 125000"),
        ("serial_baud = 9600", "[links]: serial_baud is 9600; the boards do 2000000, 921600, 460800, 115200"),
        ("baud = 9600", "[links]: baud is no known key"),
    ],
)
def test_what_is_wrong_with_the_links(tmp_path, keys, words):
    with pytest.raises(UserError, match=re.escape(words)):
        eventful(tmp_path, f"[links]\n{keys}\n")


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ("bit_error_probability = 1.0", "[can]: bit_error_probability is 1; it must be below 1"),
        ("bit_error_probability = -0.1", "[can]: bit_error_probability is -0.1; it must not be negative"),
        ("delay_s = 1.1e-6", "[can]: delay_s is 1.1e-06; it must not be above 1e-06, a bit"),
        ("errors = 3", "[can]: errors is no known key"),
    ],
)
def test_what_is_wrong_with_a_bus(tmp_path, keys, words):
    with pytest.raises(UserError, match=re.escape(words)):
        eventful(tmp_path, f"[can]\n{keys}\n")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('moves = "b"', 'moves = "d"', '[[event]] 1: moves is "d"; the beacons are a, b, c'),
        ('moves = "b"\n', "", "[[event]] 1: moves is missing; give it, or sheet, beacon, sensor_fault or ambient"),
        ('moves = "b"\n', 'beacon = "d"\n', '[[event]] 1: beacon is "d"; the beacons are a, b, c'),
        ('moves = "b"\n', 'beacon = "b"\n', "[[event]] 1: fault is missing; give it, or supply_V, or"),
        ('moves = "b"\n', 'beacon = "b"\nfault = "rain"\n', '[[event]] 1: fault is "rain"; there are coil_open'),
        ('moves = "b"\n', 'beacon = "b"\nsupply_V = -1\n', "[[event]] 1: by_m is no known key"),
        (
            'moves = "b"\nby_m',
            'beacon = "b"\nprocessor_supply_V = 4.1\n#',
            "[[event]] 1: processor_supply_V is 4.1; it must lie in 0 to 4",
        ),
        ("time_s = 2.0", "time_s = -2.0", "[[event]] 1: time_s is -2; it must not be negative"),
        ("time_s = 3.0", 'time_s = 3.0\nmoves = "b"', "[[event]] 2: sheet and moves are both given"),
        ("time_s = 3.0", "time_s = 3.0\nby_m = [0, 0, 1]", "[[event]] 2: by_m is no known key"),
        ("side_m = 0.5", "side_m = 0.0", "[[event]] 2: sheet: side_m is 0; it must be greater than zero"),
        ("side_m = 0.5", "side_m = 0.5, thick_m = 1", "thick_m is no known key"),
    ],
)
def test_what_is_wrong_with_an_event(tmp_path, old, new, words):
    with pytest.raises(UserError, match=re.escape(words)):
        eventful(tmp_path, EVENTS.replace(old, new))


def test_an_anchor_is_moved_with_its_sensor_or_without():
    anchor = scenario.load_scenario("anchors4").beacons[1]
    by_m = np.array([0.01, 0.02, 0.03])
    for stays, shift in ((False, by_m), (True, 0.0 * by_m)):
        moved = anchor.moved(by_m, sensor_stays=stays)
        np.testing.assert_allclose(moved.geometry.position_m, anchor.geometry.position_m + by_m)
        np.testing.assert_allclose(moved.sensor.position_m, anchor.sensor.position_m + shift)


WRONG = {
    "unknown key": (
        {"noise_T": "1e-7\nbandwith_Hz = 5.0"},
        r'small\.toml:13: \[sensor\]: bandwith_Hz is no known key; did you mean "bandwidth_Hz"',
    ),
    "unknown table": ({"seed": "1\n[[becon]]\nid = 1"}, 'becon is no known key; did you mean "beacon"'),
    "unknown key of a beacon": (
        {"sync_master": "true\nturn = 3"},
        r'\[\[beacon\]\] 1: turn is no known key; did you mean "turns"',
    ),
    "wrong type": ({"range_T": '"wide"'}, r'\[sensor\]: range_T must be a finite number, not the text "wide"'),
    "negative": ({"noise_T": "-1e-7"}, "noise_T is -1e-07; it must not be negative"),
    "coupling": (
        {"supply_V": "120.0\nshorted_coupling = 1.0"},
        "shorted_coupling is 1; it must be between 0 and 1",
    ),
    "no supply": ({"supply_V": "0.0"}, r"supply_V is 0; it must be greater than zero"),
    "node": ({"node": "5000"}, "node is 5000; it must lie in 1 to 4095"),
    "code": ({"code": "1025"}, "code is 1025; it must lie in 0 to 1024"),
    "codes twice": ({"code": "3"}, "code is 3, which beacon a already has: take another"),
    "boards' time": ({"name": '"small"\nsync = "field"'}, '"field"; it must be "wire", "can" or "automatic"'),
    "nodes twice": ({"node": "2"}, "node is 2, which the sensor already has: take another"),
    "no master": ({"sync_master": "false"}, "exactly one must have sync_master = true; none has"),
    "motion": ({"kind": '"orbit"'}, 'kind is "orbit"; it must be one of still, line, waypoints'),
    "still does not move": (
        {"kind": '"still"\nvelocity_m_per_s = [1.0, 0.0, 0.0]'},
        "velocity_m_per_s is no known key",
    ),
    "vector": ({"position_m": "[1.0, 2.0]"}, r"position_m must be three finite numbers"),
    "current": ({"current_A": "20.0"}, "current_A is 20; the boards drive 0 to 15.9 A"),
    "calibration": (
        {"noise_T": '1e-7\ncalibration = "good"'},
        'calibration is "good"; it must be "exact" or "nominal"',
    ),
    "no TOML": ({"seed": "= 3"}, "is no valid TOML"),
    "crystal": ({"crystal_ppm": "1e5"}, r"crystal_ppm is 100000; it must lie within \+-5000"),
    "drift": (
        {"crystal_ppm": "20.0\ncrystal_ppm_per_s = 101.0"},
        r"crystal_ppm_per_s is 101; it must lie within \+-100",
    ),
    "warming": (
        {"crystal_ppm": "20.0\ntemperature_K_per_s = -11.0"},
        r"temperature_K_per_s is -11; it must lie within",
    ),
    "supply": (
        {"crystal_ppm": "20.0\nprocessor_supply_V = 4.1"},
        r"processor_supply_V is 4.1; it must lie in 0 to 4",
    ),
    "a public key that is none": (
        {"crystal_ppm": '20.0\npublic_key = "abc"'},
        "public_key is 'abc'; it must have 64 hexadecimal digits, as goldfield keys show prints",
    ),
    "a flash of two boards": (
        {"crystal_ppm": '20.0\nflash = "one"', "sync_master": 'true\nflash = "one"'},
        "flash is 'one', which the sensor already has: take another",
    ),
    "half wire": ({"code": "2\npoints_m = [[0, 0, 0], [1, 0, 0]]"}, "points_m encloses no area"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_in_a_sentence(tmp_path, name):
    replacements, sentence = WRONG[name]
    with pytest.raises(UserError, match=sentence) as caught:
        scenario.load(write_scenario(tmp_path, **replacements))
    assert "\n" not in str(caught.value)
    assert "small.toml" in str(caught.value)


def test_two_masters(tmp_path):
    path = write_scenario(tmp_path)
    path.write_text(path.read_text().replace("crystal_ppm = -30.0", "sync_master = true"))
    with pytest.raises(UserError, match="exactly one must have sync_master = true; a, c have"):
        scenario.load(path)


def test_no_such_scenario(tmp_path):
    with pytest.raises(UserError, match=r"there is no scenario 'atlantis'; there are .*prigge8"):
        scenario.load_scenario("atlantis")
    with pytest.raises(UserError, match=r"there is no such scenario"):
        scenario.load_scenario(str(tmp_path / "nothing.toml"))
