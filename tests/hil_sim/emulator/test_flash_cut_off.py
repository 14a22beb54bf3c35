"""A word or an erasure of the flash that a loss of power or a reset cuts off, on the bare chip."""

from collections.abc import Callable

from hil_sim.emulator.bench import MILLISECOND, Bench
from tests.hil_sim.emulator.flash_bench import (
    BSY,
    CR,
    FLASH,
    LOCK,
    OPTCR,
    OPTKEYR,
    SECOND,
    SR,
    cut,
    erase,
    finish,
    program,
    reset,
    supply,
    unlock,
)


def cut_off(step: Callable[[Bench], None], fraction: float, seed: int = 1, cut_id: int = 0) -> Bench:
    """Return a chip whose supply went in a step, after it has come back."""
    chip = Bench(memory_seed=seed)
    unlock(chip)
    cut(chip, 1, fraction, cut_id)
    step(chip)
    chip.run(3000 * MILLISECOND)
    assert bool(chip.lib.machine_bench_held(chip.machine))
    reset(chip)
    supply(chip, 3.3)
    reset(chip)
    return chip


def word_after(fraction: float, value: int, **how: int) -> int:
    chip = cut_off(lambda chip: program(chip, 0x40000, value), fraction, **how)
    word = chip.read(FLASH + 0x40000)
    assert chip.read(FLASH + 0x40004) == 0xFFFFFFFF
    assert not chip.report
    chip.close()
    return word


def test_a_word_that_was_cut_off_is_a_mix() -> None:
    words = [word_after(0.5, 0, cut_id=cut_id) for cut_id in range(40)]
    ones = sum(word.bit_count() for word in words)
    assert 0.4 < ones / (32 * 40) < 0.6
    assert len(set(words)) > 35
    assert [word_after(0.5, 0, cut_id=cut_id) for cut_id in range(40)] == words
    assert [word_after(0.5, 0, cut_id=7, seed=seed) for seed in (1, 1, 2)] != words[7:8] * 3


def test_a_word_that_was_cut_off_keeps_ones_that_stay() -> None:
    for cut_id in range(20):
        assert word_after(0.5, 0xFFFF0000, cut_id=cut_id) & 0xFFFF0000 == 0xFFFF0000


def test_the_later_the_more_is_programmed() -> None:
    ones = [
        sum(word_after(fraction, 0, cut_id=cut_id).bit_count() for cut_id in range(20))
        for fraction in (0.01, 0.3, 0.7, 0.99)
    ]
    assert ones == sorted(ones, reverse=True)
    assert ones[0] > 0.85 * 640
    assert ones[3] < 0.15 * 640


def sector_after(fraction: float, **how: int) -> bytes:
    def step(chip: Bench) -> None:
        for offset in range(0x4000, 0x4100, 4):
            program(chip, offset, 0x0F0F0F0F)
            finish(chip)
        erase(chip, 1)

    def all_of_it(chip: Bench) -> None:
        cut(chip, 65, fraction, how.get("cut_id", 0))
        step(chip)

    chip = cut_off(all_of_it, 1.0, how.get("seed", 1))
    content = b"".join(chip.read(FLASH + 0x4000 + n).to_bytes(4, "little") for n in range(0, 0x100, 4))
    assert chip.read(FLASH + 0x3FFC) == chip.read(FLASH + 0x8000) == 0xFFFFFFFF
    chip.close()
    return content


def test_a_sector_that_was_cut_off_is_a_mix() -> None:
    """First ones fall, those that stay as well, then all rise."""
    whole = b"\x0f" * 0x100
    early, middle, late = (sector_after(fraction) for fraction in (0.05, 0.5, 0.99))
    assert early != whole
    assert all(byte & 0xF0 == 0 for byte in early)
    shares = [sum(byte.bit_count() for byte in content) / 2048 for content in (whole, early, middle, late)]
    assert shares[1] < 0.75 * shares[0]
    assert 0.3 < shares[2] < 0.6
    assert shares[3] > 0.95
    assert sector_after(0.5) == middle
    assert sector_after(0.5, cut_id=1) != middle


def test_weak_bits_read_otherwise_at_another_boot_until_they_are_made_anew() -> None:
    chip = cut_off(lambda chip: program(chip, 0x40000, 0), 0.5, cut_id=3)
    seen = set()
    for _ in range(20):
        reset(chip)
        seen.add(chip.read(FLASH + 0x40000))
        assert chip.read(FLASH + 0x40000) in seen
    assert len(seen) > 3
    unlock(chip)
    program(chip, 0x40000, 0)
    finish(chip)
    for _ in range(5):
        reset(chip)
        assert chip.read(FLASH + 0x40000) == 0
    chip.close()


def test_a_reset_cuts_off_too_and_a_finished_step_does_not_care(open_chip: Bench) -> None:
    for offset in range(0, 64, 4):
        program(open_chip, 0x40000 + offset, 0)
        finish(open_chip)
    reset(open_chip)
    assert open_chip.read(CR) == LOCK
    unlock(open_chip)
    erase(open_chip, 6)
    open_chip.run(500 * MILLISECOND)
    reset(open_chip)
    assert not open_chip.read(SR) & BSY
    content = [open_chip.read(FLASH + 0x40000 + offset) for offset in range(0, 64, 4)]
    assert 0 < sum(word.bit_count() for word in content) < 512


def test_steps_are_counted(open_chip: Bench) -> None:
    program(open_chip, 0x40000, 0)
    finish(open_chip)
    open_chip.write(FLASH + 0x40001, 0)
    open_chip.expect("which is not aligned")
    erase(open_chip, 6)
    assert open_chip.lib.machine_bench_flash_steps(open_chip.machine) == 2


def test_option_bytes_that_are_cut_off(chip: Bench) -> None:
    for key in SECOND:
        chip.write(OPTKEYR, key)
    chip.write(OPTCR, 0x0FFFAAEE)
    reset(chip)
    chip.expect("a reset while option bytes are programmed")
