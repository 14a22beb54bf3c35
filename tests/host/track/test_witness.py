"""The history of the residuals names a beacon that is not as the site says; truth by magpylib."""

from dataclasses import replace

import numpy as np
import pytest

from goldfield.access import Separator
from goldfield.sensor.location import location, without
from goldfield.sensor.options import Method
from goldfield.site import Survey
from goldfield.track import Tracker, Witness
from goldfield.track.faults import Judgement
from goldfield.track.witness import DENIED, EARLIER_STARTS, FALSE_ALARMS_PER_HOUR, KEPT, STARTS
from goldfield.types import Explanation, Fields, Status
from tests.bench.locate_trials import prigge_cube
from tests.bench.motion_trials import Room, circling

NOISE_T = 2e-8
SITE = prigge_cube(NOISE_T)
IDS = tuple(beacon.id for beacon in SITE.beacons)
SEPARATOR = Separator(10, SITE.codes, NOISE_T)
ROW, CHANGED_AT = 4, 6
STEP_M = np.array([0.012, -0.012, 0.0105])
"""A step of 2 cm."""


def epochs(fault, count, seed=1, speed=0.5, rate=0.5):
    """Fields of a moving sensor; from `CHANGED_AT` on one beacon differs from the site."""
    rng = np.random.default_rng(seed)
    changed = list(SITE.beacons)
    changed[ROW] = fault(changed[ROW])
    rooms = Room(SITE), Room(replace(SITE, beacons=tuple(changed)))
    flight = circling(rng, speed, rate)
    result = []
    for k in range(count):
        samples = rooms[k >= CHANGED_AT].samples(flight, k * SITE.cycle_s, NOISE_T, rng)
        separation = SEPARATOR.from_samples(samples)
        result.append(Fields(k, k * SITE.cycle_s, IDS, separation.field_T, separation.sigma_T))
    return result


def moved(factor):
    return lambda beacon: replace(beacon, position_m=beacon.position_m + factor * STEP_M)


def fed(factor):
    return lambda beacon: replace(beacon, current_A=factor * beacon.current_A)


def watched(data, site=SITE):
    """Findings of a tracker's epochs, as the pipeline makes them."""
    tracker, witness = Tracker(site), Witness(site)
    return [witness.update(tracker.step(fields, witness.named).judgement) for fields in data]


@pytest.mark.parametrize("method", [Method.EACH, Method.TRACK])
def test_a_beacon_moved_by_2_cm_is_named_within_2_s_and_left_out(method):
    locate = location(SITE, method)
    speed = 0.5 if method is Method.TRACK else 0.0
    poses = [locate(fields, None) for fields in epochs(moved(1.0), CHANGED_AT + 21, speed=speed, rate=speed)]
    assert not any(finding for pose in poses[:CHANGED_AT] for finding in pose.findings)
    named = [pose.epoch for pose in poses if any(f.beacons == (IDS[ROW],) for f in pose.findings)]
    assert named
    assert named[0] - CHANGED_AT < 20
    last = poses[-1]
    assert last.status is Status.OK
    assert last.excluded == (IDS[ROW],)
    assert IDS[ROW] not in last.used
    assert last.reason.startswith(f"{IDS[ROW]}: its position fits better at ")
    assert last.findings[0].kind is Explanation.MOVED
    assert np.linalg.norm(last.findings[0].position_m - SITE.beacons[ROW].position_m - STEP_M) < 3e-3
    if method is Method.TRACK:
        assert max(last.residuals, key=last.residuals.get) == IDS[ROW]


def test_no_pose_that_rests_on_a_named_beacon_is_ok():
    locate = location(SITE, Method.TRACK)
    for fields in epochs(moved(1.0), CHANGED_AT + 15):
        pose = locate(fields, None)
        if pose.findings and set(pose.findings[0].beacons) & set(pose.used):
            assert pose.status is Status.INCONSISTENT


@pytest.mark.parametrize(
    ("fault", "kind", "factor"),
    [
        (fed(1.05), Explanation.CURRENT, 1.05),
        (fed(-1.0), Explanation.REVERSED, -1.0),
        (fed(0.0), Explanation.DEAD, 0.0),
        (moved(15.0), Explanation.MOVED, None),
    ],
)
def test_what_is_wrong_with_it(fault, kind, factor):
    last = watched(epochs(fault, CHANGED_AT + 20))[-1]
    assert (last.kind, last.beacons) == (kind, (IDS[ROW],))
    if factor is not None:
        assert last.factor == pytest.approx(factor, abs=0.02)
    else:
        assert np.linalg.norm(last.position_m - SITE.beacons[ROW].position_m - 15.0 * STEP_M) < 0.01


def test_it_is_forgotten_once_the_beacon_is_as_before():
    data = epochs(moved(1.0), CHANGED_AT + 12)
    sound = epochs(moved(0.0), CHANGED_AT + 12 + 110, seed=2)
    findings = watched([*data, *sound[CHANGED_AT + 12 :]])
    assert findings[CHANGED_AT + 11] is not None
    assert findings[-1] is None


def test_sound_epochs_name_nobody_and_a_vague_survey_excuses_2_cm():
    assert watched(epochs(moved(0.0), 60)) == [None] * 60
    vague = replace(SITE, beacons=tuple(replace(beacon, survey=Survey(position_sd_m=0.01)) for beacon in SITE.beacons))
    assert not any(watched(epochs(moved(1.0), CHANGED_AT + 20), vague))


def test_both_sides_of_the_limit():
    """One beacon's evidence alone, scaled to just below and just above the chi-square of the permitted rate."""
    from scipy.stats import chi2

    tests_an_hour = 3600.0 / SITE.cycle_s * len(IDS) * (STARTS + EARLIER_STARTS)
    limit = chi2.isf(FALSE_ALARMS_PER_HOUR / tests_an_hour, 3)
    real: Judgement = Tracker(SITE).step(epochs(moved(0.0), 1)[0]).judgement
    score = np.zeros((8, 3))
    score[ROW] = [1.0, -2.0, 0.5]
    size = score[ROW] @ np.linalg.solve(real.information[ROW], score[ROW])
    drop = np.zeros(8)
    for factor, found in ((0.999, False), (1.001, True)):
        witness = Witness(SITE)
        drop[ROW] = factor * limit
        one = replace(real, score=score * np.sqrt(factor * limit / size), drop=drop)
        assert (witness.update(one) is not None) == found


def test_a_beacon_that_is_named_stays_so_down_to_half_of_what_named_it():
    """Evidence that names it, and as much against it as leaves a part just above and just below the half."""
    real = Tracker(SITE).step(epochs(moved(0.0), 1)[0]).judgement
    score = np.zeros((8, 3))
    score[ROW] = [1.0, -2.0, 0.5]
    size = score[ROW] @ np.linalg.solve(real.information[ROW], score[ROW])
    drop = np.zeros(8)
    for part, kept in ((1.01, True), (0.99, False)):
        witness = Witness(SITE)
        limit = witness._limit
        unit = np.sqrt(limit / size)
        drop[ROW] = 1.1 * limit
        assert witness.update(replace(real, score=1.04 * unit * score, drop=drop)) is not None
        # Over the two epochs the cost is (sum of scores)^2 / 2, in the last one alone (second score)^2.
        second = np.sqrt(2.0 * KEPT * part) - 1.04
        assert second**2 < KEPT * 0.9
        found = witness.update(replace(real, score=second * unit * score, drop=drop))
        assert (found is not None) == kept


def test_two_beacons_that_look_alike_are_not_named():
    real = Tracker(SITE).step(epochs(moved(0.0), 1)[0]).judgement
    score = np.zeros((8, 3))
    for row in (1, 2):
        vector = np.array([1.0, -2.0, 0.5])
        score[row] = vector * np.sqrt(400.0 / (vector @ np.linalg.solve(real.information[row], vector)))
    assert Witness(SITE).update(replace(real, score=score)) is None


def test_without_leaves_out_rows():
    fields = epochs(moved(0.0), 1)[0]
    assert without(fields, ()) is fields
    thinned = without(fields, (IDS[0], "nobody"))
    assert thinned.beacons == IDS[1:]
    np.testing.assert_array_equal(thinned.field_T, fields.field_T[1:])


@pytest.mark.parametrize("method", [Method.EACH, Method.TRACK])
def test_a_single_bad_epoch_is_forgotten_with_the_next_good_one(method):
    """It stays in the sums for 10 s, but what comes after it shows that it was alone."""
    speed = 0.5 if method is Method.TRACK else 0.0
    data = epochs(moved(0.0), CHANGED_AT + 40, speed=speed, rate=speed)
    field_T = data[CHANGED_AT].field_T.copy()
    field_T[ROW, 0] += 60.0 * data[CHANGED_AT].sigma_T[ROW]
    data[CHANGED_AT] = replace(data[CHANGED_AT], field_T=field_T)
    locate = location(SITE, method)
    poses = [locate(fields, None) for fields in data]
    named = [pose.epoch for pose in poses if any(IDS[ROW] in finding.beacons for finding in pose.findings)]
    assert named == [CHANGED_AT]
    assert all(pose.status is Status.OK and pose.used == IDS for pose in poses[CHANGED_AT + 2 :])


@pytest.mark.parametrize("method", [Method.EACH, Method.TRACK])
def test_a_beacon_that_came_back_is_not_blamed_for_the_next_one(method):
    """One is dead for 3 s; 2.5 s after it came back another dies, and the first is as good as any other."""
    speed = 0.5 if method is Method.TRACK else 0.0
    back, second, end = CHANGED_AT + 30, CHANGED_AT + 55, CHANGED_AT + 70
    data = epochs(fed(0.0), back, speed=speed, rate=speed)
    sound = epochs(moved(0.0), end, speed=speed, rate=speed)
    other = next(name for name in IDS if name != IDS[ROW])
    for fields in sound[second:]:
        fields.field_T[IDS.index(other)] = np.random.default_rng(fields.epoch).normal(size=3) * fields.sigma_T[0]
    locate = location(SITE, method)
    poses = [locate(fields, None) for fields in [*data, *sound[back:]]]
    assert any(IDS[ROW] in finding.beacons for finding in poses[back - 1].findings)
    assert not poses[second - 1].findings
    assert not any(IDS[ROW] in finding.beacons for pose in poses[second:] for finding in pose.findings)
    assert all(pose.status is Status.OK for pose in poses[second:])


@pytest.mark.parametrize("factor", [1.0, 0.25])
def test_an_error_is_forgotten_after_at_most_three_times_as_many_good_epochs_as_it_took_to_see_it(factor):
    data = epochs(moved(factor), CHANGED_AT + 30)
    sound = epochs(moved(0.0), CHANGED_AT + 70, seed=2)
    findings = watched([*data, *sound[CHANGED_AT + 30 :]])
    named = [k - CHANGED_AT + 1 for k, finding in enumerate(findings) if finding]
    assert named[-1] - 30 <= 3 * named[0]
    assert all(k in named for k in range(named[0], 31))


def test_the_last_epochs_deny_an_error_on_both_sides_of_the_limit():
    """One epoch names a beacon, the next denies it by just less and just more than a third of what it takes."""
    real = Tracker(SITE).step(epochs(moved(0.0), 1)[0]).judgement
    score, drop = np.zeros((8, 3)), np.zeros(8)
    score[ROW] = [1.0, -2.0, 0.5]
    size = score[ROW] @ np.linalg.solve(real.information[ROW], score[ROW])
    for part, kept in ((0.999, True), (1.001, False)):
        witness = Witness(SITE)
        drop[ROW] = 9.0 * witness._limit
        unit = np.sqrt(witness._limit / size)
        first = 2.0
        assert witness.update(replace(real, score=first * unit * score, drop=drop)) is not None
        # With the mean d of both, first + second over 2, the second has d^2 - 2 d second beside no error.
        second = next(x for x in np.linspace(1.0, -1.0, 200_001) if _beside(first, x) > DENIED * part)
        assert second**2 < DENIED
        assert (first + second) ** 2 / 2.0 > 1.0
        assert (witness.update(replace(real, score=second * unit * score, drop=drop)) is not None) == kept


def _beside(first, second):
    shift = (first + second) / 2.0
    return shift**2 - 2.0 * shift * second


def test_a_beacon_is_not_looked_for_where_numbers_end():
    """A field that tells hardly anything asks for a shift beyond all numbers, where the program ended with an error."""
    tracker, witness = Tracker(SITE), Witness(SITE)
    for fields in epochs(fed(1.0), 5):
        witness.update(tracker.step(fields, ()).judgement)
    for far in (np.inf, 1e12):
        shift, share = witness._refined(ROW, np.array([far, 0.0, 0.0]), 5)
        assert (shift[0], share) == (far, 0.0)
