"""The store against flash that loses its power at every step, in the middle of words and erasures too."""

import zlib

import numpy as np
import pytest

from tests.firmware.core.storage.flash_cells import ONES, Torn
from tests.firmware.core.storage.store_board import (
    COMMIT,
    SETTLED,
    WORDS,
    Board,
    PowerLost,
    a_set,
    filled,
    forged,
    fresh,
    head,
    record,
)

SAVES = 6
STEPS = 85
"""So many steps and some more are those of `SAVES` saves: erasures of both slots are among them."""


def cut_boards(core, torn, seeds):
    """Yield for each step of some saves boards that lost their power in it, the old set and the new one, and an id."""
    for cut in range(STEPS):
        for seed in range(seeds):
            board = Board(core, seed)
            board.start()
            board.work()
            board.cut, board.torn, old = cut, torn, None
            for number in range(SAVES):
                try:
                    assert board.save(a_set(number))
                except PowerLost:
                    yield board, (old, a_set(number)), f"cut {cut}, seed {seed}"
                    break
                old = a_set(number)


def test_the_power_goes_at_every_step_of_the_saves(core):
    board = fresh(core)
    for number in range(SAVES):
        assert board.save(a_set(number))
    assert STEPS <= board.steps <= STEPS + 20
    assert board.wear(0) + board.wear(1) > 3


def mend(board, cut):
    """Mend a board whose power goes at a step; return whether it came to the end."""
    board.steps, board.cut = 0, cut
    try:
        board.work()
    except PowerLost:
        return False
    board.cut = None
    return True


@pytest.mark.parametrize("torn", Torn)
def test_the_old_set_or_the_new_one_is_there_whenever_the_power_goes(core, torn):
    """After the loss the board is mended, with a second loss at every step of that; nothing comes back later."""
    mended, cases = Board(core, 77), 0
    mended.torn = torn
    for board, sets, case in cut_boards(core, torn, seeds=3):
        for again in range(20):
            cases += 1
            board.cells.copy_to(mended.cells)
            for _ in range(3):
                assert mended.start() in sets, case
            whole = mend(mended, again)
            if not whole:
                for _ in range(3):
                    assert mended.start() in sets, f"{case}, again {again}"
                assert mend(mended, None)
            settled = mended.read()
            for number in (100, 101, 102):
                for _ in range(3):
                    assert mended.start() == settled, f"{case}, again {again}"
                mended.work()
                settled = a_set(number)
                assert mended.save(settled), f"{case}, again {again}"
            if whole:
                break
        assert whole
    print(f"{torn.name}: {cases} losses of power and second losses, 0 boards with neither set")
    assert cases > STEPS


CHOSEN = 3
"""Place, in a set, of words that somebody has chosen, as those of a name."""


def begun(core, torn, seed):
    """Return a board that has saved (1, 2, 3), and is to lose its power within the next save, at a step."""
    board = Board(core, seed, WORDS)
    board.start()
    board.work()
    assert board.save((1, 2, 3))
    board.torn = torn
    return board


def lose(board, step, values):
    """Let the power go at a step of a save; return whether there is such a step."""
    board.cut = board.steps + step
    try:
        assert board.save(values)
    except PowerLost:
        return True
    board.cut = None
    return False


@pytest.mark.parametrize("torn", Torn)
@pytest.mark.parametrize("word", range(4))
def test_chosen_words_of_which_one_is_torn_make_no_record(core, torn, word):
    """But for a bit of one word they are a record; while that word is programmed this bit may be there still."""
    seed = 0
    for bit in [bit for bit in range(32) if forged()[word] >> bit & 1][:5]:
        spoilt = forged()[word] & ~(1 << bit)
        chosen = (*range(CHOSEN), *forged()[:word], spoilt, *forged()[word + 1 :], 5)
        for step in [*range(2, 18), *(100 * [3 + CHOSEN + word])]:
            seed += 1
            board = begun(core, torn, seed)
            lost = lose(board, step, chosen)
            for _ in range(6):
                assert board.start() in (((1, 2, 3), chosen) if lost else (chosen,)), (bit, step)
            board.work()
            settled = board.read()
            assert settled in ((1, 2, 3), chosen)
            assert board.save((4, 5))
            assert board.start() == (4, 5), (bit, step)


def completing(core, board, head, place):
    """Return a set that completes a record whose head the set before has begun at a place, or None."""
    trial = Board(core, 5, WORDS)
    board.cells.copy_to(trial.cells)
    trial.start()
    trial.work()
    dummy = tuple(0x1000 + i for i in range(7))
    assert trial.save(dummy)
    words = list(trial.cells.read[0])
    words[place] = head
    end = place + (head & 0xFFFF) + 2
    if words[end : end + 2] != list(dummy[CHOSEN : CHOSEN + 2]):
        return None
    crc = zlib.crc32(np.array(words[place:end], np.uint32).tobytes())
    return (*dummy[:CHOSEN], crc, COMMIT, *dummy[CHOSEN + 2 :])


@pytest.mark.parametrize("torn", Torn)
def test_chosen_words_of_two_interrupted_saves_make_no_record(core, torn):
    """The first set has the head of a record, the second its CRC and commit word; both saves are cut, at each step."""
    old, place, found = (1, 2, 3), 13 + 2 + CHOSEN, set()
    for step in range(2, 13):
        for reach in range(5, 14):
            head = 0x47520000 | reach
            first = (0xA, 0xB, 0xC, head, 0xD, 0xE, 0xF)
            board = begun(core, torn, 31 * step + reach)
            assert lose(board, step, first)
            second = completing(core, board, head, place)
            if second is None:
                continue
            found.add(step)
            for again in range(16):
                trial = Board(core, 100 * step + again, WORDS)
                board.cells.copy_to(trial.cells)
                trial.torn = torn
                assert trial.start() in (old, first)
                trial.work()
                settled = trial.read()
                assert settled in (old, first)
                lost = lose(trial, again, second)
                for _ in range(4):
                    assert trial.start() in ((settled, second) if lost else (second,)), (step, reach, again)
                trial.work()
                for number in (100, 101):
                    assert trial.save(a_set(number)), (step, reach, again)
                    for _ in range(2):
                        assert trial.start() == a_set(number), (step, reach, again)
                    trial.work()
    assert {7, 8, 9} <= found  # Before the step in which the head is programmed, in it, and behind it.


def test_nothing_comes_back_of_a_slot_that_is_being_erased(core):
    """The head of the first of two records is gone already; in what they hold is a third one."""
    board = begun(core, Torn.NOT, 3)
    place, reach = 13 + 2 + CHOSEN, 11
    first = (0xA, 0xB, 0xC, 0x47520000 | reach, 77, 0xE, 0xF)
    assert board.save(first)
    second = completing(core, board, 0x47520000 | reach, place)
    assert second is not None
    assert board.save(second)
    kept, lib, ffi = second, core[1], core[0]
    for number in range(20):
        values = ffi.new("uint32_t[]", a_set(number))
        assert lib.store_save(board._store, values, len(a_set(number)))
        while (step := lib.store_next(board._store)).kind == lib.STORE_PROGRAM:
            board.cells.program(step.slot, step.index, step.value)
        if step.kind == lib.STORE_ERASE and step.slot == 0:
            break
        if step.kind == lib.STORE_ERASE:
            board.cells.erase(step.slot)
            board.work()
        kept = a_set(number)
    assert step.kind == lib.STORE_ERASE
    board.cells.read[0][13] = ONES
    assert board.start() == kept
    board.work()
    assert board.save((1,))
    assert board.start() == (1,)


# ---- What a loss of power has left, word by word ----


def test_a_slot_with_nothing_but_its_head_takes_the_largest_set(core):
    """The power went behind the erasure: no word is left free where nothing was written, and it is erased once."""
    board = filled(core, head(1))
    assert board.start() is None
    board.work()
    assert board.save(range(WORDS - 9))
    assert board.wear(0) == 1


def test_a_word_is_left_free_behind_what_was_written(core):
    """A record that was begun has one word alone."""
    board = filled(core, [*head(1), 0])
    board.start()
    board.work()
    assert board.save((7, 8))
    assert list(board.cells.read[0][4:13]) == [0, ONES, *record(1, (7, 8))]


def test_a_slot_that_has_room_is_not_erased_again(core):
    """The newest record's slot is full; in the other one lies a head, behind a save that lost its power."""
    board = filled(core, [*head(1), *record(1, range(31))], head(2))
    board.start()
    board.work()
    assert board.save((7, 8))
    assert board.wear(1) == 2
    assert list(board.cells.read[1][4:11]) == record(2, (7, 8))


def test_a_head_without_its_number_keeps_its_room_and_touches_no_good_record(core):
    """The head at 4 lays claim to words beyond the good record, the one at 5 to some within it."""
    for claim in (20, 3):
        good = record(1, (7, 8, 9))
        board = filled(core, [*head(1), 0x47520000 | claim, ONES, *good])
        assert board.start() == (7, 8, 9)
        assert board.torn_slots() == 0
        board.work()
        assert board.log == []
        assert board.save((1,))
        at = 4 + claim + 5 if claim == 20 else 6 + len(good)
        assert list(board.cells.read[0][at : at + 7]) == [ONES, *record(2, (1,))], claim
        assert board.start() == (1,)


def test_all_that_dangles_is_made_void_and_what_is_not_settled_is_settled(core):
    """Two records in one slot and one in the other lack their commit words, and the newest its settled word."""
    torn = record(9, (1, 2))[:-2]
    board = filled(
        core, [*head(1), *torn, ONES, ONES, *torn], [*head(2), *record(8, (7,))[:-1], ONES, *torn, ONES, ONES, 0, 0]
    )
    assert board.start() == (7,)
    assert board.torn_slots() == 2
    board.work()
    assert list(board.cells.read[0][4:18]) == 2 * [*torn, 0, 0]
    assert list(board.cells.read[1][4:17]) == [*record(8, (7,)), *torn, 0, 0]
    board.log.clear()
    assert board.start() == (7,)
    assert board.torn_slots() == 0
    board.work()
    assert board.log == []


def test_a_commit_that_does_not_settle_leaves_its_set(core):
    """The flash does not take the settled word: that is tried once, and the set is there."""
    board = filled(core, [*head(1), *record(1, (7,))[:-1]])
    board.cells.stuck = {(0, 9): ONES}
    board.start()
    board.work()
    assert board.log == [(0, 8, COMMIT), (0, 9, SETTLED)]
    assert board.read() == (7,)


def test_a_record_that_does_not_become_void_ends_the_mending(core):
    """The flash does not take that: nothing else is written, and the set before counts."""
    torn = record(2, (8,))[:-2]
    board = filled(core, [*head(1), *record(1, (7,)), ONES, *torn])
    board.cells.stuck = {(0, 15): ONES}
    assert board.start() == (7,)
    board.work()
    assert board.log == [(0, 15, 0)]
    assert board.start() == (7,)
