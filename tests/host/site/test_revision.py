"""A revised site file: what is new is read from it bit for bit, what is old stays as its author wrote it."""

import difflib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from goldfield.errors import UserError
from goldfield.site import Survey, load
from goldfield.site.coil_shapes import smallest_rotation
from goldfield.site.metal import Metal, no_metal
from goldfield.site.reading import LEAST_DEVIATION
from goldfield.site.revision import BeaconRevision, SensorRevision, revised

SITE = """\
# The hall, measured on Monday.
[site]
name = "hall"
chip_period_s = 97.75e-6
degree = 10

[sensor] # the green board
noise_T = 2.0e-7 # from its data sheet

[survey]
position_sd_m = 0.01   # a tape

# The door's coil hangs
# a bit askew.
[[beacon]]
id = "door"
position_m = [
    0.0,  # along the wall
    0,
    2.50, # the ceiling
]
axis = [0.0, 0.0, 1.0]
turns = 19
radius_m = 0.149
current_A = 10
code = 2

# A number for a name.
[[beacon]]
id = 7
points_m = [
    [1.0, 1.0, 0.0], # the first corner
    [1.5, 1.0, 0.0],
    [1.5, 1.5, 0.0],
    [1.0, 1.5, 0.0],
]
current_A = 2.0e-1 # by the shunt
code = 1024
# The end.
"""

COORDINATES = arrays(np.float64, 3, elements=st.floats(-100.0, 100.0))
DIRECTIONS = (arrays(np.float64, 3, elements=st.floats(-1.0, 1.0)).filter(lambda v: np.linalg.norm(v) > 1e-3)).map(
    lambda v: v / np.linalg.norm(v)
)
CURRENTS = st.floats(1e-6, 200.0) | st.floats(-200.0, -1e-6)


def deviations(limit):
    return st.just(0.0) | st.floats(LEAST_DEVIATION, limit)


SURVEYS = st.builds(Survey, deviations(0.9), deviations(0.4), deviations(0.4))
REVISIONS = st.builds(
    BeaconRevision,
    st.none() | COORDINATES,
    st.none() | DIRECTIONS,
    st.none() | CURRENTS,
    st.none() | SURVEYS,
)
AXES = arrays(np.float64, (3, 3), elements=st.floats(-0.2, 0.2)).map(lambda part: part + np.diag([1.0, -1.1, 0.9]))
SENSORS = st.builds(SensorRevision, st.none() | AXES, st.none() | deviations(0.49), st.none() | deviations(0.49))


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """Return the file; the module's, as hypothesis draws many examples in one test."""
    path = tmp_path_factory.mktemp("site") / "hall.toml"
    path.write_text(SITE)
    return path


def loaded(path, text):
    new = path.with_name("new.toml")
    new.write_text(text)
    return load(new)


def changed_lines(text):
    """Return the lines that went and those that came."""
    lines = [line for line in difflib.ndiff(SITE.split("\n"), text.split("\n")) if line[0] in "+-"]
    return [line[2:] for line in lines if line[0] == "-"], [line[2:] for line in lines if line[0] == "+"]


@given(door=REVISIONS, square=REVISIONS, sensor=st.none() | SENSORS)
@settings(max_examples=60, deadline=None)
def test_what_is_written_is_what_is_read(path, door, square, sensor):
    old, new = load(path), loaded(path, revised(path, {"door": door, "7": square}, sensor))
    for before, after, revision in zip(old.beacons, new.beacons, (door, square), strict=True):
        position, axis = (
            getattr(before, key) if getattr(revision, key) is None else getattr(revision, key)
            for key in ("position_m", "axis")
        )
        exact = 0.0 if before.points_m is None else 1e-12
        np.testing.assert_allclose(after.position_m, position, rtol=0.0, atol=exact)
        np.testing.assert_allclose(after.axis, axis, rtol=0.0, atol=1e-15 if before.points_m is None else 1e-11)
        assert after.current_A == (before.current_A if revision.current_A is None else revision.current_A)
        assert after.survey == (before.survey if revision.survey is None else revision.survey)
        assert (after.id, after.turns, after.radius_m, after.code) == (
            before.id,
            before.turns,
            before.radius_m,
            before.code,
        )
    given = sensor or SensorRevision()
    assert new.sensor.noise_T == old.sensor.noise_T
    assert new.sensor.gain_sd == (old.sensor.gain_sd if given.gain_sd is None else given.gain_sd)
    assert new.sensor.axis_sd_rad == (old.sensor.axis_sd_rad if given.axis_sd_rad is None else given.axis_sd_rad)
    if given.axes is None:
        assert new.sensor.axes is None
    else:
        np.testing.assert_array_equal(new.sensor.axes, given.axes)


@given(position=COORDINATES, axis=DIRECTIONS)
@settings(max_examples=40, deadline=None)
def test_a_wire_moves_as_a_rigid_body_and_turns_no_more_than_it_must(path, position, axis):
    before = load(path).beacon("7")
    after = loaded(path, revised(path, {"7": BeaconRevision(position, axis)})).beacon("7")
    wire, moved = before.points_m - before.position_m, after.points_m - position
    turn, _ = Rotation.align_vectors(moved, wire)
    np.testing.assert_allclose(turn.apply(wire), moved, rtol=0.0, atol=1e-11)
    angle = np.arctan2(np.linalg.norm(np.cross(before.axis, axis)), before.axis @ axis)
    assert turn.magnitude() == pytest.approx(angle, abs=1e-7)


@given(old=DIRECTIONS, new=DIRECTIONS)
def test_the_smallest_rotation_is_scipys(old, new):
    rotation = smallest_rotation(old, new)
    np.testing.assert_allclose(rotation @ old, new, atol=1e-14)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(rotation), 1.0, atol=1e-14)
    angle = np.arctan2(np.linalg.norm(np.cross(old, new)), old @ new)
    assert Rotation.from_matrix(rotation).magnitude() == pytest.approx(angle, abs=1e-7)


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-8, 1e-4])
def test_a_coil_that_hangs_upside_down_is_turned_over(tilt):
    old = np.array([0.0, 0.6, 0.8])
    new = -old + tilt * np.array([1.0, 0.0, 0.0])
    new /= np.linalg.norm(new)
    rotation = smallest_rotation(old, new)
    np.testing.assert_allclose(rotation @ old, new, atol=1e-14)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_only_what_is_new_changes(path):
    survey = Survey(0.002, 0.0, 0.001)
    beacons = {
        "door": BeaconRevision(np.array([0.0, 0.0125, 2.5]), current_A=11.0, survey=survey),
        "7": BeaconRevision(current_A=0.25),
    }
    text = revised(path, beacons, SensorRevision(axes=np.diag([1.0, -1.0, 1.0]), gain_sd=1e-6))
    gone, come = changed_lines(text)
    assert gone == ["    0,", "current_A = 10", "current_A = 2.0e-1 # by the shunt"]
    assert come == [
        "axes = [",
        "    [1.0, 0.0, 0.0],",
        "    [0.0, -1.0, 0.0],",
        "    [0.0, 0.0, 1.0],",
        "]",
        "gain_sd = 1.0e-6",
        "    0.0125,",
        "current_A = 11",
        "position_sd_m = 0.002",
        "axis_sd_rad = 0.0",
        "current_sd = 0.001",
        "current_A = 2.5e-1 # by the shunt",
    ]
    # The new keys stand right behind the table's last one, not behind the comment that leads to the next table.
    assert "code = 2\nposition_sd_m = 0.002\naxis_sd_rad = 0.0\ncurrent_sd = 0.001\n\n# A number for a name." in text
    assert "from its data sheet\naxes = [" in text


def test_nothing_new_is_the_same_file(path):
    assert revised(path, {"door": BeaconRevision()}) == SITE
    site = load(path)
    same = {beacon.id: BeaconRevision(beacon.position_m, beacon.axis, beacon.current_A) for beacon in site.beacons}
    assert revised(path, same) == SITE


def test_line_ends_and_a_file_without_a_last_one_stay(tmp_path):
    path = tmp_path / "dos.toml"
    path.write_bytes(SITE.split("# The end.")[0].rstrip().replace("\n", "\r\n").encode())
    text = revised(path, {"7": BeaconRevision(current_A=0.3, survey=Survey(0.01, 0.02, 0.03))})
    new = tmp_path / "new.toml"
    new.write_bytes(text.encode())
    assert load(new).beacon("7").survey == Survey(0.01, 0.02, 0.03)
    assert text.startswith("# The hall, measured on Monday.\r\n[site]\r\n")
    assert text.count("\n") == text.count("\r\n")


def test_beacons_in_one_line_each(tmp_path):
    path = tmp_path / "short.toml"
    head = SITE.split("# The door's coil")[0]
    path.write_text(
        f"""beacon = [
    {{ id = "a", position_m = [0, 0, 1], axis = [0, 0, 1], turns = 3, radius_m = 0.1, current_A = 1, code = 1 }}, # a
]
{head}"""
    )
    text = revised(path, {"a": BeaconRevision(np.array([0.0, 0.5, 1.0]), survey=Survey(0.1, 0.2, 0.3))})
    beacon = loaded(path, text).beacon("a")
    assert beacon.position_m.tolist() == [0.0, 0.5, 1.0]
    assert beacon.survey == Survey(0.1, 0.2, 0.3)
    assert "[0, 0.5, 1]" in text
    assert "}, # a" in text


def test_beacons_among_other_tables_are_brought_together(tmp_path):
    path = tmp_path / "mixed.toml"
    head, _, tail = SITE.partition("[sensor]")
    sensor, _, beacons = tail.partition("# The door's coil")
    door, _, square = beacons.partition("# A number for a name.")
    path.write_text(f"{head}# The door's coil{door}[sensor]{sensor}# A number for a name.{square}")
    new = loaded(path, revised(path, {"7": BeaconRevision(current_A=1.0)}))
    assert [(beacon.id, beacon.current_A) for beacon in new.beacons] == [("door", 10.0), ("7", 1.0)]


@pytest.mark.parametrize(
    ("beacons", "sensor", "words"),
    [
        ({"window": BeaconRevision()}, None, 'no beacon has the id "window"; there are door, 7'),
        ({"door": BeaconRevision(current_A=0.0)}, None, "current_A is zero"),
        ({"door": BeaconRevision(survey=Survey(2.0))}, None, "position_sd_m is 2;"),
        ({"door": BeaconRevision(np.array([0.0, np.nan, 0.0]))}, None, "hall.toml"),
        ({}, SensorRevision(axes=np.ones((3, 3))), "axes are nearly in one plane"),
        ({}, SensorRevision(axes=np.ones((4, 3))), "axes has 4 rows"),
        ({}, SensorRevision(axes=np.ones((2, 3))), "give [[a, 0, 0]] or [[a, 0, 0], [b, c, 0]]"),
    ],
)
def test_values_that_no_site_can_have_are_refused(path, beacons, sensor, words):
    with pytest.raises(UserError) as caught:
        revised(path, beacons, sensor)
    assert words in str(caught.value)


def test_metal_is_written_and_taken_away(tmp_path: Path) -> None:
    """A table [metal] comes before the beacons, takes the place of an old one, and leaves with degree 0."""
    path = tmp_path / "hall.toml"
    path.write_text(SITE)
    metal = Metal(
        np.array([0.1, 0.2, 0.3]),
        1.5,
        1,
        np.array([[3.0, 0.0, 1.0]]),
        np.diag([1.0, 2.0, 3.0])[None],
        2e-10,
        np.eye(3)[:0],
    )
    coefficients = np.array([1e-9, -2e-9, 3.5e-10])
    ids = [beacon.id for beacon in load(path).beacons]
    text = revised(path, {name: BeaconRevision(metal_T_A=coefficients) for name in ids}, metal=metal)
    assert text.index("[metal]") < text.index("[[beacon]]")
    path.write_text(text)
    site = load(path)
    assert site.metal is not None
    assert site.metal.degree == 1
    assert site.metal.polarisability_A_m2_T.tolist() == metal.polarisability_A_m2_T.tolist()
    assert site.metal.sd_T_A == 2e-10
    assert all(beacon.metal is not None for beacon in site.beacons)
    assert site.beacons[0].metal.harmonics_T_A.tolist() == coefficients.tolist()  # type: ignore[union-attr]
    path.write_text(revised(path, {}, metal=no_metal()))
    assert load(path).metal is None
    assert "metal" not in path.read_text()
