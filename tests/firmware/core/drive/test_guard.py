"""What a measured current may be: both sides of each limit, computed here from amperes."""

import math

import pytest

NONE, OVER, EXCESS, OVERLOAD = 0, 1, 5, 6
SENSE_A, REFERENCE_A = 0.125, 0.0625
"""Amperes a count of the sense and of the set-point: their quotients are exact."""
MOST = 4095


class Guard:
    """A guard, configured in amperes."""

    def __init__(self, core, over_A=200.0, rms_A=0.0, rms_chips=1.0):
        self.ffi, self.lib = core
        self.guard = self.ffi.new("guard_t *")
        assert self.configure(over_A, rms_A, rms_chips)

    def configure(self, over_A=200.0, rms_A=0.0, rms_chips=1.0, reference_A=REFERENCE_A):
        config = self.ffi.new("guard_config_t *", [over_A, rms_A, rms_chips])
        return self.lib.guard_configure(self.guard, config, SENSE_A, reference_A)

    def sample(self, asked, came):
        return self.lib.guard_sample(self.guard, asked, came)

    def edge(self, asked, came):
        return self.lib.guard_edge(self.guard, asked, came)


@pytest.mark.parametrize(
    ("limit_A", "most"),
    [
        (10.0, 80),
        (10.124, 80),
        (10.125, 81),
        (0.0, 0),
        (255.625, 2045),
        (255.75, 2046),
        (270.0, 2046),
        (300.0, 2046),
        (1e30, 2046),
    ],
)
def test_over_current_begins_above_the_limit_and_at_the_rails(core, limit_A, most):
    guard = Guard(core, over_A=limit_A)
    for sign in (1, -1):
        for look in (guard.sample, guard.edge):
            assert look(MOST, sign * most) == NONE
            assert look(MOST, sign * (most + 1)) == OVER


@pytest.mark.parametrize(("asked", "most"), [(0, 4), (100, 72), (1000, 691), (1455, 1004)])
def test_excess_is_three_eighths_more_than_asked_and_half_an_ampere(core, asked, most):
    """1.375 times the set-point in counts of the sense, rounded down, and four counts."""
    assert most == math.floor(asked * 1.375 * REFERENCE_A / SENSE_A) + 4
    guard = Guard(core)
    for sign in (1, -1):
        guard.sample(asked, 0)
        guard.sample(asked, 0)
        assert guard.edge(asked, sign * most) == NONE
        assert guard.edge(asked, sign * (most + 1)) == EXCESS
        assert guard.sample(asked, sign * most) == NONE
        assert guard.sample(asked, sign * (most + 1)) == EXCESS


def test_the_chip_before_explains_a_current_and_the_one_before_that_does_not(core):
    guard = Guard(core)
    for asked in (0, 0, 1000):
        guard.sample(asked, 0)
    assert guard.edge(0, 691) == NONE  # The drive was switched off just before the latest sample.
    assert guard.sample(0, 691) == NONE
    assert guard.edge(0, 691) == NONE  # What explained that sample explains what comes behind it.
    assert guard.edge(0, 692) == EXCESS
    assert guard.sample(0, 691) == EXCESS
    assert guard.edge(0, 691) == EXCESS
    assert guard.edge(1000, 691) == NONE
    assert guard.sample(1000, 691) == NONE  # So does what is asked now.


def test_the_first_chip_after_a_reset_is_not_judged_for_excess(core):
    guard = Guard(core)
    assert guard.edge(0, 1500) == NONE
    assert guard.sample(0, 1500) == NONE
    assert guard.sample(0, 5) == EXCESS


def test_the_first_chip_is_explained_by_the_largest_set_point(core):
    """With a set-point of a quarter of the sense's count that is less than the rails."""
    guard = Guard(core)
    guard.guard = guard.ffi.new("guard_t *")
    assert guard.configure(over_A=300.0, reference_A=SENSE_A / 4)
    most = math.floor(MOST * 1.375 / 4) + 4
    assert guard.edge(0, most) == NONE
    assert guard.edge(0, most + 1) == EXCESS


def test_another_configuration_leaves_what_was_asked_and_what_is_hot(core):
    guard = Guard(core, rms_A=5.0, rms_chips=4.0)
    guard.sample(0, 0)
    guard.sample(0, 0)
    guard.sample(1000, 100)
    heat = guard.guard.heat
    assert heat > 0.0
    assert guard.configure(over_A=200.0, rms_A=5.0, rms_chips=4.0)
    assert guard.guard.heat == heat
    assert guard.edge(0, 692) == EXCESS  # It is no first chip again.


@pytest.mark.parametrize(("came", "cause"), [(40, NONE), (41, OVERLOAD), (-40, NONE), (-41, OVERLOAD)])
def test_overload_begins_above_the_square_of_its_limit(core, came, cause):
    """5 A are 40 counts; with a window of one chip the mean square is that of the chip."""
    guard = Guard(core, rms_A=5.0)
    assert guard.sample(MOST, came) == cause
    assert guard.guard.heat == came**2


def test_the_mean_square_follows_over_its_window(core):
    guard, expected = Guard(core, rms_A=5.0, rms_chips=8.0), 0.0
    for number in range(60):
        came = 44 if number % 20 < 12 else -3
        expected += (came**2 - expected) / 8
        assert guard.sample(MOST, came) == (OVERLOAD if expected > 1600 else NONE)
        assert guard.guard.heat == pytest.approx(expected, rel=1e-5)


def test_without_a_limit_of_the_mean_square_nothing_is_overload(core):
    guard = Guard(core, over_A=1e9)
    for _ in range(50):
        assert guard.sample(MOST, 2046) == NONE
    assert guard.configure(over_A=1e9, rms_A=0.125)
    assert guard.sample(MOST, 2) == OVERLOAD


def test_over_current_comes_before_excess_and_excess_before_overload(core):
    guard = Guard(core, over_A=100.0, rms_A=1.0)
    guard.sample(0, 0)
    guard.sample(0, 0)
    assert guard.sample(0, 801) == OVER
    assert guard.sample(0, 800) == EXCESS
    assert guard.sample(MOST, 800) == OVERLOAD


@pytest.mark.parametrize(
    ("over_A", "rms_A", "rms_chips", "taken"),
    [
        (0.0, 0.0, 1.0, True),
        (-0.1, 0.0, 1.0, False),
        (math.nan, 0.0, 1.0, False),
        (10.0, -0.1, 1.0, False),
        (10.0, math.nan, 1.0, False),
        (10.0, 0.0, 0.99, False),
        (10.0, 0.0, math.nan, False),
    ],
)
def test_a_value_out_of_range_is_refused_and_nothing_is_done(core, over_A, rms_A, rms_chips, taken):
    guard = Guard(core, over_A=50.0)
    assert guard.configure(over_A, rms_A, rms_chips) == taken
    assert guard.sample(MOST, 400) == (OVER if taken else NONE)


@pytest.mark.parametrize("came", [-1, 0, 1])
def test_the_least_currents_are_none(core, came):
    guard = Guard(core, rms_A=0.125)
    guard.sample(0, 0)
    assert guard.edge(0, came) == NONE
    assert guard.sample(0, came) == NONE
    assert guard.guard.heat == came**2
