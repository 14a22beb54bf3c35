"""RCC, PWR, GPIO, EXTI, watchdogs, CRC: directed tests on the bare chip."""

import binascii

import pytest

from hil_sim.emulator.bench import MICROSECOND, MILLISECOND, Bench

RCC, PWR, FLASH = 0x40023800, 0x40007000, 0x40023C00
GPIOA, GPIOC, SYSCFG, EXTI = 0x40020000, 0x40020800, 0x40013800, 0x40013C00
IWDG, WWDG, CRC = 0x40003000, 0x40002C00, 0x40023000


def core_clock(chip: Bench) -> float:
    return float(chip.lib.machine_bench_core_clock(chip.machine))


def test_crystal_starts_after_two_milliseconds(chip: Bench) -> None:
    chip.write(RCC, 0x10083)
    chip.run(1.9 * MILLISECOND)
    assert not chip.read(RCC) & 1 << 17
    chip.run(0.2 * MILLISECOND)
    assert chip.read(RCC) & 1 << 17


def test_dead_crystal_never_starts() -> None:
    chip = Bench(crystal_dead=True)
    chip.write(RCC, 0x10083)
    chip.run(1e12)
    assert not chip.read(RCC) & 1 << 17
    chip.close()


@pytest.mark.parametrize("ppm", [0.0, 40.0, -25.0])
def test_pll_and_prescalers(ppm: float) -> None:
    chip = Bench(crystal_ppm=ppm, internal_ppm=5000.0)
    assert core_clock(chip) == pytest.approx(16e6 * 1.005, rel=1e-12)
    chip.full_speed()
    scale = 1 + ppm * 1e-6
    assert core_clock(chip) == pytest.approx(168e6 * scale, rel=1e-12)
    for name, bus, timer in (("TIM1", 84e6, 168e6), ("TIM2", 42e6, 84e6)):
        clocks = [
            f(chip.machine, name.encode())
            for f in (chip.lib.machine_bench_bus_clock, chip.lib.machine_bench_timer_clock)
        ]
        assert clocks == pytest.approx([bus * scale, timer * scale], rel=1e-12)
    assert not chip.report
    chip.close()


@pytest.mark.parametrize(
    ("latency", "cfgr", "sentence"),
    [
        (4, 5 << 10 | 4 << 13 | 2, "too few wait states"),
        (5, 4 << 10 | 4 << 13 | 2, "above 42 MHz"),
        (5, 5 << 10 | 2, "above 84 MHz"),
    ],
)
def test_clock_limits(chip: Bench, latency: int, cfgr: int, sentence: str) -> None:
    chip.write(FLASH, latency)
    chip.write(RCC, 0x10083)
    chip.run(2.5 * MILLISECOND)
    chip.write(RCC + 4, 0x27405408 & ~0x3FFF | 12 | 336 << 6 & 0x7FC0 | 0x20000000)
    chip.change(RCC, 1 << 24)
    chip.run(MILLISECOND)
    chip.write(RCC + 8, cfgr)
    chip.expect(sentence)


def test_pll_rules(chip: Bench) -> None:
    chip.write(RCC + 4, 0x20000000 | 16 | 500 << 6 | 7 << 24)
    chip.change(RCC, 1 << 24)
    chip.expect("not in 2..63, 50..432")
    chip.write(RCC + 4, 0x20000000 | 8 | 336 << 6 | 7 << 24)
    chip.expect("written while the PLL is on")


def test_scale_2_stops_at_144_mhz(fast_chip: Bench) -> None:
    fast_chip.write(PWR, 0)
    fast_chip.expect("above the limit of regulator scale 2")


def test_switch_waits_for_the_clock(chip: Bench) -> None:
    chip.write(RCC, 0x10083)
    chip.write(RCC + 8, 1)
    assert chip.read(RCC + 8) & 0xC == 0
    chip.run(2.1 * MILLISECOND)
    assert chip.read(RCC + 8) & 0xC == 4
    assert core_clock(chip) == 12e6


def test_access_without_clock_and_too_soon(chip: Bench) -> None:
    chip.read(GPIOA)
    chip.expect("its clock is off")
    chip.write(RCC + 0x30, 1)
    chip.read(GPIOA)
    chip.expect("too soon after its clock was enabled")
    assert chip.read(GPIOA) == 0xA8000000


def test_reset_register(fast_chip: Bench) -> None:
    fast_chip.write(GPIOC, 1)
    fast_chip.write(RCC + 0x10, 4)
    fast_chip.read(GPIOC)
    fast_chip.expect("holds the peripheral in reset")
    fast_chip.write(RCC + 0x10, 0)
    assert fast_chip.read(GPIOC) == 0


def test_output_edges_and_their_times(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(GPIOC, 1 << 12)  # PC6
    chip.write(GPIOC + 0x18, 1 << 6)
    first = chip.now
    chip.run(MICROSECOND)
    chip.write(GPIOC + 0x18, 1 << 6)  # No change, no edge
    chip.write(GPIOC + 0x18, 1 << 22)
    assert chip.edge.pins == [(38, False, first), (38, True, first), (38, False, first + MICROSECOND)]
    assert chip.read(GPIOC + 0x10) & 64 == 0


def test_byte_and_half_word_access(fast_chip: Bench) -> None:
    fast_chip.write(GPIOC, 0x5555)
    fast_chip.write(GPIOC + 0x1A, 0x01, 2)
    fast_chip.write(GPIOC + 0x18, 0x81, 1)
    assert fast_chip.read(GPIOC + 0x14) == 0x81
    fast_chip.write(EXTI, 1, 2)
    fast_chip.expect("16 bits is not supported")


def test_pulls_inputs_and_exti(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(GPIOC + 0x0C, 1 << 20)  # PC10 pulled up
    assert chip.read(GPIOC + 0x10) == 1 << 10
    chip.write(SYSCFG + 0x10, 2 << 8)
    chip.write(EXTI + 0x0C, 1 << 10)
    chip.write(EXTI, 1 << 10)
    chip.operations.pin_in(chip.board, 42, False, chip.now + 500)
    chip.run(1000)
    assert chip.read(GPIOC + 0x10) == 0
    assert chip.irq(40)
    assert chip.read(EXTI + 0x14) == 1 << 10
    chip.write(EXTI + 0x14, 1 << 10)
    assert not chip.irq(40)
    chip.write(EXTI + 0x10, 1 << 10)
    assert chip.irq(40)


def test_lock(fast_chip: Bench) -> None:
    for value in (0x10001, 0x00001, 0x10001):
        fast_chip.write(GPIOC + 0x1C, value)
    assert fast_chip.read(GPIOC + 0x1C) == 0x10001
    fast_chip.write(GPIOC, 1)
    fast_chip.expect("locked pin 0")
    fast_chip.write(GPIOC, 4)
    assert fast_chip.read(GPIOC) == 4


@pytest.mark.parametrize("ppm", [0.0, 10000.0])
def test_independent_watchdog(ppm: float) -> None:
    chip = Bench(internal_ppm=ppm)
    chip.write(IWDG, 0x5555)
    chip.write(IWDG + 4, 1)  # 32 kHz / 8
    chip.write(IWDG + 8, 99)
    assert chip.read(IWDG + 0xC) == 3
    chip.run(MILLISECOND)
    assert chip.read(IWDG + 0xC) == 0
    chip.write(IWDG, 0xCCCC)
    period = 100 * 8 / (32000 * (1 + ppm * 1e-6)) * 1e12
    for _ in range(3):
        chip.run(0.9 * period)
        chip.write(IWDG, 0xAAAA)
    flags = chip.ffi.new("uint32_t *")
    chip.run(period - MICROSECOND)
    assert not chip.lib.machine_bench_reset_requested(chip.machine, flags)
    chip.run(2 * MICROSECOND)
    chip.lib.machine_bench_reset(chip.machine)
    assert chip.read(RCC + 0x74) == 0x2E000000  # IWDG, power-on, brown-out and pin flags
    chip.change(RCC + 0x74, 1 << 24)
    assert chip.read(RCC + 0x74) == 0
    chip.write(IWDG + 4, 1)
    chip.expect("without the key 0x5555")
    chip.close()


def test_window_watchdog(fast_chip: Bench) -> None:
    chip = fast_chip
    flags = chip.ffi.new("uint32_t *")
    chip.write(WWDG + 4, 0x250)  # Early interrupt, window 0x50
    chip.write(WWDG, 0xFF)
    step = 4096 / 42e6 * 1e12
    chip.run((0x7F - 0x40) * step + 1)
    assert chip.irq(0)
    assert not chip.lib.machine_bench_reset_requested(chip.machine, flags)
    chip.run(step)
    assert chip.lib.machine_bench_reset_requested(chip.machine, flags)
    assert flags[0] == 1 << 30


def test_crc_unit(fast_chip: Bench) -> None:
    """The truth is zlib's CRC-32: the same polynomial, bits mirrored."""
    words = [0x12345678, 0, 0xDEADBEEF]
    for word in words:
        fast_chip.write(CRC, word)

    def mirror(value: int) -> int:
        return int(f"{value:032b}"[::-1], 2)

    data = b"".join(mirror(word).to_bytes(4, "little") for word in words)
    assert fast_chip.read(CRC) == mirror(binascii.crc32(data) ^ 0xFFFFFFFF)


def test_reset_releases_the_outputs(fast_chip: Bench) -> None:
    """The bridge's enable must not stay on over a reset."""
    chip = fast_chip
    chip.write(GPIOC, 1 << 18)
    chip.write(GPIOC + 0x18, 1 << 9)
    chip.run(MICROSECOND)
    chip.edge.released.clear()
    chip.lib.machine_bench_reset(chip.machine)
    assert [level for _, level, _ in chip.edge.pins] == [False, True]
    assert chip.edge.released == [(41, "none", chip.now)]


@pytest.mark.parametrize(("code", "pull"), [(0, "none"), (1, "up"), (2, "down")])
def test_pins_that_nothing_drives_are_released(fast_chip: Bench, code: int, pull: str) -> None:
    """Input, analog, a timer's alternate function with the output off, open drain at 1; each tells its pull."""
    chip = fast_chip

    def drive() -> None:
        chip.write(GPIOC, 1 << 12)

    drive()
    assert chip.edge.pins == [(38, False, chip.now)]
    chip.write(GPIOC + 0x0C, code << 12)
    chip.write(GPIOC, 0)
    drive()
    chip.write(GPIOC, 3 << 12)
    drive()
    chip.alternate("C", 6, 3)
    drive()
    chip.write(GPIOC + 4, 1 << 6)
    chip.write(GPIOC + 0x18, 1 << 6)
    assert [row[:2] for row in chip.edge.released] == [(38, pull), (38, "none"), (38, pull), (38, pull)]
    chip.alternate("C", 6, 8)  # USART6_TX: its bytes tell what it does
    assert len(chip.edge.released) == 4


def test_a_pull_alone_is_told(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.edge.released.clear()
    chip.write(GPIOC + 0x0C, 1 << 12)
    chip.write(GPIOC + 0x0C, 2 << 12)
    assert [row[:2] for row in chip.edge.released] == [(38, "up"), (38, "down")]
    assert chip.edge.pins == []


def test_open_drain_reads_what_the_wire_is(fast_chip: Bench) -> None:
    chip = fast_chip
    chip.write(GPIOC + 0x04, 1 << 3)
    chip.write(GPIOC + 0x0C, 1 << 6)  # Pulled up
    chip.write(GPIOC + 0x14, 1 << 3)
    chip.write(GPIOC, 1 << 6)
    assert chip.read(GPIOC + 0x10) == 1 << 3
    chip.operations.pin_in(chip.board, 35, False, chip.now)
    chip.run(1000)
    assert chip.read(GPIOC + 0x10) == 0
    chip.operations.pin_in(chip.board, 35, True, chip.now)
    chip.run(1000)
    chip.write(GPIOC + 0x18, 1 << 19)
    assert chip.read(GPIOC + 0x10) == 0
    assert [level for _, level, _ in chip.edge.pins] == [False]
    assert chip.edge.released[-1][:2] == (35, "up")
