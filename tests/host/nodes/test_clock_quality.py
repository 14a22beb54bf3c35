"""What `CLOCK` tells of a board's time, in values and in words."""

import pytest

from goldfield.nodes.clock_quality import ClockQuality, quality_of
from goldfield_protocol import decode, encode

SIGNALS = {"source": 1, "locked": 1, "rank": 0, "leader": 7, "age": 0.1, "rate": -31250, "error": 140}


def told(**changes):
    message = decode(*encode("CLOCK", SIGNALS | changes, node=3))
    assert message is not None
    return quality_of(message)


def test_values():
    quality = told()
    assert quality == ClockQuality("wire", True, 0, 7, pytest.approx(0.1), pytest.approx(-31.25), pytest.approx(1.4e-7))
    assert list(quality.words) == []


@pytest.mark.parametrize(("error", "known"), [(65534, True), (65535, False)])
def test_an_error_that_is_not_known(error, known):
    assert (told(error=error).error_s is not None) == known


def test_nothing_followed_nobody_known():
    quality = told(source=0, leader=0, locked=0)
    assert (quality.source, quality.leader, quality.locked) == (None, None, False)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"rank": 1}, ["the sync master, follows node 7"]),
        ({"rank": 1, "source": 4, "leader": 3}, []),
        ({"rank": 4}, ["deputy of rank 4, follows node 7"]),
        ({"rank": 4, "source": 0, "leader": 0}, ["deputy of rank 4"]),
        ({"rank": 4, "source": 4, "leader": 3}, ["leads the time as deputy of rank 4"]),
        ({"age": 0.4}, []),
        ({"age": 0.5}, ["holds over without sync for 0.5 s: estimated error 0.14 us"]),
        ({"source": 3, "age": 0.4, "error": 760}, ["takes the time from the beacons' field: estimated error 0.76 us"]),
        ({"source": 3, "age": 0.5}, ["holds over without sync for 0.5 s: estimated error 0.14 us"]),
        ({"age": 25.5, "error": 65535}, ["holds over without sync for 25.5 s or more: estimated error not known"]),
    ],
)
def test_words(changes, words):
    assert list(told(**changes).words) == words
