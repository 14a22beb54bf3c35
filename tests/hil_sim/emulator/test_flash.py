"""Programming and erasing the flash, on the bare chip (RM0090 chapter 3, F405/407; times of the data sheet DS8626)."""

from collections.abc import Callable, Iterator

import pytest

from hil_sim.emulator.bench import MICROSECOND, MILLISECOND, Bench
from tests.hil_sim.emulator.flash_bench import (
    ACR,
    BSY,
    CR,
    EOP,
    EOPIE,
    ERRIE,
    FIRST,
    FLASH,
    INTERRUPT,
    KEYR,
    LOCK,
    MER,
    OPERR,
    OPTCR,
    OPTKEYR,
    PG,
    PGAERR,
    PGPERR,
    PGSERR,
    SECOND,
    SECTORS,
    SER,
    SR,
    STRT,
    WRPERR,
    X8,
    X16,
    X32,
    X64,
    ends_after,
    erase,
    erase_and_wait,
    finish,
    program,
    reset,
    supply,
    unlock,
)

# ---- Locks ----


def test_two_keys_unlock_and_lock_locks(chip: Bench) -> None:
    assert chip.read(CR) == LOCK
    unlock(chip)
    assert chip.read(CR) == 0
    chip.write(CR, X32 | LOCK)
    assert chip.read(CR) == X32 | LOCK
    chip.write(CR, X16)
    chip.expect("FLASH_CR: written 0x00000100 while locked")
    assert chip.read(CR) == X32 | LOCK
    unlock(chip)
    assert chip.read(CR) == X32


@pytest.mark.parametrize("keys", [(1,), (FIRST[1],), (FIRST[0], FIRST[0]), (FIRST[0], FIRST[1], FIRST[0])])
def test_a_wrong_key_is_a_bus_fault_and_locks_until_reset(chip: Bench, keys: tuple[int, ...]) -> None:
    *right, wrong = keys
    for key in right:
        chip.write(KEYR, key)
    assert chip.refused(KEYR, wrong)
    chip.expect("is not the next key of the sequence: FLASH_CR is locked until reset")
    assert chip.read(CR) == LOCK
    assert chip.refused(KEYR, FIRST[0])
    chip.expect("is not the next key")
    reset(chip)
    unlock(chip)
    assert chip.read(CR) == 0


@pytest.mark.parametrize("keys", [(1,), (SECOND[0], SECOND[0])])
def test_a_wrong_option_key_is_a_bus_fault_and_locks_until_reset(chip: Bench, keys: tuple[int, ...]) -> None:
    *right, wrong = keys
    for key in right:
        chip.write(OPTKEYR, key)
    assert chip.refused(OPTKEYR, wrong)
    chip.expect("is not the next key of the sequence: FLASH_OPTCR is locked until reset")
    assert chip.refused(OPTKEYR, SECOND[0])
    chip.expect("is not the next key")
    reset(chip)
    for key in SECOND:
        chip.write(OPTKEYR, key)
    assert not chip.read(OPTCR) & 1


# ---- Programming ----


@pytest.mark.parametrize("size", [X8, X16, X32])
def test_a_program_takes_16_us_and_only_its_cells(open_chip: Bench, size: int) -> None:
    width = 1 << (size >> 8)
    program(open_chip, 0x40010, 0x00, size)
    assert ends_after(open_chip, 16 * MICROSECOND)
    assert open_chip.read(FLASH + 0x40010) == 0xFFFFFFFF << 8 * width & 0xFFFFFFFF
    assert open_chip.read(FLASH + 0x4000C) == open_chip.read(FLASH + 0x40014) == 0xFFFFFFFF
    assert open_chip.read(SR) == 0
    assert open_chip.read(CR) == size | PG


def test_programming_only_clears_bits(open_chip: Bench) -> None:
    program(open_chip, 0x40000, 0x12345678)
    finish(open_chip)
    program(open_chip, 0x40000, 0xFFFF0F0F)
    finish(open_chip)
    assert open_chip.read(FLASH + 0x40000) == 0x12345678 & 0xFFFF0F0F


def test_a_load_waits_for_the_end(open_chip: Bench) -> None:
    begin = open_chip.now
    program(open_chip, 0x40000, 5)
    assert open_chip.read(FLASH + 0x40000) == 5
    assert open_chip.now - begin == 16 * MICROSECOND


def test_a_bus_master_does_not_read_a_busy_flash(fast_chip: Bench) -> None:
    """DMA2 stream 0 from the flash to SRAM."""
    unlock(fast_chip)
    stream = 0x40026410
    for offset, value in ((4, 1), (8, FLASH + 0x40000), (0xC, 0x20000000), (0x14, 0x27)):
        fast_chip.write(stream + offset, value)
    program(fast_chip, 0x40000, 5)
    fast_chip.write(stream, 2 << 6 | 2 << 11 | 2 << 13 | 1)
    fast_chip.run(10 * MICROSECOND)
    fast_chip.expect("bus master read of 0x08040000 while the flash is busy")


def refused(chip: Bench, flag: int, text: str, store: Callable[[], None]) -> None:
    """Check that a store is not done, sets its flag alone, and is told."""
    before = [chip.read(FLASH + offset) for offset in (0x40000, 0x4000C, 0x40010)]
    store()
    chip.expect(text)
    assert chip.read(SR) == flag
    assert [chip.read(FLASH + offset) for offset in (0x40000, 0x4000C, 0x40010)] == before
    chip.write(SR, 0xF3)
    assert chip.read(SR) == 0


def test_wrong_stores_are_not_done(open_chip: Bench) -> None:
    chip = open_chip
    refused(chip, PGSERR, "does not set PG", lambda: chip.write(FLASH + 0x40000, 0))
    chip.write(CR, X32 | PG | SER)
    refused(chip, PGSERR, "asks for an erase, too", lambda: chip.write(FLASH + 0x40000, 0))
    chip.write(CR, X32 | PG)
    for width in (1, 2):
        refused(chip, PGPERR, "not what PSIZE says", lambda width=width: chip.write(FLASH + 0x40000, 0, width))
    refused(chip, PGPERR, "which is not aligned", lambda: chip.write(FLASH + 0x40002, 0))
    refused(chip, PGAERR, "crosses the end of a row", lambda: chip.write(FLASH + 0x4000E, 0))
    chip.write(CR, X16 | PG)
    refused(chip, PGPERR, "not what PSIZE says", lambda: chip.write(FLASH + 0x40000, 0))
    chip.write(CR, X32 | PG | LOCK)
    refused(chip, PGSERR, "while FLASH_CR is locked", lambda: chip.write(FLASH + 0x40000, 0))


def test_nothing_is_stored_or_written_while_busy(open_chip: Bench) -> None:
    program(open_chip, 0x40000, 1)
    open_chip.write(FLASH + 0x40004, 2)
    open_chip.expect("4-byte store at 0x40004 while it is busy")
    open_chip.write(CR, LOCK)
    open_chip.expect("FLASH_CR: written 0x80000000 while the flash is busy")
    finish(open_chip)
    assert open_chip.read(FLASH + 0x40004) == 0xFFFFFFFF
    assert open_chip.read(CR) == X32 | PG


def test_x64_is_refused(open_chip: Bench) -> None:
    open_chip.write(CR, X64 | SER | 6 << 3)
    open_chip.write(CR, X64 | SER | 6 << 3 | STRT)
    open_chip.expect("PSIZE 3, x64, which needs an external Vpp")
    assert open_chip.read(SR) == 0


@pytest.mark.parametrize(("size", "least"), [(X8, 1.8), (X16, 2.1), (X32, 2.7)])
def test_the_supply_decides_the_parallelism(size: int, least: float) -> None:
    for volts, right in ((least - 0.01, False), (least, True), (3.6, True), (3.61, False)):
        chip = Bench()
        unlock(chip)
        supply(chip, volts)
        program(chip, 0x40000, 0, size)
        assert ("for which" in chip.report) != right
        assert bool(chip.read(SR) & BSY) == right
        chip.close()


def test_a_supply_that_sags_during_an_operation(open_chip: Bench) -> None:
    program(open_chip, 0x40000, 0)
    supply(open_chip, 2.71)
    assert not open_chip.report
    supply(open_chip, 2.69)
    open_chip.expect("2.69 V during an operation with PSIZE 2")


# ---- Erasing ----


@pytest.mark.parametrize("sector", range(12))
def test_an_erase_is_of_its_sector(open_chip: Bench, sector: int) -> None:
    edges = [SECTORS[sector], SECTORS[sector + 1] - 4]
    beside = [edge for edge in (SECTORS[sector] - 4, SECTORS[sector + 1]) if 0 <= edge < 0x100000]
    for offset in edges + beside:
        program(open_chip, offset, 0xA5A5A5A5)
        finish(open_chip)
    erase_and_wait(open_chip, sector)
    assert [open_chip.read(FLASH + offset) for offset in edges] == [0xFFFFFFFF] * 2
    assert [open_chip.read(FLASH + offset) for offset in beside] == [0xA5A5A5A5] * len(beside)


ERASE_MS = {
    (0, X8): (400, 800),
    (0, X16): (300, 600),
    (0, X32): (250, 500),
    (4, X8): (1200, 2400),
    (4, X16): (700, 1400),
    (4, X32): (550, 1100),
    (5, X8): (2000, 4000),
    (5, X16): (1300, 2600),
    (5, X32): (1000, 2000),
}
"""DS8626, table of the flash's programming: typical and largest, by sector and parallelism."""


def busy_ms(chip: Bench, limit_ms: int) -> int:
    begin = chip.now
    while chip.read(SR) & BSY:
        chip.run(MILLISECOND)
        assert chip.now - begin <= limit_ms * MILLISECOND
    return round((chip.now - begin) / MILLISECOND)


@pytest.mark.parametrize(("sector", "size"), ERASE_MS)
def test_an_erase_takes_its_typical_time(open_chip: Bench, sector: int, size: int) -> None:
    erase(open_chip, sector, size)
    assert open_chip.read(CR) & STRT
    assert ends_after(open_chip, ERASE_MS[sector, size][0] * MILLISECOND)
    assert not open_chip.read(CR) & STRT


def test_a_seed_spreads_times_up_to_the_largest() -> None:
    taken = []
    for seed in range(1, 41):
        chip = Bench(memory_seed=seed)
        unlock(chip)
        erase(chip, 1)
        taken.append(busy_ms(chip, 501))
        chip.close()
    assert min(taken) < 260
    assert max(taken) > 440
    assert len(set(taken)) > 20


@pytest.mark.parametrize(("size", "typical_s"), [(X8, 16), (X16, 11), (X32, 8)])
def test_a_mass_erase(open_chip: Bench, size: int, typical_s: int) -> None:
    for offset in SECTORS[:-1]:
        program(open_chip, offset, 0)
        finish(open_chip)
    open_chip.write(CR, size | MER)
    open_chip.write(CR, size | MER | STRT)
    assert ends_after(open_chip, 1000 * typical_s * MILLISECOND)
    assert [open_chip.read(FLASH + offset) for offset in SECTORS[:-1]] == [0xFFFFFFFF] * 12


@pytest.mark.parametrize(
    ("bits", "text"),
    [
        (0, "one of SER and MER starts an erase"),
        (PG, "one of SER and MER starts an erase"),
        (SER | MER, "one of SER and MER starts an erase"),
        (SER | PG, "one of SER and MER starts an erase"),
        (SER | 12 << 3, "sector 12 of 0 to 11"),
    ],
)
def test_what_does_not_start(open_chip: Bench, bits: int, text: str) -> None:
    open_chip.write(CR, X32 | bits)
    open_chip.write(CR, X32 | bits | STRT)
    open_chip.expect(text)
    assert open_chip.read(SR) == 0
    assert open_chip.read(CR) == X32 | bits


def test_start_comes_alone(open_chip: Bench) -> None:
    open_chip.write(CR, X32 | SER | 6 << 3 | STRT)
    open_chip.expect("STRT is set together with a change of what it starts")
    assert open_chip.read(SR) == 0


# ---- Write protection and interrupts ----


@pytest.fixture
def guarded() -> Iterator[Bench]:
    """Return an open chip whose sectors 6 and 11 are protected (nWRP bits 22 and 27)."""
    bench = Bench(option_bytes=0x0FFFAAED & ~(1 << 22 | 1 << 27))
    unlock(bench)
    yield bench
    report = bench.report
    bench.close()
    assert not report


def test_protected_sectors(guarded: Bench) -> None:
    chip = guarded
    for sector in range(12):
        protected = sector in (6, 11)
        program(chip, SECTORS[sector], 0)
        if protected:
            chip.expect("programming of a sector that the option bytes protect (nWRP 0x7BF)")
        assert chip.read(SR) == (WRPERR if protected else BSY)
        chip.run(MILLISECOND)
        chip.write(SR, 0xF3)
        assert chip.read(FLASH + SECTORS[sector]) == (0xFFFFFFFF if protected else 0)
    for sector in (5, 6):
        erase(chip, sector)
        if sector == 6:
            chip.expect("an erase of a sector that the option bytes protect")
        assert chip.read(SR) == (WRPERR if sector == 6 else BSY)
        chip.run(1001 * MILLISECOND)
    chip.write(SR, WRPERR)
    chip.write(CR, X32 | MER)
    chip.write(CR, X32 | MER | STRT)
    chip.expect("an erase of a sector that the option bytes protect")
    assert chip.read(SR) == WRPERR
    assert chip.read(FLASH + SECTORS[4]) == 0


def test_the_end_interrupts_only_if_enabled(open_chip: Bench) -> None:
    for enabled in (0, EOPIE):
        open_chip.write(CR, X32 | PG | enabled)
        open_chip.write(FLASH + 0x40000, 0)
        assert not open_chip.irq(INTERRUPT)
        open_chip.run(17 * MICROSECOND)
        assert open_chip.read(SR) == (EOP if enabled else 0)
        assert open_chip.irq(INTERRUPT) == bool(enabled)
    open_chip.write(SR, EOP)
    assert not open_chip.irq(INTERRUPT)


def test_an_error_interrupts_only_if_enabled(open_chip: Bench) -> None:
    for enabled in (0, ERRIE):
        open_chip.write(CR, X32 | enabled)
        open_chip.write(FLASH + 0x40000, 0)
        open_chip.expect("does not set PG")
        assert open_chip.read(SR) == PGSERR | (OPERR if enabled else 0)
        assert open_chip.irq(INTERRUPT) == bool(enabled)
    open_chip.write(SR, OPERR)
    assert not open_chip.irq(INTERRUPT)
    assert open_chip.read(SR) == PGSERR


# ---- Caches ----


@pytest.mark.parametrize("way", ["never on", "on", "off", "reset", "rewritten"])
def test_the_data_cache_may_hold_what_was_erased(open_chip: Bench, way: str) -> None:
    """It is off after a reset; switching it off leaves what it holds, resetting it does not."""
    chip = open_chip
    if way != "never on":
        chip.write(ACR, 0x400)
    erase_and_wait(chip, 6)
    if way in ("off", "reset"):
        chip.write(ACR, 0)
    if way == "reset":
        chip.write(ACR, 0x1000)
        chip.write(ACR, 0)
    if way == "rewritten":
        program(chip, 0x40000, 0)
        finish(chip)
    chip.read(FLASH + 0x60000)
    assert not chip.report
    chip.read(FLASH + 0x40000)
    if way in ("on", "off"):
        chip.expect("erased while the data cache was on")
    if way == "rewritten":
        chip.read(FLASH + 0x40004)
        chip.expect("4-byte load at 0x40004, which was erased while the data cache was on")


@pytest.mark.parametrize(("enable", "reset"), [(0x200, 0x800), (0x400, 0x1000)])
def test_a_cache_is_reset_while_it_is_off_whatever_the_other_is(chip: Bench, enable: int, reset: int) -> None:
    """RM0090 3.9.1: ICRST is written only when the instruction cache is disabled, DCRST when the data cache is."""
    other = 0x600 ^ enable
    chip.write(ACR, other)
    chip.write(ACR, other | reset)
    assert not chip.report
    chip.write(ACR, enable)
    chip.write(ACR, enable | reset)
    chip.expect("may be reset only while it is disabled")
