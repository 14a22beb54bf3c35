"""The store: what is saved, refused and found, on sound flash and on worn flash."""

import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.firmware.core.edge_memory import at_the_edge
from tests.firmware.core.storage.flash_cells import ONES
from tests.firmware.core.storage.store_board import (
    ERASE,
    FIT,
    HEAD,
    MARK,
    READY,
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


def test_crc_is_that_of_zlib(core):
    ffi, lib = core
    assert lib.crc32(0, b"123456789", 9) == 0xCBF43926
    random = np.random.default_rng(3)
    for size in (0, 1, 2, 7, 1000):
        data = random.bytes(size)
        cut = size // 3
        assert lib.crc32(lib.crc32(0, data[:cut], cut), data[cut:], size - cut) == zlib.crc32(data)
    assert ffi is not None


def test_what_lies_in_the_flash(core):
    """The layout is a promise to later images: it is built here by another hand."""
    board = fresh(core)
    assert board.save((7, 8, 9))
    body = np.array([0x47520003, 1, 7, 8, 9], np.uint32)
    slot = [*head(1), *record(1, (7, 8, 9))]
    assert slot == [0x47465331, 1, ONES - 1, 0x2D5A1E69, *body, zlib.crc32(body.tobytes()), 0x5AC3A53C, 0x3CA5C35A]
    assert [list(words) for words in board.cells.read] == [slot + [ONES] * (WORDS - len(slot)), [ONES] * WORDS]


def test_the_last_of_many_sets_is_there_and_both_slots_wear_alike(core):
    board = fresh(core)
    for number in range(60):
        assert board.save(a_set(number))
        assert board.read() == a_set(number)
        if number % 3:  # Some saves follow without a start.
            assert board.start() == a_set(number)
            steps = board.steps
            board.work()
            assert board.steps == steps  # nothing is to be mended
    erased = [board.log.count((slot, ERASE)) for slot in range(2)]
    assert erased == [15, 15]  # Three sets fit, and from then on two of each slot.
    assert (board.wear(0), board.wear(1)) == (erased[0], erased[1] + 1)  # The second begins as the first one's next.


def test_what_does_not_fit_is_refused_and_what_just_fits_is_kept(core):
    board = fresh(core)
    assert board.save(range(WORDS - 9))
    assert not board.save(range(WORDS - 8))
    assert board.start() == tuple(range(WORDS - 9))
    board.work()
    assert board.save(())
    assert board.start() == ()
    _, lib = core
    assert lib.STORE_OVERHEAD == 9


@pytest.mark.parametrize("words", range(12))
def test_the_smallest_slots_take_what_they_have_room_for(core, words):
    """Behind each slot no memory can be read; a slot without room for a record of no words takes none."""
    ffi, _ = core
    memory = [ffi.from_buffer("uint32_t[]", at_the_edge(4 * words)) for _ in range(2)]
    board = Board(core, words=words, memory=memory)
    for contents in (head(1), [MARK, 5, 6, READY], [*head(1), 0x47520000, 7, 0x47520000], WORDS * [0]):
        for slot in range(2):
            board.cells.read[slot][0:words] = (contents + WORDS * [ONES])[:words]
        board.start()
        board.work()
        for count in range(4):
            assert board.save(range(count)) == (count + 9 <= words), (contents, count)


def test_a_count_of_more_than_16_bits_is_refused(core):
    """The head of a record has no room for it."""
    ffi, lib = core
    board = Board(core, words=66000)
    board.start()
    board.work()
    data = ffi.new("uint32_t[]", 65536)
    assert not lib.store_save(board._store, data, 65536)
    assert lib.store_save(board._store, data, 65535)


def test_a_save_has_the_steps_that_it_should(core):
    """Behind another record, and in the other slot: its head is cleared, it is erased, and gets a head anew."""
    full = [*head(5), *record(1, range(7)), ONES, *record(2, range(8)), ONES, *record(3, range(4))]
    board = filled(core, full, [*head(6), *(36 * [1])])
    assert board.start() == tuple(range(4))
    board.work()
    for count, slot, at, before in (
        (6, 1, HEAD, [*((1, i, 0) for i in range(4)), (1, ERASE), *((1, i, word) for i, word in enumerate(head(7)))]),
        (2, 1, 16, [(1, 3, READY)]),
        (12, 0, HEAD, [*((0, i, 0) for i in range(4)), (0, ERASE), *((0, i, word) for i, word in enumerate(head(6)))]),
    ):
        board.log.clear()
        assert board.save(range(count))
        words = record(board.read_sequence(), range(count))
        assert board.log == [*before, *((slot, at + i, word) for i, word in enumerate(words))]


def test_a_save_before_the_mending_is_refused(core):
    board = Board(core)
    board.start()
    assert not board.save((1,))
    board.work()
    assert board.save((1,))


@pytest.mark.parametrize("place", [0, 3])
def test_a_set_that_holds_a_record_is_refused(core, place):
    """Found by the fuzzer: with the power lost within its save, the next start read the empty record in it."""
    board = fresh(core)
    assert board.save((1, 2, 3))
    assert not board.save((*range(place), *forged(), 5))
    assert not board.save((*range(place), *forged()))
    assert board.start() == (1, 2, 3)
    board.work()
    for one in range(4):  # Without one of its words it is none.
        less = [word ^ (index == one) for index, word in enumerate(forged())]
        assert board.save((*range(place), *less, 5)), one
    assert board.save((*range(place), *forged()[:3]))
    assert board.save((*range(place), *forged(mark=0x47530000), 5))  # Nor is it one with another mark.


def test_what_lies_behind_a_set_is_no_part_of_it(core):
    """The commit word that would make a record of the set's end lies behind the set, or is its last word."""
    ffi, lib = core
    board = fresh(core)
    words = ffi.new("uint32_t[]", record(9, (7,)))
    assert not lib.store_save(board._store, words, 5)
    assert lib.store_save(board._store, words, 4)


def completed(words, wanted):
    """Return the word behind words that gives all of them a wanted CRC-32: its register runs backwards."""
    register = wanted ^ ONES
    for _ in range(32):
        register = (register ^ 0xEDB88320) << 1 | 1 if register >> 31 else register << 1
    return register & ONES ^ zlib.crc32(np.array(words, np.uint32).tobytes()) ^ ONES


def test_a_set_whose_crc_is_the_commit_word_is_refused(core):
    """The words before it are a record but for that word; the CRC comes behind them."""
    inner = forged()[:3]
    head = [0x47520000 | len(inner) + 1, 1]
    last = completed([*head, *inner], 0x5AC3A53C)
    assert zlib.crc32(np.array([*head, *inner, last], np.uint32).tobytes()) == 0x5AC3A53C
    board = fresh(core)
    assert not board.save((*inner, last))
    assert board.save((*inner, last ^ 1))


def test_a_record_of_which_a_bit_has_changed_is_none(core):
    board = fresh(core)
    assert board.save(a_set(1))
    assert board.save(a_set(2))
    for index in range(17, 17 + len(a_set(2)) + 4):  # behind 12 words of the first record and a gap
        for bit in range(32):
            board.cells.read[0][index] ^= 1 << bit
            assert board.start() == a_set(1), (index, bit)
            board.cells.read[0][index] ^= 1 << bit
    assert board.start() == a_set(2)


def test_a_record_that_is_not_whole_is_told_once(core):
    """Both what was never committed, and what was and has changed; a good set and a blank flash are not told."""
    board = fresh(core)
    assert board.torn_slots() == 0
    assert board.save(a_set(1))
    assert board.save(a_set(2))
    board.start()
    assert board.torn_slots() == 0
    board.cells.read[0][20] ^= 4
    assert board.start() == a_set(1)
    assert board.torn_slots() == 1
    board.work()
    board.start()
    assert board.torn_slots() == 0
    board.work()
    board.cut = board.steps + 8  # Past an erasure and the head of a slot, within a record.
    with pytest.raises(PowerLost):
        board.save(a_set(3))
    assert board.start() == a_set(1)
    assert board.torn_slots() == 1


def test_words_that_change_while_they_are_saved_are_not_kept(core):
    ffi, lib = core
    board = fresh(core)
    assert board.save(a_set(1))
    data = ffi.new("uint32_t[]", list(a_set(2)))
    assert lib.store_save(board._store, data, len(a_set(2)))
    step = lib.store_next(board._store)
    while step.index < 20:
        board.cells.program(step.slot, step.index, step.value)
        step = lib.store_next(board._store)
    board.cells.program(step.slot, step.index, step.value)
    data[4] ^= 1
    board.work()
    assert lib.store_outcome(board._store) == lib.STORE_FAILED
    assert board.read() == a_set(1)
    assert board.start() == a_set(1)


def test_a_save_is_one_of_its_own_words_until_it_has_ended(core):
    ffi, lib = core
    board = fresh(core)
    data = ffi.new("uint32_t[]", list(a_set(2)))
    count = len(a_set(2))
    assert not lib.store_saves(board._store, data, count)
    assert lib.store_save(board._store, data, count)
    assert lib.store_saves(board._store, data, count)
    assert not lib.store_saves(board._store, data, count - 1)
    assert not lib.store_saves(board._store, data + 1, count)
    board.work()
    assert not lib.store_saves(board._store, data, count)


@given(noise=st.data(), words=st.integers(0, 60))
def test_any_contents_are_survived(core, noise, words):
    """Whatever lies in the flash, a set can be saved, if it fits, and is there then."""
    board = Board(core, words=words)
    values = st.one_of(
        st.integers(0, ONES), st.sampled_from([0, ONES, 0x47465331, 0x2D5A1E69, 0x5AC3A53C, 0x47520001, 0x4752FFFF])
    )
    filled = noise.draw(st.integers(0, words))
    for slot in range(2):
        board.cells.read[slot][0:filled] = noise.draw(st.lists(values, min_size=filled, max_size=filled))
    board.start()
    board.work()
    assert board.save((1, 2, 3)) == (words >= 12)
    if words >= 12:
        assert board.start() == (1, 2, 3)


@pytest.mark.parametrize("index", range(WORDS))
@pytest.mark.parametrize("both", [False, True])
def test_a_worn_cell_costs_no_set_that_was_promised(core, index, both):
    """A word that cannot be cleared is passed over; if that is in a head, the other slot is used until it is full."""
    board = fresh(core)
    kept, said = None, []
    board.cells.stuck = {(slot, index): ONES for slot in range(1 + both)}
    for number in range(12):
        said.append(board.save(a_set(number)))
        kept = a_set(number) if said[-1] else kept
        assert board.start() == kept
        board.work()
        assert board.read() == kept
    assert said.count(True) == (12 if index >= HEAD else 0 if both else FIT)
    assert said == sorted(said, reverse=True)


@pytest.mark.parametrize("damaged", [(), (0,), (1,), (2,), (3,), (0, 1), (0, 2), (0, 3), (1, 3), (2, 3), (0, 1, 3)])
def test_a_slot_counts_while_two_of_three_things_before_its_records_are_whole(core, damaged):
    """They are its mark, word 0; the erasures with their complement, words 1 and 2; and the mark of the erasure, 3."""
    board = fresh(core)
    assert board.save(a_set(1))
    for index in damaged:
        board.cells.read[0][index] ^= 0x10
    assert board.start() == (a_set(1) if len(damaged) < 2 else None)
    told = not {0, 1, 2} & set(damaged)
    assert board.wear(0) == (1 if told else 0)
    board.work()
    board.log.clear()
    assert board.save(a_set(2))  # It is not added to a slot that is damaged.
    if damaged:
        assert {step[0] for step in board.log} == ({1} if len(damaged) < 2 else {0})
        assert (board.log[0][0], ERASE) in board.log
    assert board.start() == a_set(2)


def test_words_that_are_no_record_by_their_head_alone_are_none(core):
    """CRC, commit and settled word are those of a record."""
    board = fresh(core)
    assert board.save((7, 8, 9))
    for mark, found in ((0x47520000, (7, 8, 9)), (0x47530000, None), (0x47420000, None)):
        board.cells.read[0][HEAD : HEAD + 8] = record(1, (7, 8, 9), mark)
        assert board.start() == found, hex(mark)


def test_a_record_with_the_number_0_counts_and_of_two_numbers_the_larger(core):
    for numbers, found in (((0,), (0,)), ((0, 1), (1,)), ((2, 1), (0,)), ((ONES, 1), (0,))):
        slots = [[*head(1), *record(number, (slot,))] for slot, number in enumerate(numbers)]
        assert filled(core, *slots).start() == found


# ---- Worn flash ----


@pytest.mark.parametrize("index", [None, 0, 20, WORDS - 1])
def test_an_erasure_that_leaves_a_word_is_not_relied_on(core, index):
    """The first, one in the middle, the last word of the slot stays as it is; the set that was kept is there still."""
    board = filled(core, [*head(1), *record(1, range(31))], [*head(2), *record(2, range(30))])
    board.start()
    board.work()
    erase = board.cells.erase

    def erase_all_but_one(slot):
        erase(slot)
        if index is not None:
            board.cells.read[slot][index] = ONES - 1

    board.cells.erase = erase_all_but_one
    assert board.save((1, 2, 3)) == (index is None)
    assert board.start() == ((1, 2, 3) if index is None else tuple(range(30)))
    assert board.wear(1) == 2


def test_a_word_that_does_not_clear_is_no_hindrance_to_the_erasure(core):
    """A bit of the slot's mark is one in any case."""
    board = fresh(core)
    board.cells.stuck = {(0, 0): 1, (1, 0): 1}
    for number in range(12):
        assert board.save(a_set(number))
        assert board.start() == a_set(number)
        board.work()
    assert [board.log.count((slot, ERASE)) for slot in range(2)] == [3, 3]


def begun_at(board):
    """Return where records were begun: a head that counts two words."""
    return [step[:2] for step in board.log if step[1] != ERASE and step[2] == 0x47520002]


def test_a_save_is_tried_again_behind_and_the_third_time_in_the_other_slot(core):
    """A word of each place does not take its value; the fourth try ends the save, and another one begins anew."""
    attempts = [(0, 13), (0, 21), (1, 4), (1, 12)]
    for bad in range(5):
        board = filled(core, [*head(1), *record(1, (1, 2, 3))], head(2), words=80)
        board.start()
        board.work()
        board.cells.stuck = {(slot, at + 2): ONES for slot, at in attempts[:bad]}
        board.log.clear()
        assert board.save((7, 8)) == (bad < 4)
        assert begun_at(board) == attempts[: bad + 1]
        for slot, at in attempts[:bad]:
            assert list(board.cells.read[slot][at : at + 7]) == [0x47520002, 2, ONES, ONES, ONES, 0, 0]
        assert board.read() == ((7, 8) if bad < 4 else (1, 2, 3))
    board.cells.stuck, sequence = {}, board.read_sequence()
    board.log.clear()
    assert board.save((7, 8))
    assert begun_at(board) == [(0, 29)]
    assert board.read_sequence() == sequence + 1
