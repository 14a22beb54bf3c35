"""Who leads the time: deputies that take over, masters that return, two that lead, and strangers on the bus."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from goldfield_protocol import encode
from tests.firmware.host_rig import BEACON, CHIPS, MS, PIN_SYNC_OUT, SECOND, SENSOR, Board, Rig, chip_seconds
from tests.firmware.services.installation import Installation, late_us

OTHER_DEGREE, OTHER_MASTERS = 14, 17
WIRE, CAN = 0, 2
HIGHEST_STEP_US = 1.0
MASTER, FIRST, SECOND_DEPUTY, PLAIN, LISTENER = 1, 2, 3, 4, 100
MASTER_PPM = -30.0


def counters(board: Board) -> dict[int, float]:
    return {m.index: m.signals["value"] for m in board.messages("COUNTER")}


def installation(source: int, *nodes: int, **extra: float) -> Installation:
    """A master, two deputies, a beacon and a sensor, or some of them, in step."""
    all_places = {
        MASTER: (1, source, MASTER_PPM),
        FIRST: (2, source, 40.0),
        SECOND_DEPUTY: (3, source, 10.0),
        PLAIN: (0, source, 25.0),
        LISTENER: (0, source, 5.0),
    }
    return Installation({node: all_places[node] for node in nodes or all_places}, extra)


def in_step(made: Installation) -> int:
    """Start all boards at once and run until they are in step; return when the master began some cycle."""
    made.start()
    made.run(round(1.95 * SECOND))
    assert all(made.locked(node, 3) == [1, 1, 1] for node in made.places)
    return made.edges[5][0]


def close(made: Installation) -> None:
    for place in made.places.values():
        for board in [*place.past, *([place.board] if place.board else [])]:
            board.close()


@pytest.fixture(params=[WIRE, CAN], ids=["wire", "CAN"])
def source(request: pytest.FixtureRequest) -> int:
    return int(request.param)


def steps_us(made: Installation, node: int, since: int, origin: int) -> tuple[float, float]:
    """Largest step from one chip edge to the next, and largest distance from the dead master's time line."""
    late = late_us(made.chip_edges(node, since, made.now), origin * 1e-12, MASTER_PPM)
    assert len(late) > 1000
    return float(np.abs(np.diff(late)).max()), float(np.abs(late).max())


# ---- A leader dies ----


def test_the_first_deputy_takes_over_and_nobody_steps(source: int) -> None:
    made = installation(source)
    origin = in_step(made)
    before = made.now
    made.run(63 * MS)
    died = made.now
    made.kill(MASTER)
    made.run(2 * SECOND)
    assert made.leaders(died) == made.drivers(died) == {FIRST}
    first = min(time for time, _ in made.edges if time > died)
    assert first - died < 400 * MS
    for node in (FIRST, SECOND_DEPUTY, PLAIN):
        step, distance = steps_us(made, node, before, origin)
        assert step < 0.05
        assert distance < HIGHEST_STEP_US
    for node in (FIRST, SECOND_DEPUTY, PLAIN, LISTENER):
        assert set(made.locked(node, 20)) == {1}
        assert made.counter(node, 10) == 0
    cycles = [int(m.signals["cycle"]) for m in made.messages(LISTENER, "EPOCH")][-25:]
    assert cycles == list(range(cycles[0], cycles[0] + 25))
    numbers = [int(m.signals["cycle"]) for _, _, m in made.frames if m.name == "SYNC"]
    assert numbers == sorted(set(numbers))
    close(made)


def test_deputies_take_over_one_after_the_other_and_the_master_that_returns_follows(source: int) -> None:
    made = installation(source, MASTER, FIRST, SECOND_DEPUTY, PLAIN)
    origin = in_step(made)
    before = made.now
    for node, heir in ((MASTER, FIRST), (FIRST, SECOND_DEPUTY)):
        died = made.now
        made.kill(node)
        made.run(SECOND)
        assert made.leaders(died) == made.drivers(died) == {heir}
    made.start(MASTER)
    made.run(2 * SECOND)
    died = made.now
    assert made.leaders(before + 2 * SECOND) == {SECOND_DEPUTY}
    assert made.locked(MASTER, 5) == [1] * 5
    made.kill(SECOND_DEPUTY)  # Now the first rank has the shortest wait.
    made.run(SECOND)
    assert made.leaders(died) == made.drivers(died) == {MASTER}
    step, distance = steps_us(made, PLAIN, before, origin)
    assert step < 0.05
    assert distance < HIGHEST_STEP_US
    assert set(made.locked(PLAIN, 45)) == {1}
    close(made)


def test_of_two_deputies_of_one_rank_the_higher_number_steps_back_in_step(source: int) -> None:
    made = installation(source, MASTER, FIRST, SECOND_DEPUTY, PLAIN)
    made.places[SECOND_DEPUTY].rank = 2
    origin = in_step(made)
    before = made.now
    made.kill(MASTER)
    made.run(2 * SECOND)
    assert made.leaders(before) == {FIRST, SECOND_DEPUTY}
    assert made.leaders(before + SECOND) == made.drivers(before + SECOND) == {FIRST}
    for node in (FIRST, SECOND_DEPUTY, PLAIN):
        assert steps_us(made, node, before, origin)[1] < HIGHEST_STEP_US
        assert set(made.locked(node, 20)) == {1}
    close(made)


def test_a_deputy_that_is_not_in_step_yet_lets_the_others_lead(source: int) -> None:
    """The first deputy gets its power just before the master loses its."""
    made = installation(source, MASTER, FIRST, SECOND_DEPUTY, PLAIN)
    made.start(MASTER, SECOND_DEPUTY, PLAIN)
    made.run(2 * SECOND)
    made.start(FIRST)
    made.run(150 * MS)
    died = made.now
    made.kill(MASTER)
    made.run(2 * SECOND)
    assert made.leaders(died) == {SECOND_DEPUTY}
    assert set(made.locked(PLAIN, 20)) == {1}
    assert made.locked(FIRST, 5) == [1] * 5
    close(made)


def test_a_master_that_restarts_where_others_are_in_step_waits_for_their_deputy(source: int) -> None:
    """It is back after 10 ms, and the only deputy has the last rank."""
    made = installation(source, MASTER, SECOND_DEPUTY, PLAIN)
    made.places[SECOND_DEPUTY].rank = 15
    in_step(made)
    died = made.now
    made.kill(MASTER)
    made.start(MASTER, at=died + 10 * MS)
    made.run(3 * SECOND)
    assert made.leaders(died) == {SECOND_DEPUTY}
    assert min(time for time, _ in made.edges if time > died) - died < 1000 * MS
    assert set(made.locked(PLAIN, 25)) == {1}
    assert made.locked(MASTER, 5) == [1] * 5
    close(made)


# ---- Links that break ----


@pytest.mark.parametrize("broken", ["wire", "can"])
def test_a_deputy_with_one_broken_link_makes_no_second_leader(broken: str) -> None:
    made = installation(WIRE if broken == "can" else CAN, MASTER, FIRST, PLAIN)
    in_step(made)
    setattr(made.places[FIRST], broken, None)
    before = made.now
    made.run(3 * SECOND)
    assert made.leaders(before) == {MASTER}
    assert made.drivers(before) == {MASTER}
    close(made)


def test_a_deputy_whose_wire_is_cut_does_not_lead_though_it_follows_the_wire() -> None:
    """It holds over and lets its coil go at the end: the other parts of the installation are in order."""
    made = installation(WIRE, MASTER, FIRST, PLAIN)
    in_step(made)
    made.places[FIRST].wire = None
    before = made.now
    made.run(12 * SECOND)
    assert made.leaders(before) == made.drivers(before) == {MASTER}
    assert made.locked(FIRST, 3) == [0, 0, 0]
    assert set(made.locked(PLAIN, 100)) == {1}
    close(made)


@pytest.mark.parametrize("ran_apart", [False, True])
def test_two_parts_that_were_split_and_are_joined(source: int, ran_apart: bool) -> None:
    """Either part has a leader. The deputy's has the master's time, or, once it was restarted, one of its own."""
    made = installation(source, MASTER, FIRST, PLAIN)
    in_step(made)
    for node in (FIRST, PLAIN):
        made.places[node].wire = made.places[node].can = 1
    split = made.now
    made.run(SECOND)
    assert made.leaders(split + 500 * MS) == {MASTER, FIRST}
    if ran_apart:
        made.kill(FIRST)
        made.kill(PLAIN)
        made.start(FIRST, PLAIN)
        made.run(3 * SECOND)
    for node in (FIRST, PLAIN):
        made.places[node].wire = made.places[node].can = 0
    joined = made.now
    made.run(3 * SECOND)
    assert made.leaders(joined + SECOND) == made.drivers(joined + SECOND) == {MASTER}
    assert made.counter(MASTER, OTHER_MASTERS) >= 1
    assert made.counter(FIRST, OTHER_MASTERS) >= 3
    for node in (FIRST, PLAIN):
        assert (0 not in made.locked(node, 28)) != ran_apart
        assert made.locked(node, 5) == [1] * 5
    assert int(made.messages(MASTER, "SYNC")[-1].signals["cycle"]) > 50
    close(made)


# ---- Strangers ----


@pytest.fixture
def lone() -> Iterator[Board]:
    board = Board(BEACON, {"node": 4, "sync_master": 2, "sync_source": WIRE})
    yield board
    board.close()


PERIOD = round(CHIPS * chip_seconds(0.0) * 1e12)


def lead(board: Board, cycles: range, start: int, node: int = 1, number: int = 0) -> int:
    """Drive the wire and send SYNC for some cycles; return when the next would begin."""
    for cycle in cycles:
        board.sync_pulse(start + cycle * PERIOD)
        told = {"cycle": (number + cycle) % 2**20, "chips": CHIPS, "chip_period": 97750.0, "rank": 1}
        board.can_in(*encode("SYNC", told, node=node), start + cycle * PERIOD + 3 * MS)
    return start + (cycles.stop) * PERIOD


def test_numbers_go_on_over_the_wrap_at_20_bits(lone: Board) -> None:
    end = lead(lone, range(20), 30 * MS, number=2**20 - 22)
    lone.run(end + SECOND)
    edges = [time for time in lone.edges(PIN_SYNC_OUT) if time > 500 * MS]
    told = [int(m.signals["cycle"]) for m in lone.messages("SYNC")]
    assert told == [2**20 - 1, *range(len(told) - 1)]  # The first is told at once, in the cycle that has begun.
    assert abs(edges[0] - (end + 2 * PERIOD)) < 200_000  # 0.2 us
    assert len(told) in (len(edges), len(edges) + 1)


@pytest.mark.parametrize(("number", "leads"), [(0, False), (3, True), (500_000, True), (-3, True)])
def test_sync_of_a_stranger_does_not_keep_a_deputy_from_leading(lone: Board, number: int, leads: bool) -> None:
    """Behind the dead master's last edge messages go on with other numbers, or (the first row) with its own."""
    end = lead(lone, range(20), 30 * MS, number=100)
    for cycle in range(20, 32):
        told = {"cycle": 100 + cycle + number, "chips": CHIPS, "chip_period": 97750.0, "rank": 1}
        lone.can_in(*encode("SYNC", told, node=77), 30 * MS + cycle * PERIOD + 3 * MS)
    lone.run(end + SECOND)
    assert bool(lone.edges(PIN_SYNC_OUT)) == leads


def test_a_flood_of_sync_does_not_make_a_leader_step_back(lone: Board) -> None:
    random = np.random.default_rng(8)
    at = SECOND
    while at < 2 * SECOND:
        told = {"cycle": int(random.integers(2**20)), "chips": CHIPS, "chip_period": 97750.0, "rank": 1}
        lone.can_in(*encode("SYNC", told, node=int(random.integers(1, 4))), at)
        at += int(random.uniform(0.2, 5.0) * MS)
    lone.run(3 * SECOND)
    edges = lone.edges(PIN_SYNC_OUT)
    assert len(edges) == len(range(edges[0], 3 * SECOND, PERIOD))
    assert np.abs(np.diff(edges) - PERIOD).max() < 100_000
    assert counters(lone)[OTHER_MASTERS] > 200


@pytest.mark.parametrize(("node", "keeps"), [(5, True), (3, False)])
@pytest.mark.parametrize("count", [2, 3])
def test_one_stray_sync_makes_no_master_step_back(node: int, keeps: bool, count: int) -> None:
    board = Board(BEACON, {"node": 4, "sync_master": 1})
    signals = {"chips": CHIPS, "chip_period": 97750.0, "rank": 1}
    for number in range(count):
        told = encode("SYNC", {"cycle": 70 + number, **signals}, node=node)
        board.can_in(*told, 500 * MS + number * 100 * MS)
    late = encode("SYNC", {"cycle": 99, **signals}, node=node)
    board.can_in(*late, 500 * MS + (count - 1) * 100 * MS + 1100 * MS)
    board.run(3 * SECOND)
    edges = board.edges(PIN_SYNC_OUT)
    assert max(edges) > 2800 * MS  # The stranger is silent again, and the board leads again.
    assert (max(np.diff(edges)) > 250 * MS) == (not keeps and count == 3)
    assert counters(board)[OTHER_MASTERS] >= 2
    board.close()


@pytest.mark.parametrize("clock", [0, 1])
def test_a_board_without_its_crystal_never_leads(clock: int) -> None:
    board = Board(BEACON, {"node": 4, "sync_master": 1}, clock=clock)
    board.run(2 * SECOND)
    assert bool(board.edges(PIN_SYNC_OUT)) == (clock == 0)
    board.close()


@pytest.mark.parametrize(
    ("rank", "degree", "least_ms"), [(1, 10, 225), (2, 10, 275), (15, 10, 925), (1, 5, 218), (1, 11, 450)]
)
def test_a_lone_board_leads_after_its_wait(rank: int, degree: int, least_ms: int) -> None:
    parameters = {"node": 4, "sync_master": rank, "degree": degree}
    board = Board(BEACON, parameters)
    board.run(1500 * MS)
    first, *_ = board.edges(PIN_SYNC_OUT)
    assert 0 <= first - least_ms * MS < 15 * MS
    assert int(board.messages("SYNC")[0].signals["cycle"]) == 0
    board.close()


@pytest.mark.parametrize("sound", [True, False])
def test_a_master_of_another_degree_disturbs_only_a_wire_without_a_sound_master(sound: bool) -> None:
    """Its messages come between those of the wire's master, or alone."""
    head = Board(BEACON, {"node": 1, "sync_master": 1}, can=sound)
    sensor = Board(SENSOR, {"node": 100, "code_count": 0})
    for number in range(40):
        signals = {"cycle": number, "chips": 2047, "chip_period": 97750.0, "rank": 1}
        sensor.can_in(*encode("SYNC", signals, node=7), 1037 * MS + number * 90 * MS)
    Rig(head, sensor).run(4600 * MS)
    locked = [m.signals["locked"] for m in sensor.messages("EPOCH_STATUS")]
    cycles = [m.signals["cycle"] for m in sensor.messages("EPOCH")]
    assert counters(sensor)[OTHER_DEGREE] >= 30
    if sound:
        assert locked[-36:] == [1] * 36
        assert cycles[-36:] == list(range(int(cycles[-1]) - 35, int(cycles[-1]) + 1))
    else:
        assert locked[-25:] == [0] * 25
    for board in (head, sensor):
        board.close()
