"""What a search found of some epochs: taken, put, and before anything was found."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from goldfield.locate.fit import Fit
from goldfield.locate.solutions import Solutions, nowhere, unsolved


def fits(start, count):
    number = start + np.arange(count, dtype=float)
    whole = number[:, None, None]
    return Fit(
        number[:, None] * np.ones(3), whole * np.eye(3), number.copy(), whole * np.eye(6), number.astype(int) % 2 == 0
    )


def solutions(start, count):
    """Solutions whose every part tells which it is."""
    number = start + np.arange(count)
    flags = [(number + i) % 2 == 0 for i in range(3)]
    return Solutions(fits(start, count), fits(start + 100, count), *flags, number[:, None, None] * np.eye(6), number)


def same(one, other):
    for field in fields(Solutions):
        mine, wanted = getattr(one, field.name), getattr(other, field.name)
        parts = zip(mine.parts(), wanted.parts(), strict=True) if isinstance(mine, Fit) else [(mine, wanted)]
        for a, b in parts:
            np.testing.assert_array_equal(a, b)


def test_some_epochs_are_taken_and_put():
    whole = solutions(0, 6)
    same(whole.take(np.array([4, 5])), solutions(4, 2))
    whole.put(np.array([1, 2, 3]), solutions(21, 3))
    same(whole.take(np.array([1, 2, 3])), solutions(21, 3))
    same(whole.take(np.array([4, 5])), solutions(4, 2))


def test_poses_that_were_not_found_are_nowhere_at_any_cost():
    found = nowhere(2)
    assert np.isnan(found.position_m).all()
    assert found.position_m.shape == (2, 3)
    assert np.isinf(found.cost).tolist() == [True, True]
    np.testing.assert_array_equal(found.rotation, [np.eye(3)] * 2)
    np.testing.assert_array_equal(found.information, np.zeros((2, 6, 6)))
    assert not found.converged.any()
    found.rotation[0] = 0.0
    np.testing.assert_array_equal(found.rotation[1], np.eye(3))


def test_fits_without_rivals_are_bounded_where_they_did_not_end():
    best = fits(0, 4)
    best.cost[2:] = np.inf
    told = unsolved(best)
    assert told.bounded.tolist() == [False, True, False, False]
    assert not told.contested.any()
    assert not told.outside.any()
    np.testing.assert_array_equal(told.rival.position_m, best.position_m)
    np.testing.assert_array_equal(told.covariance_widening, np.zeros((4, 6, 6)))
    np.testing.assert_array_equal(told.evaluations, np.zeros(4))
