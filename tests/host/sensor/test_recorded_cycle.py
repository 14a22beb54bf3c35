"""A recording of another degree than the site's is refused, by the chips of its cycles or by their duration."""

from dataclasses import replace

import pytest

from goldfield import UserError, load_site, open_log
from goldfield.link.reports import Report
from goldfield.sensor.recorded_cycle import IN_A_ROW, RecordedCycle
from tests.host.fake_sensor import SITE, log_of

ROOM = load_site(SITE)


def test_the_chips_of_a_cycle_tell_a_higher_degree():
    check = RecordedCycle("a.log", replace(ROOM, degree=9))
    check.check(Report(1, 0.1, chips=511))
    with pytest.raises(UserError, match="a cycle of the sensor has 1023 chips, one of the site 511"):
        check.check(Report(2, 0.2, chips=1023))


@pytest.mark.parametrize(("cycle_s", "refused"), [(0.1, False), (0.05, True), (0.2, True), (0.091, False)])
def test_the_duration_of_cycles_tells_any_degree(cycle_s, refused):
    check = RecordedCycle("a.log", ROOM)
    for cycle in range(IN_A_ROW):
        check.check(Report(cycle, cycle * cycle_s, chips=500))
    if refused:
        with pytest.raises(UserError, match="correct the site's degree or chip_period_s"):
            check.check(Report(IN_A_ROW, IN_A_ROW * cycle_s))
    else:
        check.check(Report(IN_A_ROW, IN_A_ROW * cycle_s))


def test_restarts_and_wraps_are_no_other_degree():
    check = RecordedCycle("a.log", ROOM)
    for start in range(6):
        check.check(Report(2**20 - 1, 5.0))
        check.check(Report(0, 5.1))
        check.check(Report(start + 1, 0.001))


def test_a_log_of_another_degree_ends_with_a_sentence(tmp_path):
    path = tmp_path / "a.log"
    other = replace(ROOM, degree=11)
    path.write_text(log_of(range(6)))
    with open_log(path, site=other) as sensor, pytest.raises(UserError, match=r"a\.log: a cycle of the sensor lasts"):
        list(sensor.poses())
