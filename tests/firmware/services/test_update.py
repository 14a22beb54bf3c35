"""A board takes a new image over its link, tries it, and goes back: the whole way on host boards, in every step."""

from __future__ import annotations

from dataclasses import replace

import pytest

from goldfield_protocol import encode
from hil_sim import clib
from tests.firmware.core.boot.slots import (
    ADDRESSES,
    BEACON,
    CODE,
    IS_CONFIRMED,
    IS_PENDING,
    IS_TRIED,
    MARK,
    NEW,
    OLD,
    OTHER_KEY,
    Choice,
    Node,
    PowerLost,
)
from tests.firmware.core.conftest import HEADERS
from tests.firmware.core.storage.flash_cells import Torn
from tests.firmware.host_rig import PIN_ENABLE, SECOND, Coil, beacon
from tests.firmware.services import saved_flash
from tests.firmware.services.updated_board import (
    BEGIN,
    BLOCK_TIME,
    DAMAGED,
    END,
    FIRST_BLOCK,
    FLASH_FAILED,
    MISSING,
    NO_IMAGE,
    NO_KEY,
    OK,
    OK_RESTARTS,
    OLDER,
    PAGE,
    REFUSED,
    TELL,
    UNCONFIRMED,
    WRONG_BOARD,
    WRONG_LENGTH,
    WRONG_ROLE,
    WRONG_SIGNATURE,
    WRONG_SLOT,
    UpdatedBoard,
    blocks_of,
    send,
)

RECEIVING = 3


@pytest.fixture(scope="module")
def core():
    return clib.load("libgf_core.so", HEADERS)


def fresh(core, seed=1):
    """Return slots whose first holds the old image, confirmed."""
    node = Node(core, seed)
    node.confirmed(OLD, 0, 7)
    return node


def told(life):
    """What the board tells of its images: running, its state, the other's state, key, phase."""
    status, value = life.command(TELL)
    assert status == OK
    return value & 15, value >> 4 & 15, value >> 8 & 15, value >> 12 & 1, value >> 16


def test_an_update_from_the_first_command_to_the_confirmation(core):
    node = fresh(core)
    life = UpdatedBoard(node, 0)
    assert told(life) == (0, IS_CONFIRMED, 0, 1, 0)
    assert life.command(BEGIN, blocks_of(NEW)) == (OK, ADDRESSES[1])
    assert told(life)[4] == RECEIVING
    life.data(NEW.at(1).words(), range(FIRST_BLOCK, blocks_of(NEW)))
    assert life.command(MISSING) == (OK, 0)
    assert life.command(END) == (OK_RESTARTS, 0)
    assert node.state(1) == IS_PENDING
    life.run(100)
    assert life.starts() == 2
    life.close()
    assert node.boot() == Choice(1, True)
    life = UpdatedBoard(node, 1)
    assert life.command(TELL)[1] >> 4 & 15 == IS_TRIED
    life.run(2900)
    assert node.state(1) == IS_TRIED
    life.run(200)
    assert node.state(1) == IS_CONFIRMED
    assert told(life)[:3] == (1, IS_CONFIRMED, IS_CONFIRMED)
    life.close()
    assert node.boot() == Choice(1, False)


def test_what_is_lost_is_told_and_sent_again(core):
    node = fresh(core)
    life = UpdatedBoard(node, 0)
    life.command(BEGIN, blocks_of(NEW))
    words, last = NEW.at(1).words(), blocks_of(NEW)
    assert life.command(MISSING) == (OK, FIRST_BLOCK | last - FIRST_BLOCK << 16)
    lost = [FIRST_BLOCK + 3, 40, last - 1]
    life.data(words, [block for block in range(FIRST_BLOCK, last) if block not in lost])
    assert life.command(END)[0] in (NO_IMAGE, DAMAGED)  # It is told, and the update goes on.
    for count, block in enumerate(lost):
        assert life.command(MISSING) == (OK, block | 3 - count << 16)
        life.data(words, [block, block])
    assert life.command(MISSING) == (OK, 0)
    assert life.command(PAGE, 0) == (OK, 0)  # Told again: nothing is forgotten.
    assert life.command(MISSING) == (OK, 0)
    assert life.command(END) == (OK_RESTARTS, 0)
    life.close()


def test_blocks_on_can_for_all_reach_each_board_and_each_tells_what_it_misses(core):
    """Two boards hear the same blocks; one of them loses three."""
    nodes = [fresh(core, seed) for seed in (1, 2)]
    lives = [UpdatedBoard(node, 0) for node in nodes]
    words, last = NEW.at(1).words(), blocks_of(NEW)
    for life in lives:
        assert life.command(BEGIN, last) == (OK, ADDRESSES[1])

    def broadcast(blocks, lost=()):
        for number, life in enumerate(lives):
            for block in blocks:
                if number == 0 or block not in lost:
                    values = {"first": words[2 * block], "second": words[2 * block + 1]}
                    life.board.can_in(*encode("UPDATE_DATA", values, node=0, index=block), life.now)
                life.now += BLOCK_TIME
            life.run(1)

    broadcast(range(FIRST_BLOCK, last), lost=(20, 21, 60))
    assert [life.command(MISSING) for life in lives] == [(OK, 0), (OK, 20 | 3 << 16)]
    broadcast((20, 21, 60))
    assert [life.command(MISSING) for life in lives] == [(OK, 0), (OK, 0)]
    assert [life.command(END) for life in lives] == [(OK_RESTARTS, 0), (OK_RESTARTS, 0)]
    for life, node in zip(lives, nodes, strict=True):
        life.close()
        assert node.boot() == Choice(1, True)


def flipped(image, word=CODE + 1):
    words = image.at(1).words()
    words[word] ^= 1 << 5
    return words


@pytest.mark.parametrize(
    ("image", "words", "status"),
    [
        (NEW, flipped(NEW), DAMAGED),
        (NEW, flipped(NEW, 20), WRONG_SIGNATURE),
        (NEW, NEW.at(1).words(OTHER_KEY), WRONG_SIGNATURE),
        (replace(NEW, magic=1), None, NO_IMAGE),
        (replace(NEW, board=2), None, WRONG_BOARD),
        (replace(NEW, role=BEACON), None, WRONG_ROLE),
        (NEW, NEW.at(0).words(), WRONG_SLOT),
        (replace(NEW, version=OLD.version - 1), None, OLDER),
    ],
    ids=["a bit", "a bit of the signature", "signer", "no image", "board", "role", "slot", "older"],
)
def test_each_wrong_image_is_refused_with_its_own_status(core, image, words, status):
    node = fresh(core)
    life = UpdatedBoard(node, 0)
    assert send(life, image, words) == status
    life.run(200)
    assert life.starts() == 1
    life.run(10_000)  # Nothing more comes: it restarts, since its chips are out of step.
    assert life.starts() == 2
    life.close()
    assert node.boot() == Choice(0, False)


def test_an_older_image_is_taken_by_force(core):
    node = fresh(core)
    life = UpdatedBoard(node, 0)
    assert send(life, replace(NEW, version=OLD.version - 1), forced=True) == OK_RESTARTS
    life.close()
    assert node.boot() == Choice(1, True)


def test_what_does_not_fit_or_may_not_be_is_refused_before_anything_is_erased(core):
    node = fresh(core)
    life = UpdatedBoard(node, 0)
    assert life.command(BEGIN, 5) == (WRONG_LENGTH, 0)
    assert life.command(BEGIN, 71) == (WRONG_LENGTH, 0)
    assert life.command(BEGIN, 65, named=0) == (REFUSED, 0)
    assert life.command(BEGIN, 65, node=0) == (REFUSED, 0)
    assert life.command(BEGIN, 65, named=saved_flash.NAMED + 1) is None
    for index in (PAGE, MISSING, END):
        assert life.command(index) == (REFUSED, 0)
    life.data(NEW.at(1).words(), [60])
    assert node.steps == 0
    life.close()
    node.put(OLD, 0, sequence=7, tried=MARK)
    life = UpdatedBoard(node, 0)
    assert life.command(BEGIN, 65) == (UNCONFIRMED, 0)
    life.close()
    node = fresh(core)
    node.forget_key()
    life = UpdatedBoard(node, 0)
    assert life.command(BEGIN, 65) == (NO_KEY, 0)
    assert node.steps == 0
    life.close()


def test_a_page_beyond_the_image_is_refused(core):
    life = UpdatedBoard(fresh(core), 0)
    life.command(BEGIN, 70)
    assert life.command(PAGE, 1) == (REFUSED, 0)
    assert life.command(PAGE, 0, named=0, node=0) == (OK, 0)
    life.close()


def test_flash_that_does_not_take_it_is_told(core):
    node = fresh(core)
    node.cells.read[1][CODE] = 0
    node.cells.erase = lambda slot: None
    life = UpdatedBoard(node, 0)
    assert life.command(BEGIN, 70) == (FLASH_FAILED, 0)
    life.close()
    assert node.boot() == Choice(0, False)


def test_no_parameters_are_saved_while_an_image_is_taken(core):
    life = UpdatedBoard(fresh(core), 0)
    life.command(BEGIN, 70)
    saved_flash.ask_to_save(life.board, life.now)
    life.run(300)
    assert saved_flash.answers(life.board) == [REFUSED]
    life.close()


@pytest.mark.parametrize("heard", [True, False])
def test_a_new_image_that_nobody_talks_to_gives_up(core, heard):
    node = fresh(core)
    node.update(NEW, 0)
    node.boot()
    life = UpdatedBoard(node, 1)
    if heard:
        life.command(0)
    life.run(59_500)
    assert (life.starts(), node.state(1)) == (1, IS_CONFIRMED if heard else IS_TRIED)
    life.run(1000)
    assert life.starts() == (1 if heard else 2)
    life.close()
    assert node.boot() == Choice(int(heard), False)


def test_a_beacon_switches_its_coil_off_before_the_flash_is_touched(core):
    node = fresh(core)
    driving = beacon(Coil(), parameters={"node": 9, "sync_master": 1, "amplitude": 5.0}, unique_id=saved_flash.UNIQUE)
    life = UpdatedBoard(node, 0, driving)
    driving.run(SECOND)
    assert driving.level[PIN_ENABLE] is True
    life.now = SECOND
    assert send(life, NEW) == OK_RESTARTS
    assert len(life.enabled) > 30
    assert not any(life.enabled)
    life.close()


def test_a_beacon_on_trial_drives_once_it_is_confirmed(core):
    node = fresh(core)
    node.update(NEW, 0)
    node.boot()
    driving = beacon(Coil(), parameters={"node": 9, "sync_master": 1, "amplitude": 5.0}, unique_id=saved_flash.UNIQUE)
    life = UpdatedBoard(node, 1, driving)
    life.command(TELL)
    life.run(2500)
    assert not driving.edges(PIN_ENABLE)
    life.run(2500)
    assert node.state(1) == IS_CONFIRMED
    assert driving.level[PIN_ENABLE] is True
    assert not any(life.enabled)
    life.close()


# ---- A loss of power ----


def live(node):
    """Start, bring the new image unless it runs, and let it be heard; return whether all is done and nothing lost."""
    choice = node.boot()
    assert choice is not None, "bricked"
    if node.holds(choice.slot, NEW) and not choice.trial:
        return True
    life = UpdatedBoard(node, choice.slot)
    if node.holds(choice.slot, NEW):
        life.command(TELL)
        life.run(3100)
    else:
        assert node.holds(choice.slot, OLD)
        send(life, NEW)
    life.close()
    return False


def update(node):
    """Update to the end; return the number of lives it took."""
    for lives in range(1, 8):
        try:
            if live(node):
                return lives
        except PowerLost:
            pass  # In a word of the boot loader.
    raise AssertionError("the update comes to no end")


WAYS = [Torn.NOT, Torn.ALL, Torn.MIXED]


@pytest.fixture(scope="module")
def steps_of_an_update(core):
    node = fresh(core)
    update(node)
    assert node.steps > 40
    return node.steps


@pytest.mark.parametrize("torn", WAYS)
def test_an_image_starts_in_whichever_step_of_an_update_the_power_goes(core, steps_of_an_update, torn):
    """Each step is torn in one of the ways here, and in all of them below."""
    cut_power(core, range(WAYS.index(torn), steps_of_an_update, len(WAYS)), torn)


@pytest.mark.slow
@pytest.mark.parametrize("torn", WAYS)
def test_an_image_starts_in_whichever_step_and_way_the_power_goes(core, steps_of_an_update, torn):
    cut_power(core, range(steps_of_an_update), torn)
    print(f"{torn.name}: the power went in each of {steps_of_an_update} steps, 0 boards without an image")


def cut_power(core, cuts, torn):
    """The board, its service and the boot loader together; core/boot has all ways in which a step may be torn."""
    for cut in cuts:
        node = fresh(core, seed=cut)
        node.cut, node.torn = cut, torn
        lives = update(node)
        assert node.cut is None
        assert 3 <= lives <= 5, cut
