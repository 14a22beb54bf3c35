"""Parameters are saved in flash and come back: the whole way on host boards, also when the power goes."""

from __future__ import annotations

import struct
import zlib

import pytest

from goldfield_protocol import encode
from tests.firmware.core.storage.flash_cells import Torn
from tests.firmware.host_rig import (
    ANCHOR,
    BEACON,
    MS,
    PIN_ENABLE,
    SECOND,
    SENSOR,
    Board,
    Coil,
    beacon,
)
from tests.firmware.services import saved_flash
from tests.firmware.services.saved_flash import (
    COIL_ON,
    DEFAULTS,
    DONE,
    DONE_RESTARTS,
    FLASH_FAILED,
    HEAD,
    KINDS,
    NAMES,
    REFUSED,
    SAVES_A_SLOT,
    SETS,
    WORDS,
    SavedFlash,
    Saving,
    answers,
    ask_to_save,
    bits,
    boot,
    counted,
    in_force,
    put,
    record,
    run_case,
    save,
    telling_steps,
)

MARK, FORMAT = 0x50415200, 1
TORN_SAVES, SAVED_REFUSED = 19, 20


def starts(board: Board) -> int:
    return [m.signals["state"] for m in board.messages("HEARTBEAT")].count(0)


@pytest.mark.parametrize("role", [BEACON, SENSOR, ANCHOR])
def test_what_is_saved_is_in_force_after_the_loss_of_power(role: int) -> None:
    flash = SavedFlash()
    board = flash.board(role)
    board.run(1100 * MS)
    assert save(board, 1200 * MS, node=9, over_current=3.5, code_list__63=41, beacons__511=0.25) == DONE_RESTARTS
    assert starts(board) == 2  # The slot was erased for the first set.
    board.close()
    board = flash.board(role)
    names = ("over_current", "code_list__63", "beacons__511", "survey__191")
    assert in_force(board, names, 20 * MS) == pytest.approx((3.5, 41, 0.25, 0.003))
    board.run(1500 * MS)
    assert counted(board) == {}
    board.close()


def test_a_saved_set_overrules_the_page_and_a_parameter_that_is_not_saved_is_gone() -> None:
    flash = SavedFlash()
    page = {"node": 9, "code": 5, "over_current": 4.0}
    board = flash.board(parameters=page)
    assert in_force(board, ("code", "over_current"), 20 * MS) == (5, 4.0)
    save(board, 100 * MS, code=0)  # A default is as good as any value.
    put(board, 700 * MS, code=77)
    board.run(800 * MS)
    board.close()
    board = flash.board(parameters=page)
    assert in_force(board, ("code", "over_current"), 20 * MS) == (0, 4.0)
    board.close()


def baud_of_the_first_heartbeat(board: Board) -> float:
    """As its first two bytes tell it."""
    board.run(10 * MS)
    return 10 * SECOND / (board.serial[1][0] - board.serial[0][0])


def test_a_saved_rate_is_that_of_the_next_start_and_a_lost_set_brings_back_the_pages() -> None:
    """What the board speaks at does not change before."""
    flash = SavedFlash()
    page = {"node": 9, "serial_rate": 0}
    board = flash.board(parameters=page)
    assert baud_of_the_first_heartbeat(board) == pytest.approx(2_000_000)
    ask_to_save(board, put(board, 20 * MS, serial_rate=3))
    board.run(SECOND)
    start = next(i for i, (time, _) in enumerate(board.serial) if time > 40 * MS)
    assert [m.signals["status"] for m in board.messages("COMMAND_ANSWER")] == [DONE_RESTARTS]
    assert (board.serial[start + 1][0] - board.serial[start][0]) == pytest.approx(10e12 / 2e6, rel=1e-3)
    late = board.serial[-1][0] - board.serial[-2][0]  # It has restarted, as flash was erased.
    assert late == pytest.approx(10e12 / 115_200, rel=1e-3)
    board.close()
    board = flash.board(parameters=page)
    assert baud_of_the_first_heartbeat(board) == pytest.approx(115_200, rel=1e-3)
    board.close()
    for slot in (0, 1):
        flash.carry_out((slot, None, 0))
    board = flash.board(parameters=page)
    assert baud_of_the_first_heartbeat(board) == pytest.approx(2_000_000)
    board.close()


def test_a_new_node_number_is_kept_and_the_old_one_answers_nothing() -> None:
    flash = SavedFlash()
    board = flash.board()
    put(board, 20 * MS, node=12)
    ask_to_save(board, 30 * MS, node=12)
    board.run(300 * MS)
    assert answers(board) == [DONE_RESTARTS]
    board.close()
    board = flash.board()
    board.run(10 * MS)
    assert board.messages("HEARTBEAT")[0].node == 12
    board.close()


def test_four_saves_fill_a_slot_and_each_is_erased_once_in_eight() -> None:
    """Which is the wear that storage.h states: 10,000 erasures of a sector make 80,000 saves."""
    flash = SavedFlash()
    board = flash.board()
    told = [save(board, (1 + 600 * number) * MS, code=number) for number in range(4 * SAVES_A_SLOT)]
    assert told == [DONE_RESTARTS, DONE, DONE, DONE] * 4
    erased = [slot for slot, index, _ in flash.steps if index is None]
    assert erased == [0, 1, 0, 1]
    programmed = len([1 for _, index, _ in flash.steps if index is not None])
    assert programmed / (4 * SAVES_A_SLOT) == pytest.approx(1022, abs=2)
    board.close()


def test_saving_what_is_saved_writes_nothing() -> None:
    flash = SavedFlash()
    board = flash.board()
    save(board, 20 * MS, code=3)
    steps = len(flash.steps)
    assert save(board, SECOND, code=4) == DONE
    assert len(flash.steps) > steps
    steps = len(flash.steps)
    assert save(board, 2 * SECOND) == DONE
    assert save(board, 3 * SECOND, code=4) == DONE
    assert len(flash.steps) == steps
    board.close()


@pytest.mark.parametrize(
    ("named", "node"), [(0, 9), (saved_flash.NAMED, 0), (0, 0)], ids=["no board named", "all nodes", "neither"]
)
def test_a_save_must_name_its_board_and_is_never_broadcast(named: int, node: int) -> None:
    flash = SavedFlash()
    board = flash.board()
    board.send_serial("COMMAND", {"board": named, "argument": 1}, node, saved_flash.SAVE, 20 * MS)
    board.run(300 * MS)
    assert answers(board) == [REFUSED]
    assert not flash.steps
    board.close()


def test_a_save_for_another_board_is_ignored() -> None:
    flash = SavedFlash()
    board = flash.board()
    ask_to_save(board, 20 * MS, named=saved_flash.NAMED + 1)
    board.run(300 * MS)
    assert answers(board) == []
    assert not flash.steps
    board.close()


def test_a_save_that_is_asked_for_twice_is_done_once_and_answered_on_its_link() -> None:
    flash = SavedFlash()
    board = flash.board()
    board.can_in(*encode("COMMAND", {"board": saved_flash.NAMED, "argument": 0}, node=9, index=5), 20 * MS)
    ask_to_save(board, 21 * MS)
    board.run(40 * MS)
    for time in range(40, 400, 10):  # CAN takes its frames.
        board.run(time * MS)
        board.can_sent(len([m for m in board.requests]) % 3, True, time * MS)
    assert answers(board) == []
    assert [index for _, index, _ in flash.steps].count(None) == 1
    board.close()


def driving(flash: SavedFlash) -> Board:
    """A beacon whose coil is driven: it is the sync master."""
    board = beacon(Coil(), parameters={"node": 9, "sync_master": 1, "amplitude": 5.0}, unique_id=saved_flash.UNIQUE)
    flash.attach(board)
    board.run(SECOND)
    assert board.level[PIN_ENABLE] is True
    return board


def test_a_board_that_drives_its_coil_refuses_and_goes_on_driving() -> None:
    flash = SavedFlash()
    board = driving(flash)
    ask_to_save(board, SECOND)
    board.run(1500 * MS)
    assert answers(board) == [COIL_ON]
    assert not flash.steps
    assert not board.edges(PIN_ENABLE, False)
    board.close()


def test_a_board_that_may_pause_saves_with_its_coil_off_and_drives_again() -> None:
    flash = SavedFlash()
    board = driving(flash)
    ask_to_save(board, SECOND, pause=True)
    board.run(3 * SECOND)
    assert answers(board) == [DONE_RESTARTS]
    assert flash.steps
    assert not any(flash.enabled)
    assert len(board.edges(PIN_ENABLE, False)) == 1
    assert board.level[PIN_ENABLE] is True
    put(board, 3 * SECOND, over_current=7.0)  # The next set is appended: no restart.
    beats = starts(board)
    off = len(board.edges(PIN_ENABLE, False))
    board.run(4 * SECOND)
    ask_to_save(board, 4 * SECOND, pause=True)
    board.run(6 * SECOND)
    assert answers(board) == [DONE_RESTARTS, DONE]
    assert starts(board) == beats
    assert not any(flash.enabled)
    assert len(board.edges(PIN_ENABLE, False)) > off
    assert board.level[PIN_ENABLE] is True
    assert counted(board) == {}
    board.close()


@pytest.mark.parametrize("late", range(0, 100, 7))
def test_no_word_is_programmed_with_the_bridge_on_whenever_the_save_comes(late: int) -> None:
    """A drive that is about to start, or starts while the save is taken, is held off."""
    flash = SavedFlash()
    board = beacon(Coil(), parameters={"node": 9, "sync_master": 1, "amplitude": 5.0}, unique_id=saved_flash.UNIQUE)
    flash.attach(board)
    ask_to_save(board, 20 * MS + late * 3 * MS)
    board.run(2 * SECOND)
    assert answers(board) in ([DONE_RESTARTS], [COIL_ON])
    assert not any(flash.enabled)
    assert bool(flash.steps) == (answers(board) == [DONE_RESTARTS])
    assert board.level[PIN_ENABLE] is True
    board.close()


def test_flash_that_takes_nothing_is_told_and_the_set_before_is_kept() -> None:
    flash = SavedFlash()
    board = flash.board()
    save(board, 20 * MS, code=3)
    board.close()
    board = flash.board()
    flash.cells.stuck = {(slot, index): 0xFFFFFFFF for slot in range(2) for index in range(WORDS)}
    assert save(board, 20 * MS, code=4) == FLASH_FAILED
    board.close()
    flash.cells.stuck = {}
    board = flash.board()
    assert in_force(board, ("code",), 20 * MS) == (3,)
    board.close()


# ---- Other images ----


def run_of(name: str, *values: float) -> list[int]:
    parameter = saved_flash.PARAMETERS[name]
    return [parameter.first | parameter.kind << 12 | len(values) << 16, *(bits(name, value) for value in values)]


def put_record(flash: SavedFlash, *records: list[int]) -> None:
    words = [*HEAD, *(word for one in records for word in one)]
    flash.memory[0][0 : len(words)] = words


def test_the_set_of_another_image_gives_what_this_one_knows() -> None:
    """It is as an older image wrote it (few parameters) and as a newer one will (ids, values and a kind of its own)."""
    flash = SavedFlash()
    newer = [60 | 2 << 16, 1, 2]
    words = [MARK | FORMAT, 0x00630000, *run_of("code", 17), *newer, *run_of("over_current", 3.5), *run_of("stream", 2)]
    put_record(flash, record(words, 8))
    board = flash.board(parameters={"node": 9, "waveform": 2})
    assert in_force(board, ("code", "over_current", "stream", "waveform"), 20 * MS) == (17, 3.5, 0, 2)
    board.run(1500 * MS)
    assert counted(board) == {SAVED_REFUSED: 3}
    assert save(board, 2 * SECOND) == DONE
    board.close()
    board = flash.board()  # What this image does not know it has not saved, and what it has saved it takes.
    board.run(1500 * MS)
    assert counted(board) == {}
    assert in_force(board, ("code", "waveform"), 1600 * MS) == (17, 2)
    board.close()


def test_a_set_of_another_format_leaves_the_page_in_force() -> None:
    flash = SavedFlash()
    put_record(flash, record([MARK | FORMAT + 1, 0, *run_of("code", 17)], 8))
    board = flash.board(parameters={"node": 9, "code": 5})
    assert in_force(board, ("code",), 20 * MS) == (5,)
    board.run(1500 * MS)
    assert counted(board) == {SAVED_REFUSED: 1}
    board.close()


@pytest.mark.parametrize("sets", [1, 2])
def test_a_set_of_which_a_bit_has_changed_is_passed_over_and_told(sets: int) -> None:
    """The set before it is in force, or the page if there is none."""
    flash = SavedFlash()
    both = [record([MARK | FORMAT, 0, *run_of("code", 17 + number)], 8 + number) for number in range(sets)]
    both[-1][5] ^= 1 << 9
    put_record(flash, *both)
    board = flash.board(parameters={"node": 9, "code": 5})
    assert in_force(board, ("code",), 20 * MS) == (5 if sets == 1 else 17,)
    board.run(1500 * MS)
    assert counted(board) == {TORN_SAVES: 1}
    board.close()
    board = flash.board(parameters={"node": 9, "code": 5})
    board.run(1500 * MS)
    assert counted(board) == {}  # It is told once.
    board.close()


# ---- A loss of power ----


@pytest.fixture(scope="module", params=KINDS)
def saving(request: pytest.FixtureRequest) -> Saving:
    return Saving(str(request.param))


def test_the_ways_to_save_differ_as_they_should(saving: Saving) -> None:
    """An erasure comes first, behind the four words of a head that counted until then, or not at all.

    The steps are those of one set.
    """
    erasures = [place for place, (_, index, _) in enumerate(saving.steps) if index is None]
    assert erasures == {"appended": [], "again": [4]}.get(saving.kind, [0])
    assert 1018 <= len(saving.steps) <= 1032
    assert {slot for slot, _, _ in saving.steps} == {1 if saving.kind == "full" else 0}


@pytest.mark.parametrize("torn", [Torn.NOT, Torn.ALL, Torn.MIXED])
def test_a_board_that_loses_its_power_leaves_what_its_steps_tell(saving: Saving, torn: Torn) -> None:
    """So a case may do the steps before the loss instead of running the board up to it. The dead board is silent."""
    for step in (0, 1, 7, 500, len(saving.steps) - 1):
        run, done = saving.flash_at(0, 5), saving.flash_at(step, 5)
        run.cut, run.torn = step, torn
        board = run.board()
        ask_to_save(board, put(board, 20 * MS, **dict(zip(NAMES, saving.sets[1], strict=True))) + MS)
        board.run(SECOND)
        assert run.lost
        assert run.steps == saving.steps[:step]
        assert answers(board) == []
        board.close()
        done.cells.tear(torn, *saving.steps[step])
        assert [list(slot[0:WORDS]) for slot in run.memory] == [list(slot[0:WORDS]) for slot in done.memory]


@pytest.mark.parametrize("torn", Torn)
def test_the_old_set_or_the_new_one_is_in_force_after_a_loss_of_power(saving: Saving, torn: Torn) -> None:
    """At the steps where something else begins, several times."""
    for step in telling_steps(saving):
        for seed in range(2):
            run_case(saving, torn, step, seed)


@pytest.mark.slow
@pytest.mark.parametrize("torn", Torn)
def test_the_old_set_or_the_new_one_is_in_force_whenever_the_power_goes(saving: Saving, torn: Torn) -> None:
    """At each step of a save."""
    for step in range(len(saving.steps)):
        run_case(saving, torn, step, 0)


def test_a_case_that_fails_prints_what_runs_it_again(
    saving: Saving, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(saving, "sets", (DEFAULTS[::-1], SETS[0][::-1]))
    with pytest.raises(AssertionError) as failed:
        run_case(saving, Torn.SOME, 3, 1)
    printed = str(failed.value).splitlines()[0].split(": python -m tests.firmware.services.saved_flash ")[1].split()[0]
    assert printed == f"{saving.kind}:SOME:3:1"
    assert saved_flash.main([printed]) == 0
    assert printed in capsys.readouterr().out


def test_a_loss_of_power_while_a_set_is_saved_is_told_at_the_next_start() -> None:
    saving = Saving("appended")
    flash = saving.flash_at(600, 1)
    board = flash.board()
    board.run(1500 * MS)
    assert counted(board) == {TORN_SAVES: 1}
    assert in_force(board, NAMES, 1600 * MS) == saving.sets[0]
    board.close()
    assert boot(flash) == saving.sets[0]


def test_a_name_that_is_a_record_of_the_store_is_not_saved() -> None:
    """Found by the fuzzer: whoever may set a name could have a loss of power empty the board's set."""
    flash = SavedFlash()
    board = flash.board(SENSOR)
    assert save(board, SECOND, noise=2e-7) == DONE_RESTARTS
    head = [0x47520000, 7]
    record_in_name = [*head, zlib.crc32(struct.pack("<2I", *head)), 0x5AC3A53C]
    assert record_in_name[2] <= 0x7F7F7F7F  # The board takes it as a part of a name.
    named = {f"name__{element}": word for element, word in enumerate(record_in_name)}
    assert save(board, 2 * SECOND, **named) == FLASH_FAILED
    assert save(board, 3 * SECOND, name__3=0, noise=3e-7) == DONE
    board.close()
