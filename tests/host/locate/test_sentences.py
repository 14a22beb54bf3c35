"""What is said of a pose: both sides of each figure that changes the words."""

from __future__ import annotations

import math

import numpy as np
import pytest

from goldfield.locate import sentences


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (0.019, "the sensor's y axis shows nothing: check its wiring"),
        (-0.019, "the sensor's y axis shows nothing: check its wiring"),
        (0.0212, "the sensor's y axis shows 0.0212 times the field: check its gain"),
        (-1.019, "the sensor's y axis is reversed: check its wiring"),
        (-0.981, "the sensor's y axis is reversed: check its wiring"),
        (-1.0212, "the sensor's y axis shows -1.02 times the field: check its gain"),
        (-0.9788, "the sensor's y axis shows -0.979 times the field: check its gain"),
        (1.0, "the sensor's y axis shows 1 times the field: check its gain"),
    ],
)
def test_an_axis_is_silent_or_reversed_to_a_fiftieth(factor, said):
    assert sentences.axis_gain("y", factor) == said


@pytest.mark.parametrize(
    ("heard", "said"),
    [
        (0, "no beacons were heard, a pose needs 3"),
        (1, "1 beacon was heard, a pose needs 3"),
        (2, "2 beacons were heard, a pose needs 3"),
    ],
)
def test_how_many_were_heard(heard, said):
    assert sentences.few_heard(heard, 3) == said


def test_how_many_components_were_measured():
    assert sentences.few_components(1, 5) == "1 component was measured, a pose needs 5"
    assert sentences.few_components(4, 5) == "4 components were measured, a pose needs 5"


def test_what_explains_fields_of_no_place_is_told_behind_it():
    assert sentences.unheard(None) == sentences.UNHEARD
    assert sentences.unheard("b3 is dead") == f"{sentences.UNHEARD}; b3 is dead"


def test_an_error_that_nothing_bounds_is_any():
    assert sentences.unverified("b1", 1.234, 0.5) == (
        "a fault of b1 could hide an error of 1.23 m; the alert limit is 0.50 m"
    )
    assert sentences.unverified("b1", math.inf, 0.5) == (
        "a fault of b1 could hide any error; the alert limit is 0.50 m"
    )


def test_several_are_told_one_after_another():
    assert sentences.left_out(["b1 is dead", "b2 is reversed"]) == "left out: b1 is dead; b2 is reversed"
    assert sentences.not_sure(["a", "b"]) == "no pose fits all fields; it may be that a, or that b"
    assert "gains 0.5, 1, 2 along" in sentences.distorted(np.array([0.5, 1.0, 2.0]))
    assert "(1.00, -2.50, 0.12) m" in sentences.ambiguous(np.array([1.0, -2.5, 0.123]))
