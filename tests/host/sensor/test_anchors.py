"""Anchors name a beacon that was moved, or that metal was brought near to; fields by magpylib."""

import magpylib
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from goldfield.sensor.anchors import DRIFT, ELSEWHERE, AnchorWatch
from goldfield.site import Beacon, SensorSite, Site
from goldfield.types import Explanation
from goldfield_protocol import decode, encode
from tests.host.fake_sensor import CHIPS, EARTH_T, heartbeat

NOISE_T = 2e-8
CYCLE_S = 1023 * 97.75e-6
CODES = (2, 3, 4, 5)
PLACES_M = np.array([[0.0, 0.0, 0.0], [4.0, 0.1, 0.2], [3.9, 3.0, 0.05], [0.1, 2.9, 0.3]])
AXES = np.array([[0.03, -0.02, 1.0], [-0.05, 0.04, 1.0], [0.02, 0.06, 1.0], [0.0, -0.03, 1.0]])
AXES /= np.linalg.norm(AXES, axis=1)[:, None]
MOUNTING_M = np.array([0.02, -0.01, 0.5])
ATTITUDES = Rotation.from_rotvec([[0.02, 0.03, 0.6], [-0.04, 0.05, 2.1], [0.06, 0.02, -2.4], [0.0, -0.03, -0.9]])
IDS = ("a1", "a2", "a3", "a4")
SITE = Site(
    name="anchors",
    chip_period_s=97.75e-6,
    degree=10,
    half_space=None,
    sensor=SensorSite(noise_T=NOISE_T),
    beacons=tuple(Beacon(IDS[row], PLACES_M[row], AXES[row], 19.0, 0.149, None, 10.0, CODES[row]) for row in range(4)),
)
ROW = 1
REFERENCE, AFTER = 24, 20


def fields(places_m, sensors_m, current_A=(10.0,) * 4):
    """Fields of the four coils in the frames of the four sensors, shape (4, 4, 3)."""
    result = np.empty((4, 4, 3))
    for beacon in range(4):
        coil = magpylib.current.Circle(
            diameter=0.298,
            current=19.0 * current_A[beacon],
            position=places_m[beacon],
            orientation=Rotation.align_vectors([AXES[beacon]], [[0.0, 0.0, 1.0]])[0],
        )
        for anchor in range(4):
            result[anchor, beacon] = ATTITUDES[anchor].inv().apply(coil.getB(sensors_m[anchor]))
    return result


def report(anchor, cycle, exact_T, rng):
    """What an anchor sends of a cycle, decoded."""
    samples = CHIPS[:, :4] @ exact_T + EARTH_T + NOISE_T * rng.normal(size=(1023, 3))
    low, node = cycle % 16, anchor + 1
    status = {"chips": 1023, "saturated": 0, "fields": 4, "locked": 1, "phase": 0, "temperature": 25}

    def vector(values):
        return dict(zip("xyz", map(float, values), strict=True)) | {"cycle_low": low}

    return [
        encode("EPOCH", {"cycle": cycle, "time": (cycle + 0.5) * CYCLE_S}, node=node),
        encode("EPOCH_STATUS", status | {"cycle_low": low}, node=node),
        encode("EPOCH_OFFSET", vector(samples.mean(axis=0)), node=node),
        *(
            encode("FIELD", vector(CHIPS[:, place] @ samples / 1023), node=node, index=code)
            for place, code in enumerate(CODES)
        ),
    ]


def watched(before_T, after_T, after=AFTER, role=3, seed=4):
    """Findings after each cycle."""
    watch, rng, findings = AnchorWatch(SITE), np.random.default_rng(seed), []
    for anchor in range(4):
        watch.take(decode(*heartbeat(node=anchor + 1, role=role)))
    for cycle in range(REFERENCE + after):
        for anchor in range(4):
            exact = before_T if cycle < REFERENCE else after_T
            for message in report(anchor, cycle, exact[anchor], rng):
                watch.take(decode(*message))
        findings.append(watch.finding)
    return findings


SENSORS_M = PLACES_M + MOUNTING_M
BEFORE_T = fields(PLACES_M, SENSORS_M)
STEP_M = np.array([0.012, -0.012, 0.0105])


def test_a_coil_moved_by_2_cm_is_named_at_once_and_placed():
    places = PLACES_M.copy()
    places[ROW] += STEP_M
    findings = watched(BEFORE_T, fields(places, SENSORS_M))
    assert findings[:REFERENCE] == [None] * REFERENCE
    assert findings[REFERENCE] is not None
    last = findings[-1]
    assert (last.kind, last.beacons) == (Explanation.MOVED, (IDS[ROW],))
    assert np.linalg.norm(last.position_m - places[ROW]) < 2e-3
    assert last.text.startswith("anchors see that the fields of a2 have changed: its position fits better at ")


def test_a_whole_mast_moved_by_10_cm_is_named_within_2_s_by_the_others():
    places, sensors = PLACES_M.copy(), SENSORS_M.copy()
    places[ROW] += 5.0 * STEP_M
    sensors[ROW] += 5.0 * STEP_M
    findings = watched(BEFORE_T, fields(places, sensors))
    named = [place for place, finding in enumerate(findings) if finding is not None]
    assert named
    assert 0 <= named[0] - REFERENCE < 20
    assert findings[-1].beacons == (IDS[ROW],)


def test_metal_near_a_coil_is_named_within_2_s():
    """A sheet 0.3 m below the coil as its image: a coil of the opposite current at twice that distance."""
    image = magpylib.current.Circle(
        diameter=0.298,
        current=-190.0,
        position=PLACES_M[ROW] - [0.0, 0.0, 0.6],
        orientation=Rotation.align_vectors([AXES[ROW]], [[0.0, 0.0, 1.0]])[0],
    )
    after = BEFORE_T.copy()
    for anchor in range(4):
        after[anchor, ROW] += ATTITUDES[anchor].inv().apply(image.getB(SENSORS_M[anchor]))
    findings = watched(BEFORE_T, after)
    assert findings[REFERENCE + 3].beacons == (IDS[ROW],)
    assert "metal" in findings[-1].text


def test_sound_anchors_say_nothing_nor_does_a_drift_within_a_step_of_the_set_point():
    assert watched(BEFORE_T, BEFORE_T, after=60) == [None] * (REFERENCE + 60)
    drifted = fields(PLACES_M, SENSORS_M, current_A=(10.0, 10.002, 10.0, 10.0))
    assert watched(BEFORE_T, drifted) == [None] * (REFERENCE + AFTER)


@pytest.mark.parametrize(("current_A", "kind"), [(10.1, Explanation.CURRENT), (0.0, Explanation.DEAD)])
def test_another_current_is_told_as_one(current_A, kind):
    last = watched(BEFORE_T, fields(PLACES_M, SENSORS_M, current_A=(10.0, current_A, 10.0, 10.0)))[-1]
    assert (last.kind, last.beacons) == (kind, ("a2",))
    assert last.factor == pytest.approx(current_A / 10.0, abs=2e-3)


def run(cycles, exact, silent=lambda anchor, cycle: False, seed=6):
    """Findings after each cycle; ``exact`` tells the fields of a cycle."""
    watch, rng, findings = AnchorWatch(SITE), np.random.default_rng(seed), []
    for anchor in range(4):
        watch.take(decode(*heartbeat(node=anchor + 1, role=3)))
    for cycle in range(cycles):
        for anchor in range(4):
            if not silent(anchor, cycle):
                for message in report(anchor, cycle, exact(cycle)[anchor], rng):
                    watch.take(decode(*message))
        findings.append(watch.finding)
    return findings


def test_a_beacon_that_is_switched_on_later_is_not_named_until_it_changes():
    """It comes on amid the first reference, or long after it."""
    off = fields(PLACES_M, SENSORS_M, current_A=(10.0, 0.0, 10.0, 10.0))
    places = PLACES_M.copy()
    places[ROW] += STEP_M
    moved = fields(places, SENSORS_M)
    for on in (13, 50):
        found = run(on + 80, lambda cycle, on=on: off if cycle < on else BEFORE_T if cycle < on + 60 else moved)
        assert found[: on + 60] == [None] * (on + 60)
        assert found[-1].beacons == (IDS[ROW],)


def test_an_anchor_that_lost_its_power_has_no_field():
    """Its own sensor is silent, too, and what that saw last does not speak against it."""
    off = fields(PLACES_M, SENSORS_M, current_A=(10.0, 0.0, 10.0, 10.0))
    found = run(70, lambda cycle: off if cycle >= 40 else BEFORE_T, lambda anchor, cycle: anchor == ROW and cycle >= 40)
    assert {finding.kind for finding in found[43:]} == {Explanation.DEAD}
    assert {finding.beacons for finding in found[43:]} == {(IDS[ROW],)}


def test_sensors_that_are_no_anchors_are_not_listened_to():
    places = PLACES_M.copy()
    places[ROW] += STEP_M
    assert not any(watched(BEFORE_T, fields(places, SENSORS_M), after=3, role=1))


def test_it_ends_when_the_beacon_is_put_back():
    places = PLACES_M.copy()
    places[ROW] += STEP_M
    watch, rng = AnchorWatch(SITE), np.random.default_rng(5)
    moved = fields(places, SENSORS_M)
    for anchor in range(4):
        watch.take(decode(*heartbeat(node=anchor + 1, role=3)))
    seen = []
    for cycle in range(90):
        for anchor in range(4):
            exact = moved if REFERENCE <= cycle < 45 else BEFORE_T
            for message in report(anchor, cycle, exact[anchor], rng):
                watch.take(decode(*message))
        seen.append(watch.finding is not None)
    assert all(seen[REFERENCE + 1 : 45])
    assert not any(seen[67:])


@pytest.mark.parametrize("part", [0.9, 1.1])
def test_a_pair_of_others_that_changes_by_more_than_a_part_of_it_speaks_against_a_beacon(part):
    """The part is one of costs: squares of changes over what the means of 20 and 24 cycles and a drift leave open."""
    places = PLACES_M.copy()
    places[ROW] += 5.0 * STEP_M
    after = fields(places, SENSORS_M)
    variance = NOISE_T**2 / 1023 * (1 / AFTER + 1 / REFERENCE) + DRIFT**2 * (BEFORE_T**2).sum(axis=2)
    cost = ((after - BEFORE_T) ** 2).sum(axis=2) / variance
    after[0, 2] += np.sqrt(part * ELSEWHERE * cost[:, ROW].max() * variance[0, 2] / 3.0)
    last = watched(BEFORE_T, after)[-1]
    assert (last.kind is Explanation.MOVED and last.beacons == (IDS[ROW],)) == (part < 1.0)
    assert set(last.beacons) > {IDS[ROW]} or part < 1.0
