"""The flash interface of the bare chip: its registers (RM0090 3.9, F405/407), and what is done with them."""

from hil_sim.emulator.bench import MICROSECOND, MILLISECOND, Bench

ACR, KEYR, OPTKEYR, SR, CR, OPTCR = (0x40023C00 + 4 * n for n in range(6))
FLASH = 0x08000000
PG, SER, MER, STRT, EOPIE, ERRIE, LOCK = 1, 2, 4, 1 << 16, 1 << 24, 1 << 25, 1 << 31
EOP, OPERR, WRPERR, PGAERR, PGPERR, PGSERR, BSY = 1, 2, 1 << 4, 1 << 5, 1 << 6, 1 << 7, 1 << 16
X8, X16, X32, X64 = (size << 8 for size in range(4))
INTERRUPT = 4
SECTORS = [*(n * 0x4000 for n in range(4)), 0x10000, *range(0x20000, 0x100000, 0x20000), 0x100000]
"""Table 5 of RM0090: four of 16 KB, one of 64 KB, seven of 128 KB."""
FIRST, SECOND = (0x45670123, 0xCDEF89AB), (0x08192A3B, 0x4C5D6E7F)


def unlock(chip: Bench) -> None:
    for key in FIRST:
        chip.write(KEYR, key)


def supply(chip: Bench, volts: float) -> None:
    chip.lib.machine_bench_supply(chip.machine, volts)


def reset(chip: Bench) -> None:
    chip.lib.machine_bench_reset(chip.machine)


def cut(chip: Bench, step: int, fraction: float, cut_id: int = 0) -> None:
    chip.lib.machine_bench_cut_flash(chip.machine, step, fraction, cut_id, 0)


def finish(chip: Bench) -> None:
    """Let a program end."""
    chip.run(101 * MICROSECOND)
    assert not chip.read(SR) & BSY


def program(chip: Bench, offset: int, value: int, size: int = X32) -> None:
    chip.write(CR, size | PG)
    chip.write(FLASH + offset, value, 1 << (size >> 8))


def erase(chip: Bench, sector: int, size: int = X32) -> None:
    chip.write(CR, size | SER | sector << 3)
    chip.write(CR, size | SER | sector << 3 | STRT)


def erase_and_wait(chip: Bench, sector: int) -> None:
    erase(chip, sector)
    chip.run(1001 * MILLISECOND)
    assert not chip.read(SR) & BSY


def ends_after(chip: Bench, duration_ps: int) -> bool:
    """Let the operation that has just begun end; return whether it took just that long."""
    chip.run(duration_ps)  # Up to, and without, that moment.
    before = chip.read(SR) & BSY
    chip.run(1)
    return bool(before) and not chip.read(SR) & BSY
