"""The table of pinout.md against the carrier's headers and loads, ST's functions of each pin, and the firmware.

``pyboard_v11.csv`` lists the pyboard v1.1: its headers after MicroPython's ports/stm32/boards/PYBV11/pins.csv, and what
hangs on its other pins after the board's schematic (PYBv1.1, micropython.org/resources).
"""

import csv
import re
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
PINOUT = HERE.parents[2] / "firmware" / "boards" / "pinout.md"
BOARD = HERE.parents[2] / "firmware" / "boards" / "stm32f405" / "board.c"

# STM32F405 data sheet (DS8626), table 9: alternate functions of the pins used.
ALTERNATE = {
    ("PA6", "TIM8_BKIN"): 3,
    ("PA7", "TIM3_CH2"): 2,
    ("PB0", "TIM8_CH2N"): 3,
    ("PB1", "TIM8_CH3N"): 3,
    ("PB8", "CAN1_RX"): 9,
    ("PB9", "CAN1_TX"): 9,
    ("PB10", "USART3_TX"): 7,
    ("PB11", "USART3_RX"): 7,
    ("PB12", "TIM1_BKIN"): 1,
    ("PB13", "TIM1_CH1N"): 1,
    ("PB14", "TIM1_CH2N"): 1,
    ("PB15", "TIM1_CH3N"): 1,
    ("PC6", "TIM8_CH1"): 3,
}
# The same, table 7: additional functions; ADC123_IN0 is channel 0 of each of the three converters.
ADDITIONAL = {
    **{f"PA{n}": f"ADC123_IN{n}" for n in range(4)},
    **{f"PC{n}": f"ADC123_IN{n + 10}" for n in range(5)},
    "PA4": "DAC_OUT1",
    "PA5": "DAC_OUT2",
}
# Loads that a signal may share: the LED is what its pin is for.
HARMLESS = {("PB4", "blue LED")}


@pytest.fixture(scope="module")
def pins():
    rows = re.findall(
        r"^\| (P[A-C]\d+) \| (\w+) \| [\w, ]+ \| (.+) \| (\w+)(?: \(AF(\d+)\))? \|$", PINOUT.read_text(), re.M
    )
    assert len(rows) == PINOUT.read_text().count("\n| P")
    assert len(rows) == 25
    return rows


@pytest.fixture(scope="module")
def carrier():
    with (HERE / "pyboard_v11.csv").open(newline="") as file:
        return {row["pin"]: row for row in csv.DictReader(file)}


def test_no_pin_and_no_function_twice(pins):
    assert len({pin for pin, *_ in pins}) == len(pins)
    functions = [function for _, _, _, function, _ in pins if function != "GPIO"]
    assert len(set(functions)) == len(functions)


def test_every_pin_is_on_its_header_and_nothing_hangs_on_it(pins, carrier):
    for pin, header, *_ in pins:
        assert header == (carrier[pin]["header"] or "LED"), pin
        load = carrier[pin]["on_board"]
        assert not load or (pin, load) in HARMLESS, f"{pin}: {load}"


def test_every_function_is_one_of_its_pin(pins):
    for pin, _, _, function, alternate in pins:
        if alternate:
            assert ALTERNATE[pin, function] == int(alternate), pin
        elif function != "GPIO":
            converter = re.fullmatch(r"ADC([123])_(IN\d+)", function)
            assert ADDITIONAL[pin] == (f"ADC123_{converter[2]}" if converter else function), pin


def test_what_may_switch_a_coil_on_is_pulled_down_and_a_fault_up(pins):
    signals = {pin: signal for pin, _, signal, *_ in pins}
    assert signals["PB15"].endswith("pull-down")
    assert signals["PA7"].endswith("pull-down")
    assert signals["PB12"].endswith("pull-up")


def test_the_firmware_sets_these_pins_and_no_others(pins):
    """Compares the table with what board.c writes, read as text."""
    functions = dict(re.findall(r"(\w+)_FUNCTION = (\d+)", BOARD.read_text()))
    body = BOARD.read_text()
    body = body[body.index("static void pins_start") : body.index("static void watchdog_start")]
    found = {}
    spans = {}
    for line in body.splitlines():
        loop = re.search(r"for \(unsigned pin = (\d+); pin <= (\d+)", line)
        if loop:
            spans = range(int(loop[1]), int(loop[2]) + 1)
        call = re.search(r"pin_(alternate|mode)\(GPIO([A-C]), (\w+), (\w+),", line)
        if call:
            numbers = spans if call[3] == "pin" else [int(call[3])]
            for number in numbers:
                found[f"P{call[2]}{number}"] = call[4]
    assert found.keys() == {pin for pin, *_ in pins}
    for pin, _, _, function, alternate in pins:
        if alternate:
            assert functions[found[pin].removesuffix("_FUNCTION")] == alternate, pin
        else:
            assert found[pin] == ("MODE_OUTPUT" if function == "GPIO" else "MODE_ANALOG"), pin
