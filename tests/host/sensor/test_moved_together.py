"""Anchors that were moved together are named, or nothing that rests on them is relied on."""

import numpy as np
import pytest

from goldfield.sensor.anchors import left_out
from goldfield.sensor.location import with_finding
from goldfield.sensor.moved_together import moved_together, sides
from goldfield.types import Explanation, Fields, Pose, Status
from tests.host.sensor.test_anchors import BEFORE_T, IDS, PLACES_M, REFERENCE, SENSORS_M, SITE, fields, watched


def pairs(count, *changed):
    result = np.zeros((count, count), dtype=bool)
    for a, b in changed:
        result[a, b] = True
    return result


@pytest.mark.parametrize(
    ("changed", "split"),
    [
        ([], None),
        ([(0, 1)], ([0], [1])),
        ([(1, 0)], ([0], [1])),
        ([(0, 2), (0, 3), (1, 2), (3, 1)], ([0, 1], [2, 3])),
        ([(0, 2), (4, 0), (1, 2), (3, 1), (0, 3)], ([0, 1], [2, 3, 4])),
        ([(0, 1), (1, 2), (2, 0)], None),
        ([(0, 1), (2, 3)], None),
        ([(3, 3)], None),
    ],
)
def test_all_changes_are_between_the_sides(changed, split):
    assert sides(pairs(5, *changed)) == split


@pytest.mark.parametrize(
    ("changed", "kind", "beacons", "words"),
    [
        (
            [(0, 2), (1, 3), (1, 4), (0, 4), (0, 3)],
            Explanation.MOVED,
            ("a", "b"),
            "a and b were moved together, or c",
        ),
        ([(0, 2), (1, 3), (1, 2)], Explanation.UNKNOWN, ("a", "b", "c", "d"), "a and b moved against c and d"),
        ([(0, 2), (0, 3)], Explanation.UNKNOWN, ("a", "c", "d"), "a moved against c and d, and not which"),
        ([(0, 1), (1, 2), (2, 0)], Explanation.UNKNOWN, ("a", "b", "c"), "changes at a, b and c that the move of none"),
    ],
)
def test_the_smaller_side_of_two_or_more_is_named_else_all_are_doubted(changed, kind, beacons, words):
    finding = moved_together(pairs(5, *changed), "abcde")
    assert (finding.kind, finding.beacons) == (kind, beacons)
    assert words in finding.text
    assert left_out(finding) == (beacons if kind is Explanation.MOVED else ())


def test_no_change_is_no_finding():
    assert moved_together(pairs(4), "abcd") is None
    assert left_out(None) == ()


def test_two_of_four_anchors_on_one_mast_that_was_moved():
    """Their own fields and those of each other at them stay; which two were moved nobody can tell."""
    places, sensors = PLACES_M.copy(), SENSORS_M.copy()
    for row in (0, 1):
        places[row] += [0.3, 0.2, 0.0]
        sensors[row] += [0.3, 0.2, 0.0]
    findings = watched(BEFORE_T, fields(places, sensors))
    assert findings[:REFERENCE] == [None] * REFERENCE
    told = [place - REFERENCE for place, finding in enumerate(findings) if finding is not None]
    assert told[0] < 20
    last = findings[-1]
    assert (last.kind, last.beacons) == (Explanation.UNKNOWN, IDS)
    assert last.text.startswith("anchors see that a1 and a2 moved against a3 and a4, and not which of them")
    sound = Fields(0, 0.0, IDS, np.zeros((4, 3)), np.ones(4))
    doubted = with_finding(Pose(**{**vars(Pose.failed(sound, used=SITE_IDS)), "status": Status.OK}), last)
    assert doubted.status is Status.INCONSISTENT


SITE_IDS = tuple(beacon.id for beacon in SITE.beacons)
