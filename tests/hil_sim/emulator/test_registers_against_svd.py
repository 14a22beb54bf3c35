"""Every register of the models against ST's own SVD: offset, reset value, defined bits, and the reserved-bit rule.

The SVD is that of the STM32F429, whose peripherals are a superset of the F405's. Where it differs from RM0090's
description of the F405 the difference is listed here with its reason; anything else must agree bit for bit.
"""

import re
import xml.etree.ElementTree as ElementTree
import zipfile
from functools import cache
from pathlib import Path

import pyocd
import pytest

from hil_sim.emulator.bench import Bench

PERIPHERALS = [
    *(
        "RCC",
        "PWR",
        "FLASH",
        "SYSCFG",
        "EXTI",
        "DMA1",
        "DMA2",
        "ADC1",
        "ADC2",
        "ADC3",
        "C_ADC",
        "DAC",
        "CAN1",
        "CAN2",
        "IWDG",
        "WWDG",
        "CRC",
        "RNG",
    ),
    *(f"GPIO{port}" for port in "ABCDEFGHI"),
    *(f"TIM{n}" for n in range(1, 15)),
    *("USART1", "USART2", "USART3", "UART4", "UART5", "USART6"),
]

# (peripheral pattern, register pattern): (reset or None, bits or None, reason)
DEVIATIONS = [
    ("RCC", "CIR", None, 0x00BF3F3F, "bits 6, 14, 22 are the F42x's PLLSAI"),
    ("RCC", "AHB1RSTR", None, 0x226011FF, "no GPIOJ, GPIOK, DMA2D; the SVD's bits 9 and 10 are theirs"),
    ("RCC", "AHB1ENR", None, 0x7E7411FF, "no GPIOJ, GPIOK, DMA2D"),
    ("RCC", "AHB1LPENR", None, 0x7E6791FF, "no GPIOJ, GPIOK, DMA2D, SRAM3; the F405's reset value is all its bits"),
    (
        "RCC",
        "AHB2RSTR|AHB2ENR|AHB2LPENR",
        None,
        0xF1,
        "RM0090's F415/417 table has CRYP and HASH (bits 4, 5), and bits 4 and 5 are in the LP reset value 0xF1",
    ),
    ("RCC", "APB1RSTR|APB1ENR|APB1LPENR", None, 0x36FEC9FF, "no UART7, UART8"),
    ("RCC", "APB2RSTR", None, 0x00075933, "no SPI4 to 6, SAI, LTDC"),
    ("RCC", "APB2ENR|APB2LPENR", None, 0x00075F33, "no SPI4 to 6, SAI, LTDC"),
    ("RCC", "PLLI2SCFGR", None, 0x70007FC0, "no PLLI2SQ"),
    ("PWR", "CR", 0x4000, 0x43FF, "one VOS bit, no over-drive, no ADCDC1, no low-voltage regulator bits"),
    ("PWR", "CSR", None, 0x430F, "no over-drive"),
    ("FLASH", "CR", None, 0x8301037F, "one bank: no MER1, SNB of 4 bits"),
    ("GPIOA", "OSPEEDR", 0x0C000000, None, "RM0090 8.4.3: the debug pin's speed; the SVD has 0"),
    (
        "GPIO[C-I]",
        "MODER|OSPEEDR|PUPDR",
        0,
        None,
        "RM0090 8.4: other ports reset to 0; the SVD derives ports C to H from port K",
    ),
    ("SYSCFG", "MEMRM", None, 0x3, "no FMC swap, no bank swap, MEM_MODE of two bits"),
    ("SYSCFG", "PMC", None, 0x00800000, "no ADCxDC2"),
    (
        "DMA[12]",
        "S[1-7]CR",
        None,
        0x0FEFFFFF,
        "bit 20 is reserved in RM0090 10.5.5; the SVD calls it ACK in streams 1 to 7",
    ),
    ("ADC[123]", "SMPR1", None, 0x07FFFFFF, "nine fields of three bits; the SVD makes one field of 32"),
    ("ADC[123]", "SMPR2", None, 0x3FFFFFFF, "ten fields of three bits; the SVD makes one field of 32"),
    ("US?ART[1-6]", "SR", 0xC0, None, "RM0090 30.6.1: 0x00C0 0000 is a misprint of the half-word 0x00C0 (TXE, TC)"),
    (
        "TIM1|TIM8|TIM[3-4]|TIM6|TIM7|TIM9|TIM1[0-4]",
        "ARR",
        0xFFFF,
        None,
        "RM0090 18.4.12: resets to all ones; the SVD has 0",
    ),
    ("TIM2|TIM5", "ARR", 0xFFFFFFFF, None, "the same, 32 bits"),
    (
        "TIM[34]",
        "CNT|ARR|CCR[1-4]",
        None,
        0xFFFF,
        "RM0090 18: TIM3 and TIM4 have 16 bits; the SVD has upper halves for all",
    ),
    ("TIM9|TIM12", "CCMR1", None, 0xFFFF, "IC1F and IC2F have four bits; the SVD has three"),
    ("CAN[12]", "BTR", 0x01230000, None, "RM0090 32.9.2: 0x0123 0000; the SVD has 0"),
]
# In the SVD, not in the F405: (peripheral pattern, register pattern, reason)
ABSENT = [
    ("FLASH", "OPTCR1", "second bank"),
    ("TIM9|TIM12", "CR2", "RM0090 19.5 has no CR2 in these timers"),
    ("TIM1[34]", "OR", "only TIM11 has it"),
    ("CAN2", "F.*", "RM0090 32.9.4: the filter registers are CAN1's"),
]


@cache
def svd() -> dict[str, ElementTree.Element]:
    path = Path(pyocd.__file__).parent / "debug" / "svd" / "svd_data.zip"
    with zipfile.ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("STM32F429x.svd"))
    return {p.findtext("name", ""): p for p in root.iter("peripheral")}


def svd_registers(name: str) -> tuple[int, dict[str, tuple[int, int, int]]]:
    """Base address, and by register: offset, reset value, bits."""
    peripheral = svd()[name]
    source = svd()[peripheral.get("derivedFrom", name)]
    found: dict[str, tuple[int, int, int]] = {}
    for register in source.iter("register"):
        bits = 0
        for part in register.iter("field"):
            bits |= ((1 << int(part.findtext("bitWidth", "0"))) - 1) << int(part.findtext("bitOffset", "0"))
        title = re.sub("_(Output|Input)$", "", register.findtext("name", ""))
        offset, reset = (int(register.findtext(tag, ""), 0) for tag in ("addressOffset", "resetValue"))
        found[title] = (offset, reset, bits | (found[title][2] if title in found else 0))
    return int(peripheral.findtext("baseAddress", ""), 0), found


@pytest.mark.parametrize("name", PERIPHERALS)
def test_registers(chip: Bench, name: str) -> None:
    base, expected = svd_registers(name)
    assert chip.base(name) == base
    actual = {title: row[:3] for title, row in chip.registers(name).items()}
    for title in list(expected):
        if any(re.fullmatch(p, name) and re.fullmatch(r, title) for p, r, _ in ABSENT):
            del expected[title]
            continue
        offset, reset, bits = expected[title]
        for peripheral, register, new_reset, new_bits, _ in DEVIATIONS:
            if re.fullmatch(peripheral, name) and re.fullmatch(register, title):
                reset = reset if new_reset is None else new_reset
                bits = bits if new_bits is None else new_bits
        expected[title] = (offset, reset, bits)
    assert actual == expected


@pytest.mark.parametrize("name", PERIPHERALS)
def test_reset_values_read_back(chip: Bench, name: str) -> None:
    """Except write-only registers, and those that show the present rather than a stored value."""
    chip.clocks_on()
    live = {
        ("RCC", "CR"),
        ("PWR", "CSR"),
        ("RNG", "DR"),
        *(("RCC", f"{bus}ENR") for bus in ("AHB1", "AHB2", "APB1", "APB2")),
    }
    live |= {(f"GPIO{port}", "IDR") for port in "AB"}
    for title, (offset, reset, _, access) in chip.registers(name).items():
        if access != 2 and (name, title) not in live:
            assert chip.read(chip.base(name) + offset) == reset, title


@pytest.mark.parametrize("name", PERIPHERALS)
def test_reserved_bits_are_loud(chip: Bench, name: str) -> None:
    chip.clocks_on()
    for offset, reset, bits, access in chip.registers(name).values():
        reserved = ~bits & 0xFFFFFFFF
        if reserved == 0 or access == 3:
            continue
        lowest = reserved & -reserved
        chip.write(chip.base(name) + offset, reset ^ lowest)
        chip.expect("read-only register" if access == 1 else "changes reserved bits")
