"""A board that chooses between wire and CAN itself: it falls back, returns, and never steps while it is in step."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from goldfield_protocol import encode
from tests.firmware.host_rig import MS, PIN_SYNC_IN, SECOND, SENSOR, Board
from tests.firmware.services.installation import Installation, late_us

MASTER, BEACON, LISTENER = 1, 4, 100
MASTER_PPM = -30.0
AUTOMATIC = 3
SYNC_CHANGES = 21
BY_WIRE, BY_CAN = 1, 2


@pytest.fixture
def made() -> Iterator[Installation]:
    places = {MASTER: (1, 0, MASTER_PPM), BEACON: (0, AUTOMATIC, 25.0), LISTENER: (0, AUTOMATIC, 5.0)}
    installation = Installation(places)
    yield installation
    for place in installation.places.values():
        assert place.board is not None
        place.board.close()


def sources(made: Installation, node: int) -> list[int]:
    return [int(m.signals["source"]) for m in made.messages(node, "CLOCK")]


def followers(made: Installation, **links: int | None) -> None:
    """Cut or mend links of both followers."""
    for node in (BEACON, LISTENER):
        for link, part in links.items():
            setattr(made.places[node], link, part)


def test_falls_back_to_can_and_returns_without_a_step(made: Installation) -> None:
    made.start()
    made.run(2500 * MS)
    origin, before = made.edges[8][0], made.now
    assert sources(made, BEACON)[-1] == sources(made, LISTENER)[-1] == BY_WIRE
    followers(made, wire=None)
    made.run(2600 * MS)
    assert sources(made, BEACON)[-2:] == sources(made, LISTENER)[-2:] == [BY_CAN] * 2
    followers(made, wire=0)
    made.run(800 * MS)
    assert made.counter(BEACON, SYNC_CHANGES) == 1  # Not before ten edges.
    made.run(1800 * MS)
    for node in (BEACON, LISTENER):
        assert sources(made, node)[-1] == BY_WIRE
        assert made.counter(node, SYNC_CHANGES) == 2
        assert set(made.locked(node, 40)) == {1}
        assert made.counter(node, 10) == 0
    late = late_us(made.chip_edges(BEACON, before, made.now), origin * 1e-12, MASTER_PPM)
    assert np.abs(np.diff(late)).max() < 0.05
    assert np.abs(late).max() < 1.0


@pytest.mark.parametrize(("link", "source"), [("wire", BY_CAN), ("can", BY_WIRE)])
def test_starts_with_the_link_that_is_there(made: Installation, link: str, source: int) -> None:
    followers(made, **{link: None})
    made.start()
    made.run(2200 * MS)
    for node in (BEACON, LISTENER):
        assert made.locked(node, 3) == [1, 1, 1]
        assert sources(made, node)[-1] == source
        assert made.counter(node, SYNC_CHANGES) == (1 if source == BY_CAN else 0)


def test_a_noisy_wire_is_left_and_not_taken_again(made: Installation) -> None:
    """Edges at random moments, one in 20 ms, in place of the master's.

    Until the wire is left, an edge of another master might be among them: such cycles are not locked.
    """
    made.start()
    made.run(2500 * MS)
    followers(made, wire=None)
    random = np.random.default_rng(3)
    for _ in range(150):
        at = made.now + int(random.uniform(0.0, 19.0) * MS)
        for node in (BEACON, LISTENER):
            made.board(node).pin(PIN_SYNC_IN, True, at)
            made.board(node).pin(PIN_SYNC_IN, False, at + 97 * 10**6)
        made.run(20 * MS)
    for node in (BEACON, LISTENER):
        assert sources(made, node)[-2:] == [BY_CAN] * 2
        assert made.counter(node, SYNC_CHANGES) == 1
        assert made.locked(node, 28).count(0) <= 3
        assert set(made.locked(node, 20)) == {1}


def test_can_that_tells_another_time_is_not_followed_while_the_lock_holds(made: Installation) -> None:
    """A stranger's SYNC and FOLLOW_UP, whose cycles begin elsewhere, take the place of the master's."""
    made.start()
    made.run(2500 * MS)
    followers(made, wire=None, can=None)
    before = made.now
    for cycle in range(25):
        end = before + cycle * 100 * MS + 30 * MS
        told = {"cycle": 500 + cycle, "chips": 1023, "chip_period": 97750.0, "rank": 1}
        made.inject(*encode("SYNC", told, node=77), end, BEACON)
        ticks = 4_000_000
        made.inject(*encode("FOLLOW_UP", {"cycle": 500 + cycle, "ticks": ticks}, node=77), end + 2 * MS, BEACON)
    made.run(2400 * MS)
    assert sources(made, BEACON)[-1] == BY_WIRE
    assert set(made.locked(BEACON, 20)) == {1}
    assert made.counter(BEACON, SYNC_CHANGES) == 0


def test_with_no_link_the_clock_holds_over_and_any_link_brings_it_back(made: Installation) -> None:
    made.start()
    made.run(2500 * MS)
    followers(made, wire=None, can=None)
    made.run(11 * SECOND)
    assert made.locked(BEACON, 3) == [0, 0, 0]
    errors = [m.signals["error"] for m in made.messages(BEACON, "CLOCK")]
    assert errors[-1] > errors[-8] > errors[2]
    followers(made, can=0)
    made.run(2500 * MS)
    assert made.locked(BEACON, 5) == [1] * 5
    assert sources(made, BEACON)[-1] == BY_CAN


@pytest.mark.parametrize(("setting", "follows"), [({}, True), ({"strongest": 4}, False), ({"degree": 9}, False)])
def test_a_sensor_without_wire_and_can_looks_for_the_field_if_it_knows_codes(
    setting: dict[str, int], follows: bool
) -> None:
    """With strongest and an empty list it has heard none yet, and other degrees than 10 are not for this."""
    codes = {"code_count": 0} if "strongest" in setting else {"code_count": 2, "code_list": [2, 3]}
    board = Board(SENSOR, {"node": 100, "sync_source": AUTOMATIC, **codes, **setting})
    board.run(780 * MS)
    told = [m.signals["value"] for m in board.messages("COUNTER") if m.index == SYNC_CHANGES]
    board.run(2200 * MS)
    after = [m.signals["value"] for m in board.messages("COUNTER") if m.index == SYNC_CHANGES]
    assert not told
    assert bool(after) == follows
    assert {m.signals["locked"] for m in board.messages("CLOCK")} == {0}
    board.close()
