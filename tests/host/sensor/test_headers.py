"""Headers of one sensor, of two with one number, of one that restarts, and of one whose cycles are numbered anew."""

import pytest

from goldfield.link.reports import CYCLE_MODULUS
from goldfield.sensor.headers import RECENT, SAME_STREAM_CYCLES, SAME_TIME_S, STREAMS, Event, Headers
from tests.host.fake_sensor import CYCLE_S


def events(pairs):
    headers = Headers(CYCLE_S)
    return [headers.take(cycle % CYCLE_MODULUS, time_s) for cycle, time_s in pairs]


def stream(cycles, start_s=0.0):
    return [(cycle, start_s + cycle * CYCLE_S) for cycle in cycles]


def test_one_sensor_goes_on_through_losses_repetitions_late_headers_and_the_wrap():
    assert set(events(stream(range(40)))) == {Event.CONTINUED}
    assert set(events(stream([1, 2, 2, 3, 9, 8, 9, 200]))) == {Event.CONTINUED}
    assert set(events(stream(range(CYCLE_MODULUS - 3, CYCLE_MODULUS + 3)))) == {Event.CONTINUED}


def test_a_clock_400_ppm_off_is_one_stream():
    assert set(events([(cycle, cycle * CYCLE_S * 1.0004) for cycle in range(0, 400, 50)])) == {Event.CONTINUED}


def test_a_restart_is_told_once():
    assert events([*stream(range(50, 53)), *stream(range(53, 56), -53 * CYCLE_S)])[3:] == [
        Event.RESTARTED,
        Event.CONTINUED,
        Event.CONTINUED,
    ]


@pytest.mark.parametrize(("back", "event"), [(RECENT, Event.CONTINUED), (RECENT + 1, Event.RESTARTED)])
def test_a_header_is_late_by_eight_cycles_at_most(back, event):
    assert events([*stream(range(40)), *stream([39 - back])])[-1] is event


@pytest.mark.parametrize("to", [0, 46, 900])
def test_numbers_that_jump_while_time_goes_on_are_told_once(to):
    after = [(to + i, (53 + i) * CYCLE_S) for i in range(3)]
    assert events([*stream(range(50, 53)), *after])[3:] == [Event.RENUMBERED, Event.CONTINUED, Event.CONTINUED]


@pytest.mark.parametrize("apart_s", [-77.7, 0.3 * CYCLE_S, 0.01 * CYCLE_S, 5.2 * CYCLE_S])
def test_two_sensors_are_told_from_their_second_cycle_on(apart_s):
    pairs = [header for cycle in range(100, 106) for header in (*stream([cycle]), *stream([cycle], apart_s))]
    told = events(pairs)
    assert Event.DOUBLED in told[:3]
    assert set(told[3::2]) == {Event.DOUBLED}


def test_two_sensors_of_different_counts():
    pairs = [header for cycle in range(6) for header in (*stream([cycle]), *stream([cycle + 5000], -3.0))]
    assert set(events(pairs)[2:]) == {Event.DOUBLED}


def test_a_cycle_has_one_time_to_ten_microseconds():
    headers = Headers(CYCLE_S)
    headers.take(7, 1.0)
    assert headers.take(7, 1.0 + 0.9 * SAME_TIME_S) is Event.CONTINUED
    assert headers.take(7, 1.0 + 2.1 * SAME_TIME_S) is Event.DOUBLED


@pytest.mark.parametrize(("off", "event"), [(0.99, Event.CONTINUED), (1.01, Event.RENUMBERED)])
def test_a_header_is_of_a_stream_within_a_quarter_of_a_cycle(off, event):
    headers = Headers(CYCLE_S)
    headers.take(7, 1.0)
    assert headers.take(8, 1.0 + (1.0 + off * SAME_STREAM_CYCLES) * CYCLE_S) is event


def test_streams_that_were_left_long_ago_are_forgotten():
    """A return to the oldest that is kept is told as that; the one before is gone, and a new stream."""
    jumps = [(1000 * i, 10.0 + i * CYCLE_S) for i in range(STREAMS)]
    assert events([*jumps, (5, 10.0 + 5 * CYCLE_S)])[-1] is Event.DOUBLED
    assert events([*jumps, (9000, 10.4), (5, 10.0 + 5 * CYCLE_S)])[-1] is Event.RENUMBERED
