"""What the tests of the second reading share: converters, DMA streams and CAN, addressed as RM0090 has them.

The second reading is a model test by another hand. Its expectations were written from ST's texts and from ISO 11898-1
before models, drivers and their own tests were opened; each test names its source. Of the reference manual RM0090 the
chapters of DMA, ADC and bxCAN were read whole (Rev 21), of the timers' single pages (Rev 11 and 18) and the register
descriptions in ST's SVD, headers and HAL. What the models are held against besides is in
``hil_sim/emulator/peripherals/oracles.md``.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hil_sim.emulator.bench import MICROSECOND, Bench

APB1 = 1e12 / 42e6
APB2 = 1e12 / 84e6
SRAM = 0x20001000

# ---- Converters ----

ADC1, ADC2, ADC3, ADC_COMMON = 0x40012000, 0x40012100, 0x40012200, 0x40012300
CONVERTERS = (ADC1, ADC2, ADC3)
ADC_SR, ADC_CR1, ADC_CR2, ADC_SMPR1, ADC_SMPR2, ADC_JOFR1 = 0, 4, 8, 0x0C, 0x10, 0x14
ADC_SQR1, ADC_SQR3, ADC_JSQR, ADC_JDR1, ADC_DR = 0x2C, 0x34, 0x38, 0x3C, 0x4C
ADC_CSR, ADC_CCR, ADC_CDR = ADC_COMMON, ADC_COMMON + 4, ADC_COMMON + 8
EOC, JEOC, STRT, OVR = 2, 4, 0x10, 0x20
ADON, CONT, DMA_ON, DDS, EOCS, LEFT = 1, 2, 1 << 8, 1 << 9, 1 << 10, 1 << 11
JSWSTART, SWSTART = 1 << 22, 1 << 30
SCAN = 1 << 8
DUAL_SIMULTANEOUS, TRIPLE_SIMULTANEOUS = 0b00110, 0b10110
DMA_MODE_1, DMA_MODE_2, DMA_MODE_3, COMMON_DDS = 1 << 14, 2 << 14, 3 << 14, 1 << 13
PRESCALE_4, PRESCALE_6, PRESCALE_8 = 1 << 16, 2 << 16, 3 << 16
SAMPLING = (3, 15, 28, 56, 84, 112, 144, 480)
VOLTS = 3.3


def code_of_pin(pin: int) -> int:
    """Return the 12-bit code of the constant voltage that `pins_apart` puts on a pin."""
    return 200 + 97 * pin % 3700


def pins_apart(pin: int, _: int) -> float:
    """Each pin has its own constant voltage."""
    return (code_of_pin(pin) + 0.5) / 4096 * VOLTS


@contextmanager
def fast_bench(analog: Callable[[int, int], float] | None = None, **config: Any) -> Iterator[Bench]:
    """Yield a chip at 168 MHz with every clock on; a violation that nobody expected fails the test."""
    chip = Bench(analog, **config)
    chip.full_speed()
    yield chip
    report = chip.report
    chip.close()
    assert not report, report


def analog_pins(chip: Bench) -> None:
    """PA0 to PA3 and PC0 to PC3 to the converters: channels 0 to 3 and 10 to 13 of all three."""
    for n in range(4):
        chip.analog_pin("A", n)
        chip.analog_pin("C", n)


def sequence(chip: Bench, adc: int, *channels: int) -> None:
    """Regular group of up to six channels."""
    chip.write(adc + ADC_SQR1, (len(channels) - 1) << 20)
    chip.write(adc + ADC_SQR3, sum(channel << 5 * n for n, channel in enumerate(channels)))


def channel_pin(channel: int) -> int:
    """Pin of one of the channels of `analog_pins`."""
    return channel if channel < 4 else 32 + channel - 10


def near(value: int, code: int) -> bool:
    """Whether a result is the code but for what sampling and noise may move it."""
    return abs(value - code) <= 3


@contextmanager
def converters() -> Iterator[Bench]:
    """Yield a chip at 168 MHz, its converters at 21 MHz; each pin has a voltage of its own."""
    with fast_bench(pins_apart) as chip:
        analog_pins(chip)
        chip.write(ADC_CCR, PRESCALE_4)
        yield chip


def power(chip: Bench, *converters: int, control: int = 0) -> None:
    """Turn converters on and wait for tSTAB."""
    for adc in converters:
        chip.write(adc + ADC_CR2, control | ADON)
    chip.run(5 * MICROSECOND)


def triple(chip: Bench, common: int, control: int = 0) -> None:
    """Channels 10, 11 and 12, one on each converter, in a multi mode."""
    chip.write(ADC_CCR, PRESCALE_4 | common)
    for adc, channel in zip(CONVERTERS, (10, 11, 12), strict=True):
        sequence(chip, adc, channel)
    power(chip, *CONVERTERS, control=control)


def convert(chip: Bench, microseconds: float = 3) -> None:
    """Start a regular conversion by software and let it end."""
    chip.change(ADC1 + ADC_CR2, SWSTART)
    chip.run(microseconds * MICROSECOND)


def all_near(values: list[int], channels: tuple[int, ...]) -> bool:
    """Whether the results are those of these channels, in this order."""
    codes = [code_of_pin(channel_pin(channel)) for channel in channels]
    return len(values) == len(codes) and all(near(v, c) for v, c in zip(values, codes, strict=True))


def many(chip: Bench, conversions: int) -> None:
    """Conversions of ADC1, each with a request."""
    for _ in range(conversions):
        convert(chip, 2)


def converting(chip: Bench, control: int = 0) -> None:
    """ADC1 on channel 10 with requests that never stop."""
    sequence(chip, ADC1, 10)
    power(chip, ADC1, control=DMA_ON | DDS | control)


# ---- DMA ----

DMA1, DMA2 = 0x40026000, 0x40026400
LISR, HISR, LIFCR = 0, 4, 8
EN, HALF_WORD, WORD, MEMORY_HALF, MEMORY_WORD = 1, 1 << 11, 2 << 11, 1 << 13, 2 << 13
TCIE, HTIE, TO_PERIPHERAL, CIRC, MINC, DBM, CT = 1 << 4, 1 << 3, 1 << 6, 1 << 8, 1 << 10, 1 << 18, 1 << 19
TCIF, HTIF, TEIF, DMEIF, FEIF = 0x20, 0x10, 8, 4, 1


def start_stream(
    chip: Bench, dma: int, n: int, control: int, items: int, peripheral: int, memory: int = SRAM, second: int = 0
) -> None:
    """Set up a stream in direct mode and enable it."""
    base = dma + 0x10 + 0x18 * n
    chip.write(base + 0x04, items)
    chip.write(base + 0x08, peripheral)
    chip.write(base + 0x0C, memory)
    chip.write(base + 0x10, second)
    chip.write(base, control)
    chip.write(base, control | EN)


def stream_flags(chip: Bench, dma: int, n: int) -> int:
    """TCIF, HTIF, TEIF, DMEIF and FEIF of a stream."""
    return chip.read(dma + (LISR if n < 4 else HISR)) >> (0, 6, 16, 22)[n % 4] & 0x3D


def clear_stream_flags(chip: Bench, dma: int, n: int) -> None:
    """Clear them all."""
    chip.write(dma + LIFCR + (0 if n < 4 else 4), 0x3D << (0, 6, 16, 22)[n % 4])


def halves(chip: Bench, count: int, address: int = SRAM) -> list[int]:
    """Half-words in memory."""
    return [chip.read(address + 2 * n, 2) for n in range(count)]


def words(chip: Bench, count: int, address: int = SRAM) -> list[int]:
    """Words in memory."""
    return [chip.read(address + 4 * n) for n in range(count)]


STREAM0 = DMA2 + 0x10

# ---- bxCAN ----

CAN1 = 0x40006400
MCR, MSR, TSR, RF0R, RF1R, IER, ESR, BTR = range(0, 0x20, 4)
TI0R, RI0R, RI1R = 0x180, 0x1B0, 0x1C0
FMR, FM1R, FS1R, FFA1R, FA1R, FILTER = 0x200, 0x204, 0x20C, 0x214, 0x21C, 0x240
INRQ, SLEEP, TXFP, RFLM, NART, AWUM, ABOM = (1 << n for n in range(7))
INAK, SLAK, ERRI, WKUI = 1, 2, 4, 8
RQCP, TXOK, ALST, TERR, ABRQ = 1, 2, 4, 8, 0x80
FMP, FULL, FOVR, RFOM = 3, 8, 0x10, 0x20
EWGF, EPVF, BOFF = 1, 2, 4
LBKM, SILM = 1 << 30, 1 << 31
BIT = 1_000_000
BIT_TIMING = 1 << 20 | 10 << 16 | 2
LISTENS = 3


def can_start(chip: Bench, options: int = 0, test_mode: int = 0) -> None:
    """CAN1 on PB8 and PB9 at 1 Mbit/s in normal mode, without filters yet."""
    chip.alternate("B", 8, 9)
    chip.alternate("B", 9, 9)
    chip.operations.pin_in(chip.board, 24, True, chip.now)
    chip.write(CAN1 + MCR, options | INRQ)
    chip.run(30 * BIT)
    assert chip.read(CAN1 + MSR) & (INAK | SLAK) == INAK
    chip.write(CAN1 + BTR, BIT_TIMING | test_mode)
    chip.write(CAN1 + MCR, options)
    chip.run(30 * BIT)
    assert chip.read(CAN1 + MSR) & (INAK | SLAK) == 0


def filters(
    chip: Bench, banks: dict[int, tuple[int, int]], lists: int = 0, wide: int = 0, second_fifo: int = 0, off: int = 0
) -> None:
    """Filter banks by their two registers; what is off is configured like the rest, but not activated."""
    chip.write(CAN1 + FMR, chip.read(CAN1 + FMR) | 1)
    chip.write(CAN1 + FA1R, 0)
    chip.write(CAN1 + FM1R, lists)
    chip.write(CAN1 + FS1R, wide)
    chip.write(CAN1 + FFA1R, second_fifo)
    for bank, (first, second) in banks.items():
        chip.write(CAN1 + FILTER + 8 * bank, first)
        chip.write(CAN1 + FILTER + 8 * bank + 4, second)
    chip.write(CAN1 + FA1R, sum(1 << bank for bank in banks) & ~off)
    chip.write(CAN1 + FMR, chip.read(CAN1 + FMR) & ~1)


def accept_all(chip: Bench) -> None:
    """One mask filter that lets everything into FIFO 0."""
    filters(chip, {0: (0, 0)}, wide=1)


def receive(chip: Bench, identifier: int, data: bytes = b"", extended: bool = False, remote: bool = False) -> None:
    """Another node's frame is valid now; a remote frame has the length of the data, but none."""
    frame: Any = chip.ffi.new("board_frame_t *")
    frame.id, frame.extended, frame.remote, frame.length = identifier, extended, remote, len(data)
    frame.data[0 : len(data)] = list(data)
    chip.operations.can_in(chip.board, frame, chip.now)
    chip.run(2 * BIT)


def request(chip: Bench, box: int, identifier: int, data: bytes = b"", extended: bool = False) -> None:
    """Fill a mailbox and request its transmission."""
    base = CAN1 + TI0R + 0x10 * box
    padded = data.ljust(8, b"\0")
    chip.write(base + 4, len(data))
    chip.write(base + 8, int.from_bytes(padded[:4], "little"))
    chip.write(base + 12, int.from_bytes(padded[4:], "little"))
    chip.write(base, (identifier << 3 | 4 if extended else identifier << 21) | 1)


def sent(chip: Bench, box: int, ok: bool = True) -> None:
    """The network tells how the transmission of a mailbox ended."""
    chip.operations.can_sent(chip.board, box, ok, chip.now)
    chip.run(1)


def bus_error(chip: Bench, box: int = LISTENS) -> None:
    """A bit error destroyed the frame of a mailbox, or one that the chip listened to."""
    chip.operations.can_error(chip.board, box, chip.now)
    chip.run(1)


def status(chip: Bench, box: int) -> int:
    """RQCP, TXOK, ALST, TERR and ABRQ of a mailbox."""
    return chip.read(CAN1 + TSR) >> 8 * box & 0x8F


def empty(chip: Bench, box: int) -> bool:
    """TME of a mailbox."""
    return bool(chip.read(CAN1 + TSR) >> 26 + box & 1)


def message(chip: Bench, fifo: int = 0) -> tuple[int, int, bytes]:
    """Identifier register, filter match index and data of the output mailbox of a FIFO."""
    base = CAN1 + RI0R + 0x10 * fifo
    length = chip.read(base + 4)
    data = chip.read(base + 8).to_bytes(4, "little") + chip.read(base + 12).to_bytes(4, "little")
    return chip.read(base), length >> 8 & 0xFF, data[: length & 15]


def release(chip: Bench, fifo: int = 0) -> None:
    """Release the output mailbox of a FIFO."""
    chip.write(CAN1 + RF0R + 4 * fifo, RFOM)
    chip.run(BIT)


def counters(chip: Bench) -> tuple[int, int]:
    """Transmit and receive error counter."""
    value = chip.read(CAN1 + ESR)
    return value >> 16 & 0xFF, value >> 24
