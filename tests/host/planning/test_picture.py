"""The line above the maps of a plan."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.planning import Grid, Request, plan
from goldfield.planning.picture import title
from tests.host.planning.built import cube


@pytest.mark.parametrize(
    ("low_m", "high_m", "words"),
    [
        ((0.5, 0.5), (1.5, 1.5), "8 beacons (outside), 9 points; "),
        ((0.0, 0.0), (1.0, 1.0), "8 beacons (dots: 2, the others are outside of the map), 9 points; "),
        ((0.0, 0.0), (2.13, 2.13), "8 beacons (dots), 25 points; "),
    ],
)
def test_the_title_says_whether_the_beacons_are_on_the_map(low_m, high_m, words):
    grid = Grid.of_box(np.array([*low_m, 1.0]), np.array([*high_m, 1.0]), 0.5)
    assert title(plan(Request(cube(), grid))).startswith(words)
