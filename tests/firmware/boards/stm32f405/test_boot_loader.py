"""The boot loader on the emulated chip: it starts the images as they are built, and loses its power in each word."""

from __future__ import annotations

import importlib.util
import itertools
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from elftools.elf.elffile import ELFFile

from goldfield_protocol.image import CODE_OFFSET, ERASED, MARK, SLOTS, STM32F405, Header, head
from hil_sim.clib import ROOT
from hil_sim.emulator.elf_image import read_image
from hil_sim.emulator.emulator import Configuration, Emulator
from tests.firmware.boards.stm32f405.boot_flash import BOOT, MS, Run, boot_loader, flash, image, probed, state_of
from tests.firmware.boards.stm32f405.test_reset import RESTART, RUN_MS, told
from tests.firmware.core.boot.slots import KEY, OTHER_KEY, public

A, B = 0, 1
CONFIRMED_MS, TRIAL_MS = 400, 3200
"""After so long an image runs that was confirmed, or that is on trial, whose signature takes its time twice."""
PENDING = (2, ERASED - 2, ERASED, MARK)
TRIED = (*PENDING, MARK)
CONFIRMED = (*TRIED, MARK, MARK)
LED = 20
"""PB4."""


def test_what_a_probe_has_written_starts_and_nothing_is_written() -> None:
    cells = flash(*boot_loader(), probed())
    run = Run(cells, CONFIRMED_MS, to_the_end=True)
    assert (run.slot, run.steps, run.violations) == (A, 0, 0), run.report
    assert run.cells == cells
    bare = Run(flash(*boot_loader(None), probed()), CONFIRMED_MS)
    assert (bare.slot, bare.steps) == (A, 0)


def test_a_pending_image_is_tried_once_and_the_one_before_comes_back() -> None:
    first = Run(flash(*boot_loader(), probed(), image()), TRIAL_MS)
    assert (first.slot, first.steps, first.violations) == (B, 2, 0), first.report
    assert state_of(first.cells, B)[:5] == TRIED
    second = Run(first.cells, CONFIRMED_MS)  # It has not confirmed itself.
    assert (second.slot, second.steps, second.violations) == (A, 2, 0)
    assert state_of(second.cells, B)[5:] == (0, 0)
    third = Run(second.cells, CONFIRMED_MS)
    assert (third.slot, third.steps) == (A, 0)


def test_a_confirmed_image_starts_and_gives_way_when_it_is_damaged() -> None:
    good = Run(flash(*boot_loader(), probed(), image(state=CONFIRMED)), CONFIRMED_MS)
    assert (good.slot, good.steps, good.violations) == (B, 0, 0)
    address, data = image(state=CONFIRMED)
    damaged = bytearray(data)
    damaged[-100] ^= 4
    run = Run(flash(*boot_loader(), probed(), (address, bytes(damaged))), CONFIRMED_MS)
    assert (run.slot, run.steps) == (A, 0)


def flipped(offset: int) -> tuple[int, bytes]:
    address, data = image()
    changed = bytearray(data)
    changed[offset] ^= 1
    return address, bytes(changed)


@pytest.mark.parametrize(
    "part",
    [flipped(CODE_OFFSET + 5000), flipped(70), image(key=OTHER_KEY), image("beacon"), image(older=True)],
    ids=["a bit of the code", "a bit of the signature", "another's signature", "another role", "an older version"],
)
def test_what_is_wrong_is_not_started_and_never_looked_at_again(part: tuple[int, bytes]) -> None:
    run = Run(flash(*boot_loader(), probed(), part), TRIAL_MS)
    assert (run.slot, run.steps) == (A, 2)
    assert state_of(run.cells, B)[3:] == (MARK, ERASED, 0, 0)
    again = Run(run.cells, CONFIRMED_MS)
    assert (again.slot, again.steps) == (A, 0)


def test_an_older_image_that_is_forced_starts() -> None:
    forced = (2, ERASED - 2, MARK, MARK)
    assert Run(flash(*boot_loader(), probed(), image(older=True, state=forced)), TRIAL_MS).slot == B


def test_without_a_key_no_new_image_starts() -> None:
    assert Run(flash(*boot_loader(None), probed(), image()), CONFIRMED_MS).slot == A


def hang(header: Header, code: bytearray) -> None:
    """Let the image stand still at its first instruction."""
    entry = struct.unpack_from("<I", code, 4)[0] & ~1
    offset = entry - header.address - CODE_OFFSET
    code[offset : offset + 2] = bytes.fromhex("fee7")  # b .


def test_an_image_that_hangs_at_its_first_instruction_ends_by_the_watchdog() -> None:
    cells = flash(*boot_loader(), probed(), image(patch=hang))
    hanging = Run(cells, TRIAL_MS)
    assert hanging.slot == B
    over = Run(cells, TRIAL_MS + 2500, to_the_end=True)
    assert (over.slot, over.steps) == (A, 4)


def test_with_nothing_to_start_the_led_flashes() -> None:
    run = Run(flash(*boot_loader()), 1000)
    assert run.in_boot
    changes = [time for pin, _, time in run.levels if pin == LED]
    apart = [(b - a) / MS for a, b in itertools.pairwise(changes[2:])]
    assert len(apart) >= 5
    assert all(60 < one / run.slow < 140 for one in apart)


# ---- What outlives a reset ----


def finish_image():
    """The build's tool as a module."""
    place = ROOT / "firmware/tools/finish_image.py"
    specification = importlib.util.spec_from_file_location("finish_image", place)
    module = importlib.util.module_from_spec(specification)
    sys.modules["finish_image"] = module
    specification.loader.exec_module(module)
    return module


def test_the_cause_of_a_reset_and_what_outlives_it_pass_the_boot_loader(tmp_path: Path) -> None:
    board = "firmware/boards/stm32f405"
    objects = map(str, sorted((ROOT / "build/firmware" / board).glob("*.o")))
    cpu = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O1", "-std=c11"]
    link = ["-nostartfiles", "--specs=nano.specs", "-Wl,--gc-sections", "-T", str(ROOT / board / "stm32f405.ld")]
    source, probe = Path(__file__).parent / "reset_probe.c", tmp_path / "reset_probe.elf"
    command = ["arm-none-eabi-gcc", *cpu, f"-I{ROOT / 'firmware'}", str(source), *objects, *link, "-o", str(probe)]
    subprocess.run(command, check=True)
    with probe.open("rb") as file:
        code = finish_image().code_of(ELFFile(file), SLOTS[0])
    front = head(Header(len(code), SLOTS[0], STM32F405, 1, 1, 1), code, confirmed=True)
    page = (0x080E0000, bytes([RESTART]) + bytes(1000))
    chip = Emulator(probe, Configuration(), cells=flash(*boot_loader(), (SLOTS[0], front + code), page))
    assert chip.run(int((RUN_MS + 200) * MS)), chip.report()
    second = told(chip)
    chip.close()
    assert (second["cause"], second["uptime_s"], second["crash"]) == ("software", 1, None)
    assert second["counts"] == {"power_on": 1, "software": 1}
    assert (second["word"], second["run"]) == (0x600D0000, 1)


def test_an_image_and_a_boot_loader_are_flashed_together() -> None:
    """As with a probe: the boot loader in sector 0, not what starts an image alone."""
    chip = Emulator(ROOT / "build/firmware/beacon.elf", boot=BOOT, key=public(KEY))
    first, _ = read_image(BOOT)
    assert chip.memory(0x08000000, 64) == first[0][1][:64]
    assert chip.memory(0x08003FC4, 32) == public(KEY)
    assert chip.run(300 * MS)
    assert chip.register(15) >= SLOTS[0]
    chip.close()
    alone = Emulator(ROOT / "build/firmware/beacon.elf")
    assert alone.memory(0x08000000, 8) == alone.memory(SLOTS[0] + CODE_OFFSET, 8)
    assert alone.memory(0x08000008, 8) == b"\xff" * 8
    alone.close()


# ---- A loss of power ----

CUTS = [
    pytest.param(PENDING, TRIAL_MS, id="tried"),
    pytest.param(TRIED, CONFIRMED_MS, id="rejected"),
    pytest.param((*TRIED, MARK), CONFIRMED_MS, id="settled"),
]


FRACTIONS = (0.0, 0.4, 0.6, 1.0)
"""Parts of a word's time after which the power goes."""


@pytest.mark.parametrize(("state", "ms"), CUTS)
def test_the_power_goes_in_each_word_of_the_boot_loader(state: tuple[int, ...], ms: int) -> None:
    """Each fraction in one of the two words."""
    cut_power(state, ms, [(1 + number % 2, number) for number in range(len(FRACTIONS))])


@pytest.mark.slow
@pytest.mark.parametrize(("state", "ms"), CUTS)
def test_the_power_goes_in_each_word_at_each_fraction(state: tuple[int, ...], ms: int) -> None:
    cut_power(state, ms, [(step, number) for step in (1, 2) for number in range(len(FRACTIONS))])


def cut_power(state: tuple[int, ...], ms: int, cuts: list[tuple[int, int]]) -> None:
    """One of the two images runs at the next start, and comes to rest with the same from then on."""
    cells = flash(*boot_loader(), probed(), image(state=state))
    for step, number in cuts:
        fraction = FRACTIONS[number]
        case = f"step {step}, fraction {fraction}, id {number}"
        lost = Run(cells, ms, cut=(step, fraction, number), seed=number + 1)
        assert lost.steps == step, case
        later = lost.cells
        seen = []
        for _ in range(3):
            run = Run(later, ms, seed=number + 1)
            assert run.slot in (A, B), (case, run.report)
            later = run.cells
            seen.append(run.slot)
        assert run.steps == 0 or seen[-1] == A, case
        assert seen in ([A, A, A], [B, B, B], [B, A, A], [A, B, A]), (case, seen)
    print(f"{len(cuts)} losses of power, 0 chips without an image")


def test_what_a_start_costs() -> None:
    """The figures of image.h, at one cycle an instruction."""
    confirmed = Run(flash(*boot_loader(), probed(), image(state=CONFIRMED)), CONFIRMED_MS).probes["image_intact"]
    length = len(image()[1])
    trial = Run(flash(*boot_loader(), probed(), image()), TRIAL_MS).probes["image_check"]
    print(f"{length} bytes: CRC {confirmed.largest} instructions, check with its signature {trial.largest}")
    assert confirmed.largest < 11 * length
    assert trial.largest < 30_000_000
