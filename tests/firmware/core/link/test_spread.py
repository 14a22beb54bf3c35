"""Where in a period a board speaks: each in a place that exists, and neighbours apart, by exhaustion."""

from __future__ import annotations

import pytest

NODES = range(1, 4096)


def places_of(core, nodes, places):
    _, lib = core
    return [lib.spread_place(node, places) for node in nodes]


def apart(a, b, places):
    """Distance of two places in a period that goes round, in places."""
    return min((a - b) % places, (b - a) % places)


@pytest.mark.parametrize("places", [1, 2, 3, 31, 32, 33, 66, 99])
def test_every_place_exists_and_is_as_full_as_any(core, places):
    found = places_of(core, NODES, places)
    odd = places if places % 2 else places - 1
    counts = [found.count(place) for place in range(places)]
    assert sum(counts) == len(NODES)
    assert max(counts[:odd]) - min(counts[:odd]) <= 1
    assert sum(counts[odd:]) == 0


@pytest.mark.parametrize(("places", "alone", "gap"), [(31, 31, 15), (32, 31, 15), (33, 33, 16), (66, 65, 32)])
def test_boards_in_a_row_are_alone_and_half_as_many_leave_a_place_between(core, places, alone, gap):
    found = places_of(core, NODES, places)
    for first in range(len(found) - alone):
        row = found[first : first + alone]
        assert len(set(row)) == alone
        assert all(apart(row[0], other, places) >= 2 for other in row[1:gap])
    assert apart(found[0], found[gap], places) < 2
