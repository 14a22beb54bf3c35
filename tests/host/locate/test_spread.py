"""How well coils are spread, against their singular values, on both sides of both limits."""

import numpy as np
import pytest

from goldfield.locate.spread import SPREAD, Spread


def seen_well(centre_m, position_m):
    """The same by the singular values of the places, which are the root mean square extents times the root of n."""
    middle = centre_m.mean(axis=0)
    first, second, _ = np.linalg.svd(centre_m - middle, compute_uv=False) / np.sqrt(len(centre_m))
    return second >= SPREAD * max(first, np.linalg.norm(position_m - middle))


def test_some_and_all_coils_are_judged_as_by_their_singular_values():
    random = np.random.default_rng(4)
    centre_m = random.normal(size=(8, 3)) * [1.5, 0.8, 0.4]
    some = random.random((400, 8)) < 0.85
    some[::3] = True
    some = some[some.sum(axis=1) >= 3]
    position_m = random.normal(size=(len(some), 3)) * 1.5
    expected = [seen_well(centre_m[row], place) for row, place in zip(some, position_m, strict=True)]
    assert 0.2 < np.mean(expected) < 0.8
    assert Spread(centre_m).good(some, position_m).tolist() == expected


@pytest.mark.parametrize(("share", "good"), [(0.99, False), (1.01, True)])
def test_a_line_is_told_by_its_width(share, good):
    """Four coils 2 m long and 2 SPREAD m wide, less or more by 1 %."""
    width = share * SPREAD
    centre_m = np.array([[x, y, 0.0] for x in (-1.0, 1.0) for y in (-width, width)])
    whole, one = np.ones((1, 4), dtype=bool), np.zeros((1, 3))
    assert Spread(centre_m).good(whole, one).tolist() == [good]


@pytest.mark.parametrize(("share", "good"), [(0.99, True), (1.01, False)])
def test_a_point_is_told_by_the_distance(share, good):
    """The corners of a cube of 2 m have extents of 1 m each."""
    centre_m = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    position_m = np.array([[0.0, share / SPREAD, 0.0]])
    assert Spread(centre_m).good(np.ones((1, 8), dtype=bool), position_m).tolist() == [good]
