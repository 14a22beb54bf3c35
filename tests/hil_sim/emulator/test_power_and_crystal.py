"""A supply that sags, a crystal that stops or drifts, option bytes, resets and what they leave (RM0090 3, 5, 7, 38)."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from hil_sim.emulator import Configuration, Emulator
from hil_sim.emulator.bench import MILLISECOND, Bench
from tests.hil_sim.emulator import oracle

RCC, PWR, FLASH, EXTI, IWDG = 0x40023800, 0x40007000, 0x40023C00, 0x40013C00, 0x40003000
CSSON, CSSF, CSSC, CSR = 1 << 19, 1 << 7, 1 << 23, 0x74
BORRSTF, PINRSTF, PORRSTF, SFTRSTF, IWDGRSTF = 1 << 25, 1 << 26, 1 << 27, 1 << 28, 1 << 29
FLAGS = 0xFE000000


def core_clock(chip: Bench) -> float:
    return float(chip.lib.machine_bench_core_clock(chip.machine))


def crystal(chip: Bench, alive: bool) -> None:
    chip.lib.machine_bench_crystal(chip.machine, alive)


def supply(chip: Bench, volts: float) -> None:
    chip.lib.machine_bench_supply(chip.machine, volts)


def nmi(chip: Bench) -> bool:
    return bool(chip.lib.machine_bench_nmi(chip.machine))


def requested(chip: Bench) -> int | None:
    """Return the flags of a reset that is asked for, and reset; None: nobody asks."""
    flags = chip.ffi.new("uint32_t *")
    if not chip.lib.machine_bench_reset_requested(chip.machine, flags):
        return None
    chip.lib.machine_bench_reset(chip.machine)
    return int(flags[0])


@pytest.fixture
def bor3() -> Iterator[Bench]:
    """Return a chip whose option bytes ask for brown-out level 3."""
    bench = Bench(option_bytes=0x0FFFAAE1)
    yield bench
    report = bench.report
    bench.close()
    assert not report


# ---- The crystal ----


def test_unwatched_crystal_leaves_a_slow_core(fast_chip: Bench) -> None:
    """The PLL runs free at about a twentieth, its ready flags stand, and nobody is told."""
    crystal(fast_chip, False)
    assert core_clock(fast_chip) == pytest.approx(8.4e6)
    assert fast_chip.read(RCC) & (1 << 25 | 1 << 17) == 1 << 25 | 1 << 17
    assert fast_chip.read(RCC + 8) & 0xC == 8
    assert not nmi(fast_chip)
    crystal(fast_chip, True)
    assert core_clock(fast_chip) == pytest.approx(168e6)


def test_watched_crystal_falls_back_and_tells(fast_chip: Bench) -> None:
    fast_chip.change(RCC, CSSON)
    assert core_clock(fast_chip) == pytest.approx(168e6)
    crystal(fast_chip, False)
    assert core_clock(fast_chip) == pytest.approx(16e6)
    cr = fast_chip.read(RCC)
    assert cr & (1 << 16 | 1 << 17 | 1 << 24 | 1 << 25) == 0  # HSE and its PLL are off,
    assert cr & 3 == 3  # HSI is on,
    assert fast_chip.read(RCC + 8) & 0xF == 0  # and is the system clock.
    assert nmi(fast_chip)
    assert fast_chip.read(RCC + 0xC) & CSSF
    fast_chip.write(RCC + 0xC, CSSC)
    assert not nmi(fast_chip)
    assert not fast_chip.read(RCC + 0xC) & CSSF


def test_security_system_watches_only_what_is_ready(chip: Bench) -> None:
    crystal(chip, False)
    chip.write(RCC, 0x10083 | CSSON)
    chip.run(1e12)
    assert not nmi(chip)
    assert not chip.read(RCC) & 1 << 17
    crystal(chip, True)
    chip.run(2.1 * MILLISECOND)
    assert chip.read(RCC) & 1 << 17
    crystal(chip, False)  # Ready, though nobody uses it.
    assert nmi(chip)
    assert core_clock(chip) == pytest.approx(16e6)


def test_security_system_switched_on_late_sees_it_at_once(fast_chip: Bench) -> None:
    crystal(fast_chip, False)
    fast_chip.change(RCC, CSSON)
    assert nmi(fast_chip)
    assert core_clock(fast_chip) == pytest.approx(16e6)


@pytest.mark.parametrize(
    ("config", "ppm_per_s"),
    [
        ({"crystal_ppm_per_s": 5.0}, 5.0),
        ({"crystal_ppm_per_K": 2.0, "temperature_K_per_s": 0.1}, 0.2),
        ({"crystal_ppm_per_K": 2.0}, 0.0),
    ],
)
def test_crystal_drifts(config: dict[str, float], ppm_per_s: float) -> None:
    chip = Bench(crystal_ppm=10.0, **config)
    chip.full_speed()
    for second in (1, 4, 10):
        chip.run_to(second * 1e12 + 1)
        ppm = (core_clock(chip) / 168e6 - 1) * 1e6
        assert ppm == pytest.approx(10.0 + ppm_per_s * (second + 0.005), abs=1e-6)
    chip.close()


def test_drifting_timer_keeps_its_phase() -> None:
    """TIM2 at 84 MHz counts the drift's integral: 50 ppm/s make 2,500 ppm s of 84 MHz in 10 s, 210,000 ticks."""
    counts = []
    for rate in (0.0, 50.0):
        chip = Bench(crystal_ppm_per_s=rate)
        chip.full_speed()
        chip.write(0x40000000, 1)
        start = chip.now * 1e-12
        chip.run_to(10e12)
        counts.append((chip.read(0x40000024), start))
        chip.close()
    start = counts[0][1]
    expected = 50e-6 * (10.0**2 - start**2) / 2 * 84e6
    assert counts[1][0] - counts[0][0] == pytest.approx(expected, abs=3)


# ---- The supply ----


def held(chip: Bench) -> bool:
    return bool(chip.lib.machine_bench_held(chip.machine))


def test_brown_out_level_3_holds_the_chip_in_reset(bor3: Bench) -> None:
    requested(bor3)
    supply(bor3, 2.84)
    assert not held(bor3)
    assert requested(bor3) is None
    supply(bor3, 2.82)
    assert held(bor3)
    assert requested(bor3) == 0
    supply(bor3, 2.91)
    assert held(bor3)
    supply(bor3, 2.93)
    assert not held(bor3)
    assert requested(bor3) == BORRSTF


def test_without_brown_out_reset_the_flash_is_read_too_fast(fast_chip: Bench) -> None:
    """Silicon would go on with wrong instructions below 2.7 V; the model says so."""
    supply(fast_chip, 2.71)
    assert not fast_chip.report
    supply(fast_chip, 2.69)
    fast_chip.expect("LATENCY 5 is too few wait states for HCLK 168000000 Hz at 2.69 V, which needs 6")
    assert not held(fast_chip)


def test_power_down_reset_is_always_there(chip: Bench) -> None:
    supply(chip, 1.69)
    assert not held(chip)
    supply(chip, 1.67)
    assert held(chip)
    requested(chip)
    supply(chip, 3.3)
    assert requested(chip) == BORRSTF | PORRSTF
    assert chip.read(RCC + CSR) & FLAGS == BORRSTF | PORRSTF | PINRSTF


# The data sheet DS8626, revision 9, table 19: least, typical and largest, falling and rising, by PLS.
DETECTOR = [
    ((1.98, 2.04, 2.08), (2.09, 2.14, 2.19)),
    ((2.13, 2.19, 2.25), (2.23, 2.30, 2.37)),
    ((2.29, 2.35, 2.39), (2.39, 2.45, 2.51)),
    ((2.44, 2.51, 2.56), (2.54, 2.60, 2.65)),
    ((2.59, 2.66, 2.71), (2.70, 2.76, 2.82)),
    ((2.75, 2.84, 2.92), (2.86, 2.93, 2.99)),
    ((2.85, 2.93, 2.99), (2.96, 3.03, 3.10)),
    ((2.95, 3.03, 3.09), (3.07, 3.14, 3.21)),
]
BROWN_OUT = {  # The same, by BOR_LEV; 3 is off, the power-down reset.
    0: ((2.75, 2.83, 2.88), (2.85, 2.92, 2.97)),
    1: ((2.44, 2.50, 2.56), (2.53, 2.59, 2.63)),
    2: ((2.13, 2.19, 2.24), (2.23, 2.29, 2.33)),
    3: ((1.60, 1.68, 1.76), (1.64, 1.72, 1.80)),
}


@pytest.mark.parametrize("level", BROWN_OUT)
def test_brown_out_resets_at_the_thresholds_of_the_data_sheet(level: int) -> None:
    (_, falling, _), (_, rising, _) = BROWN_OUT[level]
    chip = Bench(option_bytes=0x0FFFAAE1 | level << 2)
    supply(chip, falling + 0.005)
    assert not held(chip)
    supply(chip, falling - 0.005)
    assert held(chip)
    supply(chip, rising - 0.005)
    assert held(chip)
    supply(chip, rising + 0.005)
    assert not held(chip)
    chip.close()


def test_the_detector_warns_before_the_board_has_too_little() -> None:
    """Level 5, which the boards choose: no chip lets 2.7 V pass, below which five wait states do not suffice."""
    (least, _, _), _ = DETECTOR[5]
    assert least > 2.7


@pytest.mark.parametrize("level", range(8))
def test_voltage_detector(fast_chip: Bench, level: int) -> None:
    (_, falling, _), (_, rising, _) = DETECTOR[level]
    fast_chip.write(EXTI, 1 << 16)
    fast_chip.write(EXTI + 8, 1 << 16)
    fast_chip.write(PWR, 0x4000 | level << 5 | 0x10)
    supply(fast_chip, falling + 0.01)
    assert not fast_chip.read(PWR + 4) & 4
    assert not fast_chip.irq(1)
    supply(fast_chip, falling - 0.01)
    assert fast_chip.read(PWR + 4) & 4
    assert fast_chip.irq(1)
    fast_chip.write(EXTI + 0x14, 1 << 16)
    assert not fast_chip.irq(1)
    supply(fast_chip, rising - 0.01)
    assert fast_chip.read(PWR + 4) & 4
    supply(fast_chip, rising + 0.01)
    assert not fast_chip.read(PWR + 4) & 4
    assert not fast_chip.irq(1)  # Only the rising edge of PVDO was asked for.
    if "too few wait states" in fast_chip.report:  # Below 2.7 V.
        fast_chip.expect("too few wait states")


# ---- Option bytes ----


def test_option_bytes(chip: Bench) -> None:
    assert chip.read(FLASH + 0x14) == 0x0FFFAAED
    chip.write(FLASH + 0x14, 0x0FFFAAE0)
    chip.expect("FLASH_OPTCR: written 0x0FFFAAE0 while locked")
    chip.write(FLASH + 8, 0x08192A3B)
    chip.write(FLASH + 8, 0x4C5D6E7F)
    chip.write(FLASH + 0x14, 0x0FFFAAE0)
    chip.write(FLASH + 0x14, 0x0FFFAAE2)
    assert chip.read(FLASH + 0xC) >> 16 & 1
    chip.run(21 * MILLISECOND)
    assert not chip.read(FLASH + 0xC) >> 16 & 1
    assert chip.read(FLASH + 0x14) == 0x0FFFAAE0
    chip.lib.machine_bench_reset(chip.machine)
    assert chip.read(FLASH + 0x14) == 0x0FFFAAE1
    supply(chip, 2.82)
    assert held(chip)


def test_option_bytes_without_start_are_gone_after_reset(chip: Bench) -> None:
    chip.write(FLASH + 8, 0x08192A3B)
    chip.write(FLASH + 8, 0x4C5D6E7F)
    chip.write(FLASH + 0x14, 0x0FFFAAE0)
    chip.lib.machine_bench_reset(chip.machine)
    assert chip.read(FLASH + 0x14) == 0x0FFFAAED


def test_wrong_option_key_and_level_2(chip: Bench) -> None:
    chip.write(FLASH + 8, 0x08192A3B)
    chip.write(FLASH + 8, 0x4C5D6E7F)
    chip.write(FLASH + 0x14, 0x0FFFCCE0)
    chip.expect("level 2")
    assert chip.refused(FLASH + 8, 0x08192A3B)
    chip.expect("is not the next key")
    assert chip.read(FLASH + 0x14) & 1


def test_hardware_watchdog_starts_by_itself() -> None:
    """WDG_SW 0: 512 ms at 32 kHz divided by 4 and 4096 counts."""
    chip = Bench(option_bytes=0x0FFFAACD)
    requested(chip)
    chip.lib.machine_bench_reset(chip.machine)
    chip.run(511 * MILLISECOND)
    assert requested(chip) is None
    chip.run(2 * MILLISECOND)
    assert requested(chip) == IWDGRSTF
    chip.close()


def test_prefetch_on_revision_a() -> None:
    for revision, wrong in ((0x1000, True), (0x1001, False)):
        chip = Bench(revision=revision)
        chip.write(FLASH, 0x105)
        assert ("prefetch on silicon revision A" in chip.report) == wrong
        chip.close()


# ---- Resets, and what they leave ----


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("resets"), oracle.PROGRAMS / "resets.c")


def outcome(board: Emulator) -> list[int]:
    """Return RCC_CSR's flags, what a word of SRAM and one of CCM held at the start, DBGMCU_IDCODE and NMIs so far."""
    return oracle.words(board.memory(0x2001F800, 20))


def test_reset_causes_and_retained_memory(image: Path) -> None:
    with Emulator(image, Configuration(option_bytes=0x0FFFAAE1, stop_at_fault=False)) as board:
        assert board.run(5 * MILLISECOND)
        flags, sram, ccm, identity, _ = outcome(board)
        assert flags == BORRSTF | PINRSTF | PORRSTF
        assert sram != 0
        assert ccm != 0
        assert sram != ccm
        assert identity == 0x10076413
        assert board.run(30 * MILLISECOND)  # The program resets itself after 10 ms, once,
        flags, sram, ccm, *_ = outcome(board)
        assert (flags, sram, ccm) == (PINRSTF | SFTRSTF, 0xC0FFEE01, 0xC0FFEE02)
        assert board.run(700 * MILLISECOND)  # lets the watchdog do it 512 ms later,
        flags, sram, ccm, *_ = outcome(board)
        assert (flags, sram, ccm) == (PINRSTF | IWDGRSTF, 0xC0FFEE01, 0xC0FFEE02)
        board.supply(2.5)  # and then the supply sags: level 3.
        before = board.statistics().instructions
        assert board.run(750 * MILLISECOND)
        assert board.statistics().instructions - before < 10
        board.supply(3.3)
        assert board.run(755 * MILLISECOND)
        flags, sram, ccm, *_ = outcome(board)
        assert (flags, sram, ccm) == (PINRSTF | BORRSTF, 0xC0FFEE01, 0xC0FFEE02)
        board.supply(0.0)
        assert board.run(760 * MILLISECOND)
        board.supply(3.3)
        assert board.run(765 * MILLISECOND)
        flags, sram, ccm, *_ = outcome(board)
        assert flags == BORRSTF | PINRSTF | PORRSTF
        assert sram != 0xC0FFEE01
        assert ccm != 0xC0FFEE02


def test_power_on_memory_follows_its_seed(image: Path) -> None:
    contents = []
    for seed in (1, 1, 2):
        with Emulator(image, Configuration(memory_seed=seed)) as board:
            contents.append(board.memory(0x20004000, 1024))
    assert contents[0] == contents[1] != contents[2]
    assert 3000 < sum(byte.bit_count() for byte in contents[0]) < 5200


def test_nmi_comes_again_until_it_is_cleared(image: Path) -> None:
    """The handler clears CSSF the third time."""
    with Emulator(image, Configuration()) as board:
        assert board.run(8 * MILLISECOND)
        assert outcome(board)[4] == 0
        board.crystal(False)
        assert board.run(9 * MILLISECOND)
        assert outcome(board)[4] == 3
