"""A request of values that are none is refused where it is made, in a sentence."""

from __future__ import annotations

import numpy as np
import pytest

from goldfield.errors import UserError
from goldfield.planning import Grid, Request, Settings, plan
from tests.host.planning.built import cube


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"truncation": float("nan")}, "truncation=nan is no part of 0 to below 1"),
        ({"truncation": 1.0}, "truncation=1.0 is no part"),
        ({"truncation": "0.1"}, "truncation=0.1 is no part"),
        ({"best": 0}, "best=0 is no whole number of at least 1"),
        ({"best": 2.5}, "best=2.5 is no whole number"),
        ({"conflict_dB": float("inf")}, "conflict_dB=inf is no ratio of fields"),
        ({"conflict_dB": 1000.5}, "conflict_dB=1000.5 is no ratio of fields"),
        ({"conflict_dB": -1000.5}, "conflict_dB=-1000.5 is no ratio of fields"),
    ],
)
def test_settings_that_are_none(changes, words):
    with pytest.raises(UserError, match=words):
        Settings(**changes)


@pytest.mark.parametrize(("conflict_dB", "codes"), [(1000.0, 8), (-1000.0, 1)])
def test_the_largest_ratios_of_fields_are_ratios(conflict_dB, codes):
    """All beacons disturb all others, or none does: no pair is of a beacon and itself."""
    request = Request(cube(), Grid.of_box(np.full(3, 0.9), np.full(3, 0.9), 1.0), Settings(conflict_dB=conflict_dB))
    maps = plan(request)
    assert maps.shared_code.max() + 1 == codes
    assert (maps.conflicts.pair[:, 0] != maps.conflicts.pair[:, 1]).all()


def test_settings_of_numpy_are_settings():
    assert Settings(best=np.int64(3), truncation=np.float64(0.0)).best == 3


def test_requests_of_other_things():
    grid = Grid.of_box(np.zeros(3), np.ones(3), 1.0)
    with pytest.raises(UserError, match="site= of Request is a Site, not 'x'"):
        Request("x", grid)
    with pytest.raises(UserError, match="grid= of Request is a Grid"):
        Request(cube(), [0.0, 1.0])
    with pytest.raises(UserError, match=r"plan\(\) takes a Request"):
        plan("x")
