"""Registers of timers, DMA controllers and pins, and what their tests do with them."""

from hil_sim.emulator.bench import MICROSECOND, Bench

TIM1, TIM2, TIM3, TIM4, TIM5, TIM6 = 0x40010000, 0x40000000, 0x40000400, 0x40000800, 0x40000C00, 0x40001000
TIM8 = 0x40010400
CR1, CR2, SMCR, DIER, SR, EGR, CCMR1, CCMR2, CCER, CNT, PSC, ARR, RCR, CCR1 = range(0, 0x38, 4)
BDTR, DCR, DMAR = 0x44, 0x48, 0x4C
OSSI, OSSR, BKE, BKP, AOE, MOE = (1 << n for n in range(10, 16))
BIF, COMIF = 0x80, 0x20
FORCED_LOW, FORCED_HIGH, PWM1, PWM2, PRELOAD = 4 << 4, 5 << 4, 6 << 4, 7 << 4, 8
TICK = 1e12 / 168e6

GPIOC, DMA1, DMA2 = 0x40020800, 0x40026000, 0x40026400
SRAM, CCM = 0x20001000, 0x10000000
CIRC, MINC, PINC, DBM, CT = 1 << 8, 1 << 10, 1 << 9, 1 << 18, 1 << 19
TCIE, HTIE = 1 << 4, 1 << 3
TO_PERIPHERAL, TO_MEMORY, MEMORY_TO_MEMORY = 1 << 6, 0, 2 << 6
WORDS, HALVES = 2 << 11 | 2 << 13, 1 << 11 | 1 << 13

PA6, PA7, PA8, PB0, PB12, PB13, PB15 = 6, 7, 8, 16, 28, 29, 31


# ---- DMA ----


def stream(
    chip: Bench, controller: int, n: int, control: int, count: int, peripheral: int, memory: int, **extra: int
) -> None:
    base = controller + 0x10 + 0x18 * n
    chip.write(base + 4, count)
    chip.write(base + 8, peripheral)
    chip.write(base + 0xC, memory)
    chip.write(base + 0x10, extra.get("second", 0))
    chip.write(base + 0x14, extra.get("fifo", 0x21))
    chip.write(base, control | 1)


def pulse(chip: Bench, line: str) -> None:
    """A request, and the time to serve it."""
    assert chip.lib.machine_bench_dma_pulse(chip.machine, line.encode())
    chip.run(0.2 * MICROSECOND)


def flags(chip: Bench, controller: int, n: int) -> int:
    return chip.read(controller + 4 * (n // 4)) >> (0, 6, 16, 22)[n % 4] & 0x3D


# ---- Pins ----


def level(chip: Bench, pin: int) -> int:
    return chip.read(0x40020010 + 0x400 * (pin // 16)) >> pin % 16 & 1


def drives(chip: Bench, pin: int) -> str:
    """What the chip does to a pin: 'low', 'high', or 'off', seen by pulling it up and down from inside."""
    base = 0x40020000 + 0x400 * (pin // 16)
    levels = []
    for pull in (1, 2):
        chip.change(base + 0x0C, pull << 2 * (pin % 16), 3 << 2 * (pin % 16))
        levels.append(level(chip, pin))
    chip.change(base + 0x0C, 0, 3 << 2 * (pin % 16))
    return {(1, 1): "high", (0, 0): "low", (1, 0): "off"}[levels[0], levels[1]]


def set_pin(chip: Bench, pin: int, high: bool) -> None:
    chip.operations.pin_in(chip.board, pin, high, chip.now)
    chip.run(1)


def edges(chip: Bench, pin: int) -> list[tuple[bool, int]]:
    return [(high, time) for number, high, time in chip.edge.pins if number == pin]


def bridge(chip: Bench, bdtr: int = BKE | OSSI | MOE) -> None:
    """TIM1: a PWM on PB13 (CH1N), forced active on PB15 (CH3N), its break on PB12, high for now."""
    chip.alternate("B", 12, 1)
    chip.change(0x4002040C, 1 << 24, 3 << 24)
    chip.alternate("B", 13, 1)
    chip.alternate("B", 15, 1)
    chip.write(TIM1 + ARR, 999)
    chip.write(TIM1 + CCR1, 999)
    chip.write(TIM1 + CCMR1, PWM1 | PRELOAD)
    chip.write(TIM1 + CCMR2, FORCED_HIGH)
    chip.write(TIM1 + CCER, 4 | 4 << 8)
    chip.write(TIM1 + BDTR, bdtr)
    chip.write(TIM1 + CR1, 0x81)
    chip.run(100 * TICK)
