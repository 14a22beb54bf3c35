"""An update: what starts after each step of it, whatever becomes of the power; a node is never without an image."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.firmware.core.boot.slots import (
    BEACON,
    CODE,
    COMPLEMENT,
    CONFIRMED,
    DAMAGED,
    FORCED,
    IS_CONFIRMED,
    IS_PENDING,
    IS_REJECTED,
    IS_TRIED,
    MARK,
    NEW,
    NO_KEY,
    NONE,
    NOTHING,
    OK,
    OLD,
    OLDER,
    OTHER_KEY,
    SETTLED,
    TRIED,
    UNSIGNED,
    WORDS,
    WRONG_ROLE,
    Choice,
    Node,
    running_old,
)
from tests.firmware.core.storage.flash_cells import ONES

UNCONFIRMED, LENGTH = 1, 2
IDLE, RECEIVING, PENDING_PHASE, FAILED = 0, 3, 5, 6
REJECT_PHASE = 3


def test_a_flashed_node_starts_what_was_flashed_and_writes_nothing(core):
    node = running_old(core, other=False)
    assert [node.boot() for _ in range(3)] == 3 * [Choice(0, False)]
    assert node.steps == 0


def test_an_update_is_tried_confirms_itself_and_stays(core):
    node = running_old(core)
    assert node.update(NEW, 0) == OK
    assert node.phase == PENDING_PHASE
    assert node.state(1) == IS_PENDING
    assert node.boot() == Choice(1, True)
    assert node.state(1) == IS_TRIED
    node.open(1)
    assert node.confirm()
    assert not node.confirm()
    assert node.state(1) == IS_CONFIRMED
    steps = node.steps
    assert [node.boot() for _ in range(3)] == 3 * [Choice(1, False)]
    assert node.steps == steps
    assert node.holds(0, OLD)  # It is there still, should the new one be damaged.


def test_updates_go_to_and_fro(core):
    node = running_old(core)
    for number in range(6):
        running = number % 2
        image = replace(NEW, version=NEW.version + number)
        assert node.update(image, running) == OK
        assert node.boot() == Choice(1 - running, True)
        node.open(1 - running)
        node.confirm()
        assert node.boot() == Choice(1 - running, False)
        assert node.holds(1 - running, image)


def test_an_image_that_does_not_confirm_itself_is_started_once(core):
    node = running_old(core)
    node.update(NEW, 0)
    assert node.boot() == Choice(1, True)
    assert [node.boot() for _ in range(3)] == 3 * [Choice(0, False)]
    assert node.state(1) == IS_REJECTED
    steps = node.steps
    node.boot()
    assert node.steps == steps
    assert node.update(NEW, 0) == OK  # Whoever brings it again gets another try.
    assert node.boot() == Choice(1, True)


@pytest.mark.parametrize(
    ("image", "key", "status"),
    [
        (replace(NEW, version=OLD.version - 1), None, OLDER),
        (replace(NEW, role=BEACON), None, WRONG_ROLE),
        (NEW, OTHER_KEY, UNSIGNED),
    ],
)
def test_what_is_refused_is_not_started(core, image, key, status):
    node = running_old(core)
    arguments = {} if key is None else {"key": key}
    assert node.update(image, 0, **arguments) == status
    assert node.phase == RECEIVING
    assert node.boot() == Choice(0, False)
    # A wrong application may mark it all the same: the boot loader looks itself.
    node.put(image, 1, sequence=8, pending=MARK, **arguments)
    assert node.boot() == Choice(0, False)
    assert node.state(1) == IS_REJECTED


def test_each_flipped_bit_of_a_pending_image_has_the_old_one_start(core):
    for index in [*range(16, 33), *range(112, CODE + len(NEW.code))]:
        node = running_old(core)
        node.update(NEW, 0)
        node.cells.read[1][index] ^= 1 << index % 32
        assert node.boot() == Choice(0, False), index
        assert node.state(1) == IS_REJECTED


def test_an_older_image_is_taken_by_force_and_one_of_the_same_version_without(core):
    older = replace(NEW, version=OLD.version - 1)
    node = running_old(core)
    assert node.update(older, 0, forced=True) == OK
    assert node.boot() == Choice(1, True)
    node = running_old(core)
    assert node.update(replace(NEW, version=OLD.version), 0) == OK
    assert node.boot() == Choice(1, True)
    node = running_old(core)
    assert node.update(replace(NEW, role=BEACON), 0, forced=True) == WRONG_ROLE


def test_without_a_key_nothing_is_taken_and_the_node_goes_on(core):
    node = running_old(core)
    node.forget_key()
    assert node.update(NEW, 0) == NO_KEY
    assert node.boot() == Choice(0, False)


def test_an_image_that_is_damaged_later_gives_way_to_the_one_before(core):
    node = running_old(core)
    node.update(NEW, 0)
    node.live()
    assert node.boot() == Choice(1, False)
    node.cells.read[1][CODE + 2] ^= 8
    assert node.boot() == Choice(0, False)
    assert node.check(1) == DAMAGED


def test_a_node_whose_images_are_all_rejected_starts_the_newest_that_is_signed(core):
    node = Node(core)
    node.put(OLD, 0, sequence=1, confirmed=0, settled=0)
    node.put(NEW, 1, sequence=2, confirmed=0, settled=0)
    assert node.boot() == Choice(1, True)
    node.cells.read[1][CODE] ^= 1
    assert node.boot() == Choice(0, True)
    node.cells.read[0][CODE] ^= 1
    assert node.boot() is None


@pytest.mark.parametrize("bit", [0, 31])
def test_a_sequence_number_that_its_complement_belies_is_none(core, bit):
    """The slot counts as empty, whatever its other words say, and the one before starts."""
    node = running_old(core, other=False)
    node.confirmed(NEW, 1, 9)
    assert node.boot() == Choice(1, False)
    node.cells.read[1][COMPLEMENT] ^= 1 << bit
    assert node.state(1) == NOTHING
    assert node.boot() == Choice(0, False)


def test_an_image_of_version_0_starts_where_none_is_confirmed(core):
    node = Node(core)
    node.put(replace(OLD, version=0), 1, sequence=1, pending=MARK)
    assert node.boot() == Choice(1, True)
    assert node.state(1) == IS_TRIED


def test_a_settled_image_is_confirmed_though_one_bit_of_its_first_mark_reads_otherwise(core):
    """The second word is programmed behind the first one, so that it alone tells that both were."""
    for settled, state, choice in ((MARK, IS_CONFIRMED, Choice(0, False)), (MARK | 1, IS_TRIED, Choice(0, True))):
        node = Node(core)
        node.put(OLD, 0, sequence=1, pending=MARK, tried=MARK, confirmed=MARK | 1, settled=settled)
        assert node.state(0) == state
        assert node.boot() == choice


@pytest.mark.parametrize(
    ("confirmed", "damaged", "starts"), [(MARK, 0, 0), (MARK, 1, 1), (0, 0, 1), (ONES, 0, 1), (0, 1, 1)]
)
def test_an_image_is_measured_by_one_that_is_confirmed_and_intact_alone(core, confirmed, damaged, starts):
    """In the other slot lies a newer image of another role: rejected, tried and never confirmed, or with a wrong bit,
    it demands nothing."""
    node = Node(core)
    node.put(replace(NEW, role=BEACON), 0, sequence=1, pending=MARK, tried=MARK, confirmed=confirmed, settled=confirmed)
    node.cells.read[0][CODE] ^= damaged
    node.put(OLD, 1, sequence=2, pending=MARK)
    assert node.boot() == Choice(starts, starts == 1)
    assert node.state(1) == (IS_TRIED if starts == 1 else IS_REJECTED)


def test_two_images_that_were_tried_are_rejected_in_one_start(core):
    node = Node(core)
    node.put(OLD, 0, sequence=1, pending=MARK, tried=MARK)
    node.put(NEW, 1, sequence=2, pending=MARK, tried=MARK)
    assert node.boot() == Choice(1, True)
    assert [node.words(slot)[CONFIRMED : SETTLED + 1] for slot in range(2)] == [[0, 0], [0, 0]]


@pytest.mark.parametrize("slot", [0, 1])
def test_a_number_that_its_complement_belies_puts_no_image_first(core, slot):
    """Both images are signed and neither is confirmed: the one that has a number is the newest, whatever reads in the
    other one's place."""
    node = Node(core)
    node.put(OLD, slot, sequence=5, confirmed=0, settled=0)
    node.put(NEW, 1 - slot, sequence=9)
    node.cells.read[1 - slot][COMPLEMENT] ^= 1
    assert node.boot() == Choice(slot, True)


def test_an_empty_node_starts_nothing(core):
    node = Node(core)
    assert node.boot() is None
    assert node.steps == 0


# ---- What the application may do ----


def test_no_update_begins_before_the_running_image_is_confirmed(core):
    node = running_old(core)
    node.update(NEW, 0)
    node.boot()
    node.open(1)
    assert node.begin(8) == UNCONFIRMED
    node.confirm()
    assert node.begin(8) == OK
    bare = Node(core)
    bare.put(OLD, 0)
    bare.open(0)
    assert not bare.confirm()
    assert bare.begin(8) == UNCONFIRMED


def test_an_image_that_is_confirmed_and_not_settled_settles_first(core):
    """The power went between the two words: no update begins before the second one is there."""
    node = Node(core)
    node.put(OLD, 0, sequence=7, pending=MARK, tried=MARK, confirmed=MARK)
    node.open(0)
    assert node.state(0) == IS_CONFIRMED
    assert node.begin(8) == UNCONFIRMED
    assert node.confirm()
    assert node.words(0)[SETTLED] == MARK
    assert node.phase == IDLE
    assert node.begin(8) == OK


def test_a_rejected_image_neither_confirms_itself_nor_begins_an_update(core):
    node = Node(core)
    node.put(OLD, 0, sequence=7, pending=MARK, tried=MARK, confirmed=0, settled=MARK)
    node.open(0)
    assert node.state(0) == IS_REJECTED
    assert not node.confirm()
    assert node.begin(8) == UNCONFIRMED


@pytest.mark.parametrize(
    ("length", "refusal"),
    [(0, LENGTH), (7, LENGTH), (8, OK), (4 * (WORDS - CODE), OK), (4 * (WORDS - CODE) + 4, LENGTH)],
)
def test_the_length_must_fit(core, length, refusal):
    node = running_old(core)
    node.open(0)
    assert node.begin(length) == refusal


def test_an_update_that_was_not_begun_does_not_end(core):
    """A good image lies in the other slot: it is not marked by that."""
    node = running_old(core)
    node.open(0)
    assert node.end() == NONE
    assert (node.steps, node.phase) == (0, 0)
    assert node.update(NEW, 0) == OK
    assert node.end() == NONE  # It has ended already.


@pytest.mark.parametrize("forced", [True, False])
def test_only_a_forced_update_says_so(core, forced):
    """The boot loader takes an older image for that word alone, and no signature covers it."""
    node = running_old(core)
    assert node.update(NEW, 0, forced=forced) == OK
    assert node.words(1)[FORCED] == (MARK if forced else 0)


def test_by_force_the_oldest_of_all_is_taken(core):
    node = running_old(core)
    assert node.update(replace(NEW, version=0), 0, forced=True) == OK
    assert node.boot() == Choice(1, True)


@pytest.mark.parametrize(
    ("words", "length", "refusal"),
    [(32, 4, LENGTH), (CODE - 1, 4, LENGTH), (CODE, 4, LENGTH), (CODE + 1, 4, OK), (CODE + 1, 8, LENGTH)],
)
def test_a_slot_takes_what_it_has_room_for(core, words, length, refusal):
    node = running_old(core)
    node.flash.words = words
    node.open(0)
    assert node.begin(length) == refusal


def test_only_words_of_the_image_are_taken_and_only_while_it_is_received(core):
    node = running_old(core)
    node.open(0)
    assert not any(node.takes(index) for index in range(WORDS))
    node.begin(12)
    assert not any(node.takes(index) for index in range(WORDS))
    node.work()
    assert [index for index in range(WORDS + 5) if node.takes(index)] == list(range(16, CODE + 3))
    assert node.end() != OK
    assert node.takes(16)  # What is missing may still come.
    node.receive(1, replace(NEW, code=(1, 2, 3)).at(1).words())
    assert node.end() == OK
    assert not any(node.takes(index) for index in range(WORDS))


@pytest.mark.parametrize("index", [0, 1, 2, 3, 16, 112, CODE])
def test_flash_that_does_not_take_its_words_fails_the_update_and_nothing_else(core, index):
    node = running_old(core)
    node.cells.read[1][index] = 0
    node.open(0)
    node.begin(4 * len(NEW.code))
    erase, node.cells.erase = node.cells.erase, lambda slot: None
    node.work()
    node.cells.erase = erase
    assert node.phase == FAILED
    assert node.boot() == Choice(0, False)
    stuck = running_old(core)
    stuck.cells.stuck = {(1, index): ONES}
    stuck.update(NEW, 0)
    assert stuck.phase != PENDING_PHASE
    assert stuck.boot() == Choice(0, False)


@pytest.mark.parametrize(
    ("index", "phase"), [(0, FAILED), (1, FAILED), (CODE - 1, FAILED), (CODE + 2, FAILED), (CODE + 3, RECEIVING)]
)
def test_an_erasure_that_leaves_one_word_of_the_image_fails_the_update(core, index, phase):
    """The first and the last word that the image will take are looked at, and none behind it."""
    node = running_old(core)
    erase = node.cells.erase

    def erase_all_but_one(slot):
        erase(slot)
        node.cells.read[slot][index] = ONES - 1

    node.open(0)
    node.begin(12)
    node.cells.erase = erase_all_but_one
    node.work()
    assert node.phase == phase


@pytest.mark.parametrize("index", [TRIED, CONFIRMED, SETTLED])
def test_a_mark_that_does_not_take_costs_the_new_image(core, index):
    """Without its mark an image would be tried for ever, so it is not started; or it stays as it is and is found."""
    node = running_old(core)
    node.update(NEW, 0)
    node.cells.stuck = {(1, index): ONES}
    choice = node.boot()
    if index == TRIED:
        assert choice == Choice(0, False)
        return
    node.open(1)
    node.confirm()
    assert node.phase == FAILED
    for _ in range(3):
        choice = node.boot()
        assert choice == (Choice(0, False) if index == CONFIRMED else Choice(1, False))


# ---- What upsets it ----


@given(noise=st.data())
def test_any_state_words_leave_a_signed_image_running(core, noise):
    """Whatever the state words say, a node that holds a whole image starts one, and the marks come to rest."""
    node = Node(core)
    values = st.one_of(st.integers(0, ONES), st.sampled_from([0, ONES, MARK, 1, ONES - 1, 2, ONES - 2]))
    for slot, image in enumerate((OLD, NEW)):
        node.put(image, slot)
        node.cells.read[slot][0:7] = noise.draw(st.lists(values, min_size=7, max_size=7))
    for _ in range(4):
        choice = node.boot()
        assert choice is not None
        assert node.check(choice.slot) == OK
    steps = node.steps
    last = [node.boot() for _ in range(2)]
    assert node.steps == steps
    assert last[0] == last[1] == choice
    assert node.state(0) in range(NOTHING, IS_REJECTED + 1)


def test_a_new_image_is_checked_again_behind_its_mark(core):
    """Whatever let the first check pass, as a skipped instruction does, what is wrong then does not start."""

    class Other(Node):
        """A node in which a bit of the new image flips as its mark is programmed."""

        def carry_out(self, slot, index, value):
            super().carry_out(slot, index, value)
            if (slot, index) == (1, TRIED):
                self._memory[1][CODE] ^= 1

    for kind, started in ((Node, Choice(1, True)), (Other, Choice(0, False))):
        node = kind(core)
        node.confirmed(OLD, 0, 7)
        node.put(NEW, 1, sequence=8, pending=MARK)
        assert node.boot() == started, kind
        assert node.boot() == Choice(0, False)


def twice(select):
    """The store of the second slot's place is skipped: the first is looked at twice."""
    select.order = [1, 1]


def goes_on_rejecting(select):
    """The store of the phase behind a rejection is skipped: the next slot is rejected, too."""
    select.place, select.phase = 1, REJECT_PHASE


@pytest.mark.parametrize(("upset", "started"), [(twice, None), (goes_on_rejecting, Choice(0, True))])
def test_no_upset_leads_past_a_confirmed_image_to_an_older_one(core, upset, started):
    """Each of these, an instruction of the image that was skipped, once started the older image."""
    node = Node(core)
    node.confirmed(NEW, 0, 7)
    node.put(OLD, 1, sequence=8, pending=MARK)
    assert node.boot(upset) == started
    assert node.state(0) == IS_CONFIRMED
    assert node.boot() == Choice(0, False)
