"""What a run tells Foxglove, and how often, whoever takes it."""

import math

from goldfield.foxglove.telling import ELLIPSOID_EVERY_S, HEALTH_EVERY_S, Telling
from goldfield.foxglove.topics import FIELDS, HEALTH, LINE, LOG, POSE, SCENE
from goldfield.nodes.roster import Roster
from goldfield.view.lines import Line
from tests.host.feeds import made
from tests.host.feeds.made import UNIX_S, epoch

NOW_S = UNIX_S + 0.25


def telling(wanted=None):
    """A telling, and the list of what it logs: topic, message and time."""
    logged = []
    return Telling(made.SITE, "port x", Roster(), lambda *one: logged.append(one), wanted), logged


def line(number=0):
    item = epoch(number)
    return Line(item.pose, item, 0, math.nan)


def of_topic(logged, topic):
    return [(message, at_s) for name, message, at_s in logged if name == topic]


def test_a_pose_whose_time_nobody_knows_is_stamped_with_now_and_says_so():
    one, logged = telling()
    one.line(line(), math.nan, NOW_S, NOW_S)
    ((record, at_s),) = of_topic(logged, LINE)
    assert (record["unix_s"], record["latency_s"], at_s) == (None, None, NOW_S)
    one.line(line(), NOW_S, NOW_S, NOW_S)
    (unknown, _), (known, _) = of_topic(logged, POSE)
    assert unknown.encode() == known.encode()


def test_latency_is_from_the_measurement_to_when_the_pose_was_known():
    for known_s, latency_s in ((NOW_S, 0.25), (math.nan, None)):
        one, logged = telling()
        one.line(line(), UNIX_S, NOW_S, known_s)
        ((record, _),) = of_topic(logged, LINE)
        assert (record["unix_s"], record["latency_s"]) == (UNIX_S, latency_s)


def test_health_and_ellipsoids_come_now_and_then_also_when_the_clock_was_set_back():
    one, logged = telling()
    for step, due in ((0.0, 1), (0.99, 1), (1.0, 2), (1.98, 2), (0.5, 2), (0.0, 3)):
        one.epoch(epoch(0), UNIX_S + step * HEALTH_EVERY_S, NOW_S)
        assert len(of_topic(logged, HEALTH)) == due
    assert len(of_topic(logged, FIELDS)) == 6
    del logged[:]
    for step, due in ((0.0, 1), (0.98, 1), (1.02, 2), (-1.0, 3)):
        one.line(line(), UNIX_S + step * ELLIPSOID_EVERY_S, NOW_S, NOW_S)
        assert len(of_topic(logged, SCENE)) == due


def test_a_status_is_logged_when_it_changes():
    one, logged = telling()
    for number in range(3):
        one.line(line(number), UNIX_S, NOW_S, NOW_S)
    assert len(of_topic(logged, LOG)) == 1


def test_what_nobody_gets_is_not_made():
    one, logged = telling(wanted=lambda *topics: LOG in topics)
    one.epoch(epoch(0), UNIX_S, NOW_S)
    one.line(line(), UNIX_S, NOW_S, NOW_S)
    assert {topic for topic, _, _ in logged} == {HEALTH, SCENE, LOG}, "health and the coils, once a second, for all"
