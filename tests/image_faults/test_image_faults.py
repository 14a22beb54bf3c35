"""A sample of the trials on the images as they are built, and that what is wrong would be seen."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from tests.command import read_results
from tests.firmware.host_rig import (
    BEACON,
    IMAGES,
    MS,
    PIN_ENABLE,
    PINS_BRIDGE,
    SECOND,
    SENSOR,
    US,
    Board,
    gold_chips,
)
from tests.firmware.services.saved_flash import REFUSED, answers, ask_to_save, put
from tests.image_faults.__main__ import WORKLOADS, main, of_these, upsets_of
from tests.image_faults.driven import CHIP, CODE, Driven, above_us, chips, driven, history, is_code
from tests.image_faults.image import instructions, module_of, name_of, place_of
from tests.image_faults.linked import NEW, kept, linked, quiet, started
from tests.image_faults.table import shown, wrong
from tests.image_faults.trial import NOT_STRUCK, Outcome, Upset, ready, run
from tests.image_faults.workload import BEACON_IMAGE, DANGEROUS, NOTHING, SAID, VERDICTS, WRONG, Workload, told


def named(name: str) -> Workload:
    return next(one for one in WORKLOADS if one.name == name)


def outcomes(
    workload: Workload,
    *,
    functions: tuple[str, ...] = (),
    places: tuple[str, ...] = (),
    every: int = 1,
    kind: str = "skip",
) -> list[Outcome]:
    """Run the upsets of some functions, or of some variables, or a share of all."""
    bench, visits, sound = ready(workload)
    own = instructions(workload.image)
    found = [
        one
        for one in upsets_of(workload, visits, (kind,))
        if not functions or one.kind == "ram" or own[one.address].function in functions
    ]
    if places:
        held = [place_of(workload.image, place) for place in places]
        found = [one for one in found if any(one.address in addresses for addresses in held)]
    assert found
    done = list(run(workload, bench, found[::every], sound, 1))
    bench.close()
    return done


def check(done: list[Outcome]) -> None:
    assert not wrong(done), [(one.id, one.function, one.why) for one in wrong(done)]
    assert {one.verdict for one in done} <= {*VERDICTS, NOT_STRUCK}


# ---- Samples ----


def test_no_instruction_of_the_latch_is_needed_alone() -> None:
    """One that was skipped, in front of the store of the cause, once let the drive go on unwatched for ever."""
    done = outcomes(named("look1"), functions=("latch_set",))
    assert len(done) >= 15
    check(done)


@pytest.mark.slow
def test_no_instruction_that_looks_at_a_current_is_needed_alone() -> None:
    """A branch of these, skipped, once ended the drive by a cause that is none, and none was told."""
    done = outcomes(named("look1"), functions=("drive_current",))
    assert len(done) >= 60
    check(done)


def test_no_instruction_that_asks_for_the_key_is_needed_alone() -> None:
    """Each of these, skipped, once let a stranger change the node's number or a parameter."""
    done = outcomes(named("locked"), functions=("access_granted", "parameter_requests_set"))
    assert len(done) >= 30
    check(done)


def test_no_instruction_that_hands_a_request_on_is_needed_alone() -> None:
    """The move of the index, skipped, once changed another parameter in the place of the one that was meant."""
    done = outcomes(named("frames"), functions=("requests_take", "parameter_requests_set"))
    assert len(done) >= 100
    check(done)


@pytest.mark.slow
def test_no_instruction_that_orders_the_slots_is_needed_alone() -> None:
    """The store of the second place, skipped, once started an older image: the newer one was never looked at."""
    done = outcomes(named("older"), functions=("select_open",))
    assert len(done) >= 25
    check(done)


@pytest.mark.slow
def test_no_instruction_that_begins_the_boot_loader_is_needed_alone() -> None:
    """The first of all, skipped, hid a confirmed image, and the place of a word another rejected it: both began B's."""
    done = outcomes(named("older"), functions=("Reset_Handler", "flash_program"))
    assert len(done) >= 80
    check(done)


SAVING = ("parameters_entry", "parameter_set_write", "storage_save", "storage_step", "requests_step")
STORING = ("store_save", "store_next")


@pytest.mark.slow
def test_no_instruction_that_saves_a_set_is_needed_alone() -> None:
    """Seven of these, skipped, once had a save answered by `ok` that had kept the set before."""
    done = outcomes(named("save"), functions=SAVING)
    assert len(done) >= 200
    check(done)


@pytest.mark.slow
def test_no_instruction_of_the_store_is_needed_alone() -> None:
    """Four of these, skipped, once had the store say that it had saved what the next start did not find."""
    done = outcomes(named("save"), functions=STORING)
    assert len(done) >= 200
    check(done)


SAMPLES = [
    ("look0", 131),
    ("look2", 137),
    ("before", 211),
    ("locked", 37),
    ("frames", 41),
    ("load", 83),
    ("save", 149),
    ("erase", 151),
    ("older", 59),
]


@pytest.mark.parametrize(("name", "every"), SAMPLES)
def test_a_sample_of_skips(name: str, every: int) -> None:
    check(outcomes(named(name), every=3 * every))


@pytest.mark.slow
@pytest.mark.parametrize(("name", "every"), SAMPLES)
def test_three_times_as_many_skips(name: str, every: int) -> None:
    check(outcomes(named(name), every=every))


def test_a_sample_of_flips() -> None:
    check(outcomes(named("look1"), every=67, kind="flip"))
    check(outcomes(named("before"), every=997, kind="ram"))


@pytest.mark.slow
def test_no_bit_of_what_makes_the_current_is_needed_alone() -> None:
    """Four bits of the sense's amperes once had another current flow, and one the drive end: nobody was told."""
    done = outcomes(
        named("before"), places=("beacon.drive.current[0].config.sense_A", "beacon.drive.wanted"), kind="ram"
    )
    assert len(done) == 40
    check(done)


def test_an_upset_does_the_same_each_time(capsys: pytest.CaptureFixture[str]) -> None:
    workload = named("locked")
    bench, visits, _ = ready(workload)
    bench.close()
    case = upsets_of(workload, visits, ("flip",))[77].id
    assert main(["--workload", "locked", "--case", case]) == 0
    first = json.loads(capsys.readouterr().out)
    assert main(["--workload", "locked", "--case", case]) == 0
    assert json.loads(capsys.readouterr().out) == first
    assert first["with"]["verdict"] in VERDICTS


# ---- Parameters that nobody has set ----


def test_a_parameter_that_has_changed_by_itself_ends_in_a_reset_that_is_told() -> None:
    board = quiet()
    board.run(100 * MS)
    place = place_of(BEACON_IMAGE, "beacon.node.parameters.bits")
    board.emulator.flip_memory(place.start + 7 * 4 + 2, 0x10)
    ask_to_save(board, 101 * MS)
    board.run(150 * MS)
    assert answers(board) == [REFUSED]
    board.run(1400 * MS)
    assert told(board, 200 * MS).resets == 1
    before = quiet()
    before.run(100 * MS)
    assert board.emulator.memory(place.start, len(place)) == before.emulator.memory(place.start, len(place))
    before.close()
    board.run(4 * SECOND)
    assert told(board, 1400 * MS).resets == 0
    board.close()


@pytest.mark.parametrize(("name", "byte"), [("current[0].config.sense_A", 2), ("wanted", 0)])
def test_a_bit_that_flips_in_what_makes_the_current_ends_in_a_reset_that_is_told(name: str, byte: int) -> None:
    board = quiet()
    board.run(100 * MS)
    board.emulator.flip_memory(place_of(BEACON_IMAGE, f"beacon.drive.{name}").start + byte, 1)
    board.run(300 * MS)
    assert told(board, 100 * MS).resets == 1
    board.run(SECOND)
    assert told(board, 300 * MS).resets == 0
    board.close()


@pytest.mark.parametrize(
    ("role", "name", "bit"), [(BEACON, "beacon", 0), (BEACON, "beacon", 31), (SENSOR, "sensor", 17)]
)
def test_a_chip_clock_that_counts_other_chips_than_the_board_ends_in_a_reset_that_is_told(
    role: int, name: str, bit: int
) -> None:
    """Its place, moved by two bytes, once had a board drive chips of the longest length, and say that it runs."""
    image = BEACON_IMAGE.with_name(IMAGES[role])
    board = Board(role, {"node": 9}, emulated=True)
    board.run(100 * MS)
    board.emulator.flip_memory(place_of(image, f"{name}.timing.clock.chip").start + bit // 8, 1 << bit % 8)
    board.run(300 * MS)
    assert told(board, 100 * MS).resets == 1
    board.run(SECOND)
    assert told(board, 300 * MS).resets == 0
    board.close()


@pytest.mark.parametrize("bit", [0, 3])
def test_a_cause_whose_channel_is_none_of_those_driven_is_told(bit: int) -> None:
    """One coil is driven: bit 0 leads to the second, bit 3 to none that a board has."""
    fault = 450 * MS
    board = driven()[0].start()
    board.run(fault + MS)
    assert not board.level[PIN_ENABLE]
    board.emulator.flip_memory(place_of(BEACON_IMAGE, "beacon.drive.channel").start, 1 << bit)
    since = fault + 10 * MS  # What was told at once has left.
    board.run(since + 1200 * MS)
    seen = told(board, since)
    assert (seen.causes, seen.resets) == (["over_current"], 0)
    board.close()


def test_a_save_finds_in_the_flash_alone_what_is_kept() -> None:
    """A word that was written astray, over the store's phase, once had it write over the end of the set that is kept.

    There the power is lost, so that the new set is not there yet.
    """
    done, writes_a_record = 3, 9
    board = quiet(cells=kept())
    board.run(100 * MS)
    place = place_of(BEACON_IMAGE, "beacon.node.storage.store.phase").start
    assert board.emulator.memory(place, 1)[0] == done
    board.emulator.flip_memory(place, done ^ writes_a_record)
    board.emulator.cut_flash(4, 0.5)
    ask_to_save(board, put(board, 100 * MS, **NEW) + MS)
    board.run(300 * MS)
    assert board.emulator.flash_steps() == 4
    assert started(board.emulator.cells()) == started(kept())
    board.close()


@pytest.mark.parametrize(("name", "register", "bit"), [("save", 1, 6), ("save", 2, 5), ("erase", 2, 5)])
def test_a_save_of_other_words_than_those_meant_is_none(name: str, register: int, bit: int) -> None:
    """Place and number of the words are handed over in r1 and r2 (AAPCS): either might lead to a part of a set."""
    workload = named(name)
    bench, visits, sound = ready(workload)
    entry = workload.chip(bench).symbols["store_save"] & ~1
    check(list(run(workload, bench, [Upset(name, "flip", entry, visits[entry], register, bit)], sound, 1)))
    bench.close()


# ---- What would be seen ----


class Played:
    """What came out of a board, as this test has it."""

    def __init__(self, begin: int, end: int, amperes: float = 8.0) -> None:
        self.pins = [(begin, PIN_ENABLE, True), (end, PIN_ENABLE, False)]
        self.analog = ([(begin, amperes * 3.3 / 16.0)], [])
        for place, sign in enumerate(np.resize(gold_chips(CODE), (end - begin) // CHIP)):
            at = begin + place * CHIP
            self.pins += [(at, PINS_BRIDGE[0][0], bool(sign > 0)), (at, PINS_BRIDGE[0][1], bool(sign < 0))]


def test_the_current_is_that_of_bridge_and_driver() -> None:
    board, fault = Played(10 * MS, 30 * MS), 20 * MS
    spans = history(board, fault, 40 * MS)  # type: ignore[arg-type]
    assert above_us(spans) == pytest.approx((30 * MS - fault) / US)
    assert above_us(history(board, 50 * MS, 40 * MS)) == 0.0  # type: ignore[arg-type]
    assert {round(abs(amperes), 9) for a, b, amperes in spans if b <= 10 * MS or a >= 30 * MS} == {0.0}
    assert above_us(history(Played(10 * MS, 30 * MS, 12.1), 50 * MS, 40 * MS)) == 20_000  # type: ignore[arg-type]


def test_chips_are_the_codes_or_not() -> None:
    spans = history(Played(0, 100 * CHIP), 1 << 60, 100 * CHIP)  # type: ignore[arg-type]
    found = chips(spans, 20 * CHIP, 70 * CHIP)
    assert found is not None
    assert len(found) > 40
    assert is_code(found)
    changed = found.copy()
    changed[20] *= -1
    assert not is_code(changed)
    assert not is_code(None)


SOUND = {
    "causes": ["over_current"],
    "resets": 0,
    "crashed": False,
    "messages": 3,
    "state": "",
    "running": True,
    "headroom_lost": False,
}
SOUND |= {"above_us": 21.9, "drives": True, "code": True, "level_A": 8.0}


@pytest.mark.parametrize(
    ("change", "verdict"),
    [
        ({}, NOTHING),
        ({"above_us": 97.0}, NOTHING),
        ({"above_us": 99.0}, SAID),
        ({"above_us": 346.3}, DANGEROUS),
        ({"causes": ["stale"]}, SAID),
        ({"resets": 1}, SAID),
        ({"causes": []}, WRONG),
        ({"causes": [], "messages": 0}, SAID),
        ({"code": False}, WRONG),
        ({"level_A": 7.7}, WRONG),
        ({"level_A": 7.9}, NOTHING),
        ({"running": False}, SAID),
    ],
)
def test_verdicts_of_a_drive(change: dict[str, object], verdict: str) -> None:
    assert Driven("look", 0, 0).judge(SOUND | change, SOUND).verdict == verdict


def test_verdicts_of_a_link() -> None:
    workload = linked()[0]
    sound = SOUND | {"changed": {"7": 1080033280}, "values": [[7, 0, 3584]], "answers": []}
    assert workload.judge(sound, sound).verdict == NOTHING
    for change, verdict in (
        ({"changed": {"7": 1080033280, "9": 5}}, WRONG),
        ({"changed": {"7": 5}}, WRONG),
        ({"changed": {"7": 5}, "values": [[7, 0, 9]]}, SAID),
        ({"changed": {}}, WRONG),
        ({"changed": {}, "values": []}, SAID),
    ):
        assert workload.judge(sound | change, sound).verdict == verdict


# ---- Images, results, the table ----


def test_each_source_file_has_its_module() -> None:
    assert module_of("firmware/core/drive/current.c") == "current"
    assert module_of("firmware/core/drive/latch.c") == "protection"
    assert module_of("firmware/services/node.c") is None


def test_instructions_are_those_of_the_disassembler(tmp_path: Path) -> None:
    """Literal pools are none, and each begins where arm-none-eabi-objdump has it begin."""
    import re
    import subprocess

    text = subprocess.run(
        ["arm-none-eabi-objdump", "-d", "--no-show-raw-insn", str(BEACON_IMAGE)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    listed = {
        int(place, 16)
        for place, word in re.findall(r"^ ([0-9a-f]{7}):\s+(\S+)", text, re.M)
        if not word.startswith(".")
    }
    own = instructions(BEACON_IMAGE)
    assert set(own) <= listed
    whole = {one.function for one in own.values()}
    assert {"latch_set", "current_sample", "hal_drive_enable", "frame_decode"} <= whole
    assert len([at for at in listed if own.get(at - 2) or at in own]) >= len(own)


def test_results_of_other_builds_do_not_count_and_cut_off_lines_neither(tmp_path: Path) -> None:
    path, ours = tmp_path / "outcomes.jsonl", name_of(BEACON_IMAGE)
    one = Outcome("look0/skip/08021234", ours, "board", "f", SAID, "reset")
    other = Outcome("look0/skip/08021236", "another", "board", "f", DANGEROUS, "")
    path.write_text(json.dumps(asdict(one)) + "\n" + json.dumps(asdict(other)) + "\n" + '{"id": "look0/sk')
    found = of_these(read_results(path, Outcome), WORKLOADS)
    assert found == [one]
    table = shown(found, WORKLOADS)
    assert "skips in board" in table
    assert not wrong(found)


def test_an_upset_has_an_id_that_runs_it_again() -> None:
    assert Upset("look0", "skip", 0x8021234, 5).id == "look0/skip/08021234"
    assert Upset("look0", "flip", 0x8021234, 5, 3, 31).id == "look0/flip/08021234/3/31"
    assert Upset("before", "ram", 0x20001234, 5, 0, 7).id == "before/ram/20001234/7"
    assert main(["--case", "nowhere/skip/08021234"]) == 2
    assert [one.name for one in driven()] == ["look0", "look1", "look2", "before", "start"]
