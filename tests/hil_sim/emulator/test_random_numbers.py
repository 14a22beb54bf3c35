"""The random number generator against RM0090, chapter 24: on the bare chip, and under a program without a driver."""

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from hil_sim.emulator import Configuration, Emulator
from hil_sim.emulator.bench import MICROSECOND, MILLISECOND, Bench
from tests.hil_sim.emulator import oracle

RCC, RNG = 0x40023800, 0x50060800
CR, SR, DR = RNG, RNG + 4, RNG + 8
PLLCFGR, CFGR, AHB2RSTR, AHB2ENR = RCC + 0x04, RCC + 0x08, RCC + 0x14, RCC + 0x34
RNGEN, IE = 1 << 2, 1 << 3
DRDY, CECS, SECS, CEIS, SEIS = 1 << 0, 1 << 1, 1 << 2, 1 << 5, 1 << 6
PLLON, PLLRDY, GATE = 1 << 24, 1 << 25, 1 << 6
POSITION = 80
PERIOD_PS = 1e12 / 48e6


def noise(chip: Bench, alive: bool) -> None:
    chip.lib.machine_bench_noise(chip.machine, alive)


def start_pll(chip: Bench, n: int, q: int, *, crystal: bool = False) -> None:
    """Let the PLL make n / q MHz beside a core that stays on its 16 MHz oscillator; the generator's clock is on."""
    if crystal:
        chip.change(RCC, 1 << 16)
        chip.run(2.5 * MILLISECOND)
    chip.write(PLLCFGR, 0x20000000 | (12 if crystal else 16) | n << 6 | crystal << 22 | q << 24)
    chip.change(RCC, PLLON)
    chip.run(0.2 * MILLISECOND)
    chip.write(AHB2ENR, GATE)
    chip.run(MICROSECOND)


def number(chip: Bench, wait_ps: float = MICROSECOND) -> int:
    """Return the next number, taken as the manual has it."""
    chip.run(wait_ps)
    assert chip.read(SR) == DRDY
    return chip.read(DR)


def numbers(chip: Bench, count: int = 8) -> list[int]:
    chip.write(CR, RNGEN)
    return [number(chip) for _ in range(count)]


@pytest.fixture
def running(fast_chip: Bench) -> Iterator[Bench]:
    """Return a chip whose generator has just been enabled."""
    fast_chip.write(CR, RNGEN | IE)
    return fast_chip


# ---- Numbers and their times ----


@pytest.mark.parametrize(("n", "q"), [(336, 7), (192, 4), (336, 8), (150, 15)])
def test_a_number_takes_forty_periods(chip: Bench, n: int, q: int) -> None:
    """They are those of PLL48CLK, whatever HCLK is, from RNGEN on, and from the reading of the number before."""
    start_pll(chip, n, q)
    period = 1e12 / (n / q * 1e6)
    chip.write(CR, RNGEN)
    for _ in range(3):
        start = chip.now
        chip.run_to(start + 40 * period - 1)
        assert chip.read(SR) == 0
        chip.run_to(start + 40 * period + 2)
        assert chip.read(SR) == DRDY
        chip.run(10 * MICROSECOND)  # It waits to be read.
        assert chip.read(SR) == DRDY
        chip.read(DR)
        assert chip.read(SR) == 0


@pytest.mark.parametrize("ppm", [100.0, -4000.0])
def test_the_crystal_is_the_clock(ppm: float) -> None:
    chip = Bench(crystal_ppm=ppm)
    chip.full_speed()
    chip.write(CR, RNGEN)
    ready = chip.now + 40 * PERIOD_PS / (1 + ppm * 1e-6)
    chip.run_to(ready - 1)
    assert chip.read(SR) == 0
    chip.run_to(ready + 2)
    assert chip.read(SR) == DRDY
    assert not chip.report
    chip.close()


def test_numbers_look_random(fast_chip: Bench) -> None:
    """Ones in 1,024 numbers within five deviations, and each of the 32 bits takes both values about as often."""
    drawn = numbers(fast_chip, 1024)
    assert len(set(drawn)) == 1024
    assert abs(sum(word.bit_count() for word in drawn) - 16384) < 5 * (32 * 1024 / 4) ** 0.5
    for bit in range(32):
        assert abs(sum(word >> bit & 1 for word in drawn) - 512) < 5 * 16
    flips = sum((a ^ b).bit_count() for a, b in pairwise(drawn))
    assert abs(flips - 16 * 1023) < 5 * (32 * 1023 / 4) ** 0.5


def test_numbers_follow_seed_board_and_reset() -> None:
    """The same each time, and of another seed, another board or another reset others."""
    seen: list[list[int]] = []
    for seed, unique in ((1, 0), (1, 0), (2, 0), (0, 0), (1, 1)):
        chip = Bench(memory_seed=seed, unique_id=[unique] + [7] * 11)
        chip.full_speed()
        seen.append(numbers(chip))
        chip.lib.machine_bench_reset(chip.machine)
        chip.full_speed()
        seen.append(numbers(chip))
        assert not chip.report
        chip.close()
    assert seen[:2] == seen[2:4]
    different = seen[2:]
    assert len({word for words in different for word in words}) == 8 * len(different)


def test_interrupt_of_a_number(running: Bench) -> None:
    assert not running.irq(POSITION)
    running.run(MICROSECOND)
    assert running.irq(POSITION)
    running.write(CR, RNGEN)
    assert not running.irq(POSITION)
    running.write(CR, RNGEN | IE)
    assert running.irq(POSITION)
    assert running.read(SR) == DRDY
    running.read(DR)
    assert not running.irq(POSITION)


def test_a_number_that_waits_outlives_rngen(running: Bench) -> None:
    """The manual has one thing that takes DRDY back: reading RNG_DR. No other number comes then."""
    running.run(MICROSECOND)
    running.write(CR, 0)
    assert number(running) != 0
    running.run(MILLISECOND)
    assert running.read(SR) == 0
    running.write(CR, RNGEN)
    running.run(40 * PERIOD_PS - 2)
    assert running.read(SR) == 0
    number(running, 4)


def test_clearing_rngen_gives_a_number_up(running: Bench) -> None:
    running.run(39 * PERIOD_PS)
    running.write(CR, 0)
    running.run(MILLISECOND)
    assert running.read(SR) == 0


# ---- What is refused ----


def test_reading_before_a_number_is_ready(running: Bench) -> None:
    assert running.read(DR) == 0
    running.expect("RNG_DR: read while DRDY is 0")
    number(running)
    assert running.read(DR) == 0
    running.expect("RNG_DR: read while DRDY is 0")


def test_reading_without_a_look_at_the_status(running: Bench) -> None:
    """For each number anew: 24.4.3, "must check"."""
    number(running)
    running.run(MICROSECOND)
    running.read(DR)
    running.expect("before RNG_SR has shown DRDY of this number")
    running.read(SR)  # Too early: there is none.
    running.run(MICROSECOND)
    running.read(DR)
    running.expect("before RNG_SR has shown DRDY of this number")
    number(running)


def test_registers_without_their_clock(running: Bench) -> None:
    """The generator stands still as well, and begins the number anew."""
    running.run(20 * PERIOD_PS)
    running.write(AHB2ENR, 0)
    for address in (CR, SR, DR):
        running.read(address)
        running.expect("its clock is off in RCC")
    running.run(MILLISECOND)
    assert not running.irq(POSITION)
    running.write(AHB2ENR, GATE)
    running.run(40 * PERIOD_PS - 2)
    assert running.read(SR) == 0
    number(running, 4)


def test_a_reset_by_rcc(running: Bench) -> None:
    running.run(MICROSECOND)
    running.write(AHB2RSTR, GATE)
    assert not running.irq(POSITION)
    running.read(SR)
    running.expect("RCC holds the peripheral in reset")
    running.write(AHB2RSTR, 0)
    running.run(MILLISECOND)
    assert running.read(CR) == 0
    assert running.read(SR) == 0


@pytest.mark.parametrize(("n", "q", "refused"), [(192, 4, False), (193, 4, True), (336, 7, False), (336, 6, True)])
def test_a_clock_above_48_mhz(chip: Bench, n: int, q: int, refused: bool) -> None:
    start_pll(chip, n, q)
    chip.write(CR, RNGEN)
    if refused:
        chip.expect(f"PLL48CLK {n / q * 1e6:.0f} Hz, above 48 MHz")
    chip.run(MICROSECOND)
    assert chip.read(SR) == (0 if refused else DRDY)


def test_a_clock_that_becomes_too_fast(chip: Bench) -> None:
    start_pll(chip, 192, 4)
    chip.write(CR, RNGEN)
    number(chip)
    chip.change(RCC, 0, PLLON)
    chip.write(PLLCFGR, 0x20000000 | 16 | 196 << 6 | 4 << 24)
    chip.change(RCC, PLLON)
    chip.expect("RCC_PLLCFGR: PLLQ makes 49000000 Hz")
    chip.run(0.2 * MILLISECOND)
    chip.expect("RNG_CR: RNGEN is set while PLLQ makes PLL48CLK 49000000 Hz, above 48 MHz")
    chip.change(RCC, 1 << 16)  # Another change of clocks does not tell it again.
    chip.run(3 * MILLISECOND)


# ---- The clock's error ----


def test_no_clock_is_an_error(chip: Bench) -> None:
    """It stands with CEIS until written 0, and ends as soon as the PLL runs."""
    chip.write(AHB2ENR, GATE)
    chip.run(MICROSECOND)
    chip.run(MILLISECOND)
    assert chip.read(SR) == 0  # RNGEN switches the detector on.
    chip.write(CR, RNGEN | IE)
    assert chip.read(SR) == CECS | CEIS
    assert chip.irq(POSITION)
    chip.write(SR, 0x7F)  # Ones do nothing.
    assert chip.read(SR) == CECS | CEIS
    chip.write(SR, 0x7F ^ CEIS)
    assert chip.read(SR) == CECS
    assert not chip.irq(POSITION)
    chip.write(PLLCFGR, 0x20000000 | 16 | 336 << 6 | 7 << 24)
    chip.change(RCC, PLLON)
    assert not chip.read(RCC) & PLLRDY
    assert chip.read(SR) == CECS
    while not chip.read(RCC) & PLLRDY:
        chip.run(10 * MICROSECOND)
    assert chip.read(SR) & ~DRDY == 0
    number(chip)


def test_a_clock_that_stops_leaves_the_number(chip: Bench) -> None:
    """24.3.2: it has no impact on the number before, which can be used."""
    start_pll(chip, 336, 7)
    chip.write(CR, RNGEN)
    chip.run(MICROSECOND)
    chip.change(RCC, 0, PLLON)
    assert chip.read(SR) == DRDY | CECS | CEIS
    chip.read(DR)
    chip.run(MILLISECOND)
    assert chip.read(SR) == CECS | CEIS
    chip.change(RCC, PLLON)
    chip.run(MILLISECOND)
    assert chip.read(SR) == DRDY | CEIS
    chip.write(CR, 0)
    chip.write(SR, ~CEIS & 0x7F)
    assert number(chip, 0) != 0


def test_clearing_rngen_ends_the_error_not_its_flag(chip: Bench) -> None:
    chip.write(AHB2ENR, GATE)
    chip.run(MICROSECOND)
    chip.write(CR, RNGEN)
    chip.write(CR, 0)
    assert chip.read(SR) == CEIS
    chip.write(SR, 0)
    assert chip.read(SR) == 0
    chip.write(CR, RNGEN)
    assert chip.read(SR) == CECS | CEIS


@pytest.mark.parametrize(("n", "slow"), [(303, False), (297, True)])
def test_a_clock_below_a_sixteenth_of_hclk(chip: Bench, n: int, slow: bool) -> None:
    """A PLL that lost its crystal runs free at a twentieth: n / 15 / 20 MHz, beside an HCLK of 16 MHz."""
    start_pll(chip, n, 15, crystal=True)
    chip.write(CR, RNGEN)
    number(chip, 3 * MICROSECOND)
    chip.lib.machine_bench_crystal(chip.machine, False)
    assert chip.read(SR) == (CECS | CEIS if slow else 0)
    chip.run(20 * MICROSECOND)
    assert chip.read(SR) == (CECS | CEIS if slow else 0)
    chip.run(25 * MICROSECOND)  # 40 periods of 1.01 MHz are 39.6 us.
    assert chip.read(SR) == (CECS | CEIS if slow else DRDY)
    chip.write(CFGR, 8 << 4)  # HCLK halves.
    chip.run(45 * MICROSECOND)
    assert chip.read(SR) == (DRDY | CEIS if slow else DRDY)


def test_periods_of_two_frequencies_add_up(chip: Bench) -> None:
    """20 periods of 24 MHz, then 20 of 1.2 MHz, to the picosecond of the first, which is 20 of the second."""
    start_pll(chip, 360, 15, crystal=True)
    chip.write(CR, RNGEN)
    chip.run(20 / 24e6 * 1e12)
    chip.lib.machine_bench_crystal(chip.machine, False)
    chip.run(20 / 1.2e6 * 1e12 - 40)
    assert chip.read(SR) == 0
    number(chip, 80)


def test_the_clock_security_system_takes_the_clock(fast_chip: Bench) -> None:
    fast_chip.change(RCC, 1 << 19)
    fast_chip.write(CR, RNGEN)
    number(fast_chip)
    fast_chip.lib.machine_bench_crystal(fast_chip.machine, False)
    assert fast_chip.read(SR) == CECS | CEIS


# ---- The seed's error ----


def test_a_source_that_sticks_is_seen_after_64_equal_bits(running: Bench) -> None:
    """Until then a number repeats the one before: the manual has the program compare them."""
    first = number(running)
    noise(running, False)
    start = running.now
    running.run_to(start + 41 * PERIOD_PS)
    assert number(running, 0) == first
    running.run_to(start + 65 * PERIOD_PS - 1)
    assert running.read(SR) == 0
    assert not running.irq(POSITION)
    running.run_to(start + 65 * PERIOD_PS + 2)
    assert running.read(SR) == SECS | SEIS
    assert running.irq(POSITION)
    running.run(MILLISECOND)
    assert running.read(SR) == SECS | SEIS  # No number while SECS is 1.


def test_recovery_from_a_seed_error(running: Bench) -> None:
    first = number(running)
    noise(running, False)
    running.run(2 * MICROSECOND)
    assert running.read(SR) == DRDY | SECS | SEIS
    noise(running, True)
    assert running.read(SR) == DRDY | SEIS
    running.write(SR, 0x7F)
    assert running.read(SR) == DRDY | SEIS
    running.write(SR, 0x7F ^ SEIS)
    assert running.read(SR) == DRDY
    running.write(CR, IE)
    running.write(CR, RNGEN | IE)
    assert number(running) == first  # It waited; the first after RNGEN is not to be used.
    assert number(running) != first


@pytest.mark.parametrize("clear", [True, False])
def test_a_number_behind_a_seed_error_must_not_be_used(running: Bench, clear: bool) -> None:
    """Nor may it be once SEIS is cleared, without RNGEN cleared and set."""
    number(running)
    noise(running, False)
    running.run(2 * MICROSECOND)
    assert running.read(SR) == DRDY | SECS | SEIS
    noise(running, True)
    if clear:
        running.write(SR, 0)
        assert running.read(SR) == DRDY
    running.read(DR)
    running.expect("RNG_SR has shown a seed error, and RNGEN was not cleared and set since then")


def test_an_error_that_came_behind_the_look_is_no_fault_of_the_program(running: Bench) -> None:
    running.run(MICROSECOND)
    assert running.read(SR) == DRDY
    noise(running, False)
    running.run(2 * MICROSECOND)
    running.read(DR)
    assert running.read(SR) == SECS | SEIS


def test_a_source_that_goes_on_sticking(running: Bench) -> None:
    """Each new start repeats the number and ends in the same error, 65 periods later; a reset is no cure."""
    last = number(running)
    noise(running, False)
    for _ in range(3):
        running.write(CR, 0)
        assert running.read(SR) == 0
        running.write(CR, RNGEN)
        running.run(41 * PERIOD_PS)
        assert number(running, 0) == last
        running.run(25 * PERIOD_PS)
        assert running.read(SR) == SECS | SEIS
        running.write(SR, 0)
        assert running.read(SR) == SECS
    running.lib.machine_bench_reset(running.machine)
    running.full_speed()
    running.write(CR, RNGEN)
    running.run(66 * PERIOD_PS)
    assert running.read(SR) == DRDY | SECS | SEIS
    assert running.report == ""


def test_a_source_that_sticks_shortly_is_not_seen(running: Bench) -> None:
    number(running)
    noise(running, False)
    running.run(64 * PERIOD_PS)
    noise(running, True)
    running.run(MILLISECOND)
    number(running)


def test_nobody_watches_a_generator_that_is_off(fast_chip: Bench) -> None:
    noise(fast_chip, False)
    fast_chip.run(MILLISECOND)
    assert fast_chip.read(SR) == 0


# ---- Under the processor ----

NOTES, NUMBERS = 0x2001F800, 16
PINRSTF, PORRSTF, SFTRSTF = 1 << 26, 1 << 27, 1 << 28


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("random"), oracle.PROGRAMS / "random.c")


def notes(board: Emulator) -> tuple[int, int, int, list[int]]:
    """Return the flags of the reset, the pending bits at the start, the seed errors, and the numbers."""
    flags, pending, errors, count, *words = oracle.words(board.memory(NOTES, 4 * (4 + NUMBERS)))
    return flags, pending, errors, words[: max(count - 1, 0)]


def boots(image: Path, power_on_ps: int = 0, **traits: object) -> tuple[list[int], list[int]]:
    """Return the numbers before and behind a board's reset."""
    with Emulator(image, Configuration(**traits), power_on_ps=power_on_ps) as board:  # type: ignore[arg-type]
        assert board.run(power_on_ps + 5 * MILLISECOND), board.report()
        flags, pending, errors, before = notes(board)
        assert flags & PORRSTF
        assert (pending, errors) == (0, 0)
        assert board.run(power_on_ps + 18 * MILLISECOND), board.report()
        flags, pending, errors, behind = notes(board)
        assert flags == PINRSTF | SFTRSTF
        assert (pending, errors) == (0, 0)  # The number that waited at the reset pends no interrupt behind it.
        assert board.statistics().violations == 0, board.report()
    assert len(before) == len(behind) == NUMBERS
    return before, behind


def test_a_program_that_draws(image: Path) -> None:
    """The same in each run; of each boot, each board, each seed and each time of power others."""
    seen = [boots(image), boots(image)]
    assert seen[0] == seen[1]
    seen = [seen[0], boots(image, unique_id=bytes([*range(12)])), boots(image, memory_seed=2)]
    seen.append(boots(image, power_on_ps=3 * MILLISECOND + 7))
    assert len({word for pair in seen for words in pair for word in words}) == 2 * len(seen) * NUMBERS


def test_a_program_that_recovers(image: Path) -> None:
    """A source that sticks from the start to 3 ms costs errors, and no number is taken of it."""
    with Emulator(image, Configuration()) as board:
        board.noise(False)
        board.noise(True, 3 * MILLISECOND)
        assert board.run(2 * MILLISECOND), board.report()
        assert notes(board)[2] > 2
        assert board.run(5 * MILLISECOND), board.report()
        _, _, errors, words = notes(board)
        assert errors > 2
        assert len(set(words)) == NUMBERS
        assert 0 not in words
        assert board.statistics().violations == 0, board.report()
