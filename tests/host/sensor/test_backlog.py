"""What a live run lets go when it falls behind: by a clock that the test sets."""

import math

from goldfield.sensor.backlog import AT_FIRST_S, CAUGHT_UP_S, LIMIT_S, Backlog


def waited(*times_s):
    """Tell which of successive messages are let go that have waited for so long."""
    backlog = Backlog(lambda: 1000.0)
    return [backlog.lets_go(1000.0 - waited_s) for waited_s in times_s], backlog


def test_from_the_limit_on_all_is_let_go_until_what_comes_is_of_late():
    found, backlog = waited(0.0, 0.99 * LIMIT_S, 1.01 * LIMIT_S, 1.01 * CAUGHT_UP_S, 0.99 * CAUGHT_UP_S, 0.99 * LIMIT_S)
    assert found == [False, False, True, True, False, False]
    assert backlog.let_go == 2
    assert [backlog.broke(), backlog.broke()] == [True, False]


def test_what_came_while_the_sensor_was_looked_for_is_worked_off():
    assert waited(0.99 * AT_FIRST_S, 1.01 * LIMIT_S, 0.99 * CAUGHT_UP_S, 1.01 * LIMIT_S)[0] == [
        False,
        False,
        False,
        True,
    ]
    assert waited(1.01 * AT_FIRST_S, 1.01 * CAUGHT_UP_S)[0] == [True, True], "a machine that is too slow from the start"


def test_a_time_that_is_not_known_is_never_long_ago():
    found, backlog = waited(0.0, math.nan, 1.01 * LIMIT_S, math.nan, 1.01 * CAUGHT_UP_S)
    assert found == [False, False, True, False, True]
    assert backlog.let_go == 2
