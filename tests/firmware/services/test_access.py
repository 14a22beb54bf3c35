"""A board with a key takes changes only from who knows it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from goldfield_protocol.parameters import PARAMETERS
from tests.firmware.host_rig import ANCHOR, BEACON, MS, SECOND, SENSOR, Board
from tests.firmware.services.access_host import (
    ANSWER,
    CHALLENGE,
    CLEAR,
    IDLE,
    KEY,
    KEY_IDS,
    LOCK,
    LOCKED,
    LONGEST,
    NAMED,
    NO_RANDOM,
    NUMBER,
    OK,
    OK_RESTARTS,
    OTHER_KEY,
    PARAMETER_LOCKED,
    REFUSED,
    RESET,
    SAVE,
    SIGNATURE,
    SLOW,
    START,
    STOP,
    TURN,
    UNIQUE,
    WAIT,
    Host,
    tag,
    words,
)
from tests.firmware.services.saved_flash import SavedFlash
from tests.firmware.services.updated_board import BEGIN, BEGIN_FORCED, END, PAGE

Make = Callable[..., Host]


@pytest.fixture
def host() -> Iterator[Make]:
    made: list[Board] = []

    def make(role: int = BEACON, key: bytes = KEY, *, can: bool = False, **options: object) -> Host:
        page = {"node": 9, "access_key": words(key)} if any(key) else {"node": 9}
        # Without its crystal and its PLL a board has its links alone, and costs little for a minute.
        board = Board(role, page, **{"clock": SLOW, **options})  # type: ignore[arg-type]
        made.append(board)
        return Host(board, can)

    yield make
    for board in made:
        board.close()


# ---- What needs the key ----


def test_a_board_without_a_key_takes_everything_from_anybody(host: Make) -> None:
    board = host(key=bytes(16))
    assert board.changes()
    assert board.command(CHALLENGE) == OK
    assert board.command(RESET, named=0) == REFUSED
    assert [board.get(one) for one in KEY_IDS] == [0, 0, 0, 0]


@pytest.mark.parametrize("can", [False, True])
@pytest.mark.parametrize("role", [BEACON, SENSOR, ANCHOR])
def test_a_locked_board_tells_everything_and_takes_nothing(host: Make, role: int, can: bool) -> None:
    board = host(role, can=can)
    before = board.get(PARAMETERS["group"].first)
    assert board.put(PARAMETERS["group"].first, 7) == (PARAMETER_LOCKED, before)
    for index in (RESET, CLEAR, SAVE, START, SIGNATURE, NUMBER, BEGIN, BEGIN_FORCED, PAGE, END):
        assert board.command(index, 11 if index == NUMBER else 0) == LOCKED
    assert board.command(1, 1) == OK  # It blinks,
    assert board.command(STOP) == OK  # and a stop is always obeyed.
    assert board.send("COMMAND", 0, {"board": 0, "argument": 0})[0].name == "IDENTITY"
    assert board.send("PARAM_DESCRIBE", 54, {"reserved": 0})[0].name == "PARAM_DESCRIPTION"
    assert board.command(99) == 1
    assert board.get(PARAMETERS["node"].first) == 9
    assert not board.changes()


@pytest.mark.parametrize("can", [False, True])
def test_who_knows_the_key_changes_it(host: Make, can: bool) -> None:
    board = host(can=can)
    assert board.unlock() == OK
    assert board.put(PARAMETERS["group"].first, 7) == (0, 7)
    assert board.command(NUMBER, 11) == OK
    assert board.counted() == 0


@pytest.mark.parametrize("unlocked", [False, True])
def test_what_goes_to_all_boards_changes_only_those_that_are_unlocked(host: Make, unlocked: bool) -> None:
    board = host()
    if unlocked:
        assert board.unlock() == OK
    status, value = board.put(PARAMETERS["group"].first, 7, node=0)
    assert (status, value) == ((0, 7) if unlocked else (PARAMETER_LOCKED, 0))
    assert board.command(START, 65535, named=0, node=0) == (REFUSED if unlocked else LOCKED)  # It has no amplitude.
    assert board.command(START, 6, named=0, node=0) is None  # Another group's: it is not meant, and says nothing.
    assert board.command(STOP, 65535, named=0, node=0) == OK


def test_the_other_link_stays_locked(host: Make) -> None:
    serial = host()
    can = serial.on_can()
    assert serial.unlock() == OK
    assert not can.changes()
    assert serial.changes()


# ---- The answer ----


@pytest.mark.parametrize("bit", range(64))
def test_one_wrong_bit_is_wrong(host: Make, bit: int) -> None:
    board = host()
    assert board.answer(tag(board.challenge()) ^ 1 << bit) == REFUSED
    assert not board.changes()
    assert board.counted() == 1


def test_neither_another_key_nor_another_boards_answer_is_taken(host: Make) -> None:
    board = host()
    assert board.unlock(OTHER_KEY) == REFUSED
    board.wait(board.now + SECOND)
    assert board.answer(tag(board.challenge(), unique=bytes([*UNIQUE[:11], 99]))) == REFUSED
    board.wait(board.now + SECOND)
    assert board.unlock() == OK


def test_a_challenge_is_good_for_one_answer(host: Make) -> None:
    board = host()
    number = board.challenge()
    assert board.answer(tag(number)) == OK
    assert board.command(LOCK) == OK
    assert board.answer(tag(number)) is None  # What was heard on the bus is no use.
    fresh = board.challenge()
    assert fresh != number
    assert board.answer(tag(number)) == REFUSED
    assert not board.changes()


def test_an_answer_without_a_challenge_is_ignored_and_not_counted(host: Make) -> None:
    board = host()
    assert board.answer(tag(0)) is None
    assert board.counted() == 0


def test_a_challenge_of_one_link_is_not_answered_on_the_other(host: Make) -> None:
    serial = host()
    number = serial.challenge()
    can = serial.on_can()
    assert can.answer(tag(number)) is None
    assert not can.changes()


@pytest.mark.parametrize(("late", "status"), [(-2 * TURN, OK), (TURN, REFUSED)])
def test_an_answer_has_five_seconds(host: Make, late: int, status: int) -> None:
    board = host()
    number = board.challenge()
    board.wait(board.now + ANSWER + late)
    assert board.answer(tag(number)) == status
    assert board.changes() == (status == OK)
    assert board.counted() == 0


def test_who_asks_again_is_told_the_same_and_cannot_void_it(host: Make) -> None:
    board = host()
    number = board.challenge()
    assert board.challenge() == number
    board.wait(board.now + ANSWER)
    fresh = board.challenge()  # Only when it has expired there is another one.
    assert fresh != number
    assert board.answer(tag(fresh)) == OK


def test_a_challenge_names_its_board(host: Make) -> None:
    board = host()
    for named, node in ((0, 9), (NAMED, 0), (0, 0)):
        assert board.command(CHALLENGE, named=named, node=node) == REFUSED
    assert board.command(CHALLENGE, named=NAMED + 1) is None
    assert board.answer(tag(0)) is None


def test_numbers_differ_between_boards_and_from_time_to_time(host: Make) -> None:
    found = set()
    for last in range(4):
        board = host(unique_id=bytes([*UNIQUE[:11], last]))
        named = NAMED ^ (last ^ 11) << 40
        for _ in range(4):
            (said,) = board.send("COMMAND", CHALLENGE, {"board": named, "argument": 0})
            found.add(board.number_of(said))
            board.wait(board.now + ANSWER)
    assert len(found) == 16


def test_without_a_random_number_nothing_is_unlocked(host: Make) -> None:
    board = host()
    board.board.fail("NO_RANDOM")
    assert board.command(CHALLENGE) == NO_RANDOM
    assert board.answer(tag(0)) is None
    assert not board.changes()
    board.board.fail("NO_RANDOM", active=False)
    assert board.unlock() == OK


# ---- Wrong answers ----


def test_each_wrong_answer_in_a_row_costs_twice_the_wait_up_to_eight_seconds(host: Make) -> None:
    board = host()
    for wait in (250, 500, 1000, 2000, 4000, 8000, 8000):
        assert board.unlock(OTHER_KEY) == REFUSED
        begin = board.now
        assert board.command(CHALLENGE) == WAIT
        board.wait(begin + wait * MS - 2 * TURN)
        assert board.command(CHALLENGE) == WAIT
        board.wait(begin + wait * MS)
    assert board.unlock() == OK
    assert board.counted() == 7
    board.command(LOCK)
    assert board.unlock(OTHER_KEY) == REFUSED
    board.wait(board.now + 250 * MS)  # A right one has ended the row.
    assert board.unlock() == OK


def test_wrong_answers_on_one_link_do_not_keep_the_other_waiting(host: Make) -> None:
    can = host(can=True)
    for _ in range(5):
        can.unlock(OTHER_KEY)
        can.wait(can.now + 8 * SECOND)
    can.unlock(OTHER_KEY)
    assert Host(can.board, clock=can.clock).unlock() == OK


def test_a_wrong_answer_does_not_lock_a_link_that_is_open(host: Make) -> None:
    board = host()
    assert board.unlock() == OK
    assert board.unlock(OTHER_KEY) == REFUSED
    assert board.changes()


# ---- How long ----


@pytest.mark.parametrize(("late", "open_"), [(-2 * TURN, True), (TURN, False)])
def test_a_link_is_open_for_a_minute_behind_the_latest_change(host: Make, late: int, open_: bool) -> None:
    board = host(SENSOR)
    assert board.unlock() == OK
    board.wait(board.now + IDLE // 2)
    assert board.changes()
    board.wait(board.now + IDLE + late)
    assert board.changes() == open_


@pytest.mark.parametrize(("late", "open_"), [(-3 * TURN, True), (TURN, False)])
def test_no_link_is_open_for_more_than_ten_minutes(host: Make, late: int, open_: bool) -> None:
    board = host(SENSOR)
    assert board.unlock() == OK
    begin = board.now
    while board.now < begin + LONGEST - 30 * SECOND:
        board.wait(board.now + 25 * SECOND)
        assert board.changes()
    board.wait(begin + LONGEST + late)
    assert board.changes() == open_


def test_a_lock_and_a_reset_lock_at_once(host: Make) -> None:
    board = host()
    assert board.unlock() == OK
    assert board.command(LOCK) == OK
    assert not board.changes()
    assert board.unlock() == OK
    assert board.command(RESET) == OK
    board.wait(board.now + SECOND)
    assert not board.changes()


# ---- The key itself ----


def test_an_open_board_is_given_a_key_word_by_word(host: Make) -> None:
    board = host(key=bytes(16))
    can = board.on_can()
    for identifier, word in zip(KEY_IDS, words(KEY), strict=True):
        assert board.put(identifier, word) == (0, 1)
        assert not can.changes()
    assert board.command(LOCK) == OK
    assert not board.changes()
    assert board.unlock() == OK
    for identifier in KEY_IDS:
        board.put(identifier, 0)
    assert board.command(LOCK) == OK
    assert board.changes()


def test_a_key_that_is_changed_locks_what_the_old_one_had_opened(host: Make) -> None:
    serial = host()
    can = serial.on_can()
    assert can.unlock() == OK
    assert can.changes()
    number = can.challenge()
    assert serial.unlock() == OK
    serial.put(KEY_IDS[0], 1)
    assert not can.changes()
    assert can.answer(tag(number)) is None


def test_a_key_is_saved_and_holds_behind_a_loss_of_power() -> None:
    flash = SavedFlash()
    board = Host(flash.board(parameters={"node": 9}))
    for identifier, word in zip(KEY_IDS, words(KEY), strict=True):
        board.put(identifier, word)
    board.send("COMMAND", SAVE, {"board": NAMED, "argument": 1})
    board.wait(board.now + SECOND)
    assert [m.signals["status"] for m in board.board.messages("COMMAND_ANSWER")] == [OK_RESTARTS]
    board.board.close()
    again = Host(flash.board(parameters={"node": 9}))
    assert not again.changes()
    assert again.unlock() == OK
    again.board.close()


@pytest.mark.long
def test_no_byte_of_the_key_is_told_by_any_read(host: Make) -> None:
    """Two boards that differ in their keys alone tell the same, whatever is read; and no word of a key is told."""
    said = []
    for key in (KEY, OTHER_KEY):
        board = host(key=key)
        for identifier in range(4096):
            board.board.send_serial("PARAM_GET", {"reserved": 0}, 9, identifier, board.now)
            board.board.send_serial("PARAM_DESCRIBE", {"reserved": 0}, 9, identifier, board.now + MS)
            board.wait(board.now + 3 * MS)
        for index in range(256):
            if index not in (CHALLENGE, RESET):
                board.board.send_serial("COMMAND", {"board": NAMED, "argument": 0}, 9, index, board.now)
                board.wait(board.now + 3 * MS)
        for identifier, word in zip(KEY_IDS, words(key), strict=True):
            board.put(identifier, word)
        names = ("PARAM_VALUE", "PARAM_DESCRIPTION", "PARAM_RANGE", "PARAM_TEXT", "COMMAND_ANSWER", "RESET_REPORT")
        told = [m for m in board.board.messages() if m.name in names]
        assert sum(m.name == "PARAM_VALUE" for m in told) == 4096 + 4
        said.append([(m.name, m.index, dict(m.signals)) for m in told])
    assert said[0] == said[1]
    values = {m[2].get("value_unsigned") for m in said[0]}
    assert values.isdisjoint({*words(KEY)})
