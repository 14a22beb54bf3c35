"""What a board knows of its last run: the cause of the reset, the crash, and the words that outlive it."""

import struct
import subprocess
from pathlib import Path

import pytest

from hil_sim.emulator.emulator import Configuration, Emulator

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[3]
BOARD = "firmware/boards/stm32f405"
HANG, RESTART, BUS_FAULT, NO_INSTRUCTION, DIVISION, OVERFLOW, NULL_READ, FLASH_WRITE, RAM_CODE = range(1, 10)
CAUSES = ("power_on", "brown_out", "pin", "software", "watchdog", "window", "low_power")
CRASH = ("exception", "pc", "lr", "sp", "cfsr", "hfsr", "address")
MS = 1_000_000_000
RUN_MS = 1110
WATCHDOG_MS = 500
"""With the nominal oscillator."""


@pytest.fixture(scope="module")
def image(tmp_path_factory):
    path = tmp_path_factory.mktemp("probe") / "reset_probe.elf"
    objects = sorted((ROOT / "build" / "firmware" / BOARD).glob("*.o"))
    assert objects, "the board is not built: run make firmware"
    cpu = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O1", "-g", "-std=c11", "-Wall"]
    link = ["-nostartfiles", "--specs=nano.specs", "-Wl,--gc-sections", "-T", str(ROOT / BOARD / "stm32f405.ld")]
    source = str(HERE / "reset_probe.c")
    command = ["arm-none-eabi-gcc", *cpu, f"-I{ROOT / 'firmware'}", source, *map(str, objects), *link, "-o", str(path)]
    subprocess.run(command, check=True)
    return path


@pytest.fixture
def board(image):
    boards = []

    def make(*ends):
        page = bytes(ends) + bytes(1000)
        boards.append(Emulator(image, Configuration(stop_at_fault=False), parameter_page=page))
        return boards[-1]

    yield make
    for b in boards:
        b.close()


def told(b):
    """Return what `probe` holds: hal_reset_t, the word of the run before, the number of the run."""
    layout = "<III7I7I8IB3xII"
    values = struct.unpack(layout, b.memory(b.symbols["probe"], struct.calcsize(layout)))
    return {
        "cause": CAUSES[values[0]],
        "uptime_s": values[1],
        "stalled": values[2],
        "counts": {name: n for name, n in zip(CAUSES, values[3:10], strict=True) if n},
        "crash": dict(zip(CRASH, values[10:17], strict=True)) if values[10] else None,
        "stack": values[17:25],
        "stack_overflow": bool(values[25]),
        "word": values[26],
        "run": values[27],
    }


def run(b, ms):
    assert b.run(int(ms * MS)), b.report()
    return told(b)


def test_power_on_remembers_nothing(board):
    first = run(board(), 100)
    assert (first["cause"], first["uptime_s"], first["stalled"], first["crash"]) == ("power_on", 0, 0, None)
    assert first["counts"] == {"power_on": 1}
    assert (first["word"], first["run"]) == (0, 0)


def test_a_restart_is_told_with_its_uptime_and_keeps_the_words(board):
    second = run(board(RESTART), RUN_MS + 20)
    assert (second["cause"], second["uptime_s"], second["crash"]) == ("software", 1, None)
    assert second["counts"] == {"power_on": 1, "software": 1}
    assert (second["word"], second["run"]) == (0x600D0000, 1)


def test_a_hang_is_told_as_the_watchdogs_and_what_stood_still_too(board):
    b = board(HANG, HANG, RESTART)
    assert run(b, RUN_MS + WATCHDOG_MS - 30)["run"] == 0
    second = run(b, RUN_MS + WATCHDOG_MS + 30)
    assert (second["cause"], second["uptime_s"], second["stalled"], second["crash"]) == ("watchdog", 1, 5, None)
    third = run(b, 2 * (RUN_MS + WATCHDOG_MS) + 50)
    assert third["counts"] == {"power_on": 1, "watchdog": 2}
    fourth = run(b, 3 * RUN_MS + 2 * WATCHDOG_MS + 90)
    assert (fourth["cause"], fourth["stalled"], fourth["word"], fourth["run"]) == ("software", 0, 0x600D0002, 3)
    assert fourth["counts"] == {"power_on": 1, "watchdog": 2, "software": 1}


PRECISE, IMPRECISE, MMARVALID, BFARVALID, DACCVIOL, IACCVIOL = 1 << 9, 1 << 10, 1 << 7, 1 << 15, 1 << 1, 1 << 0
MEMORY, BUS, USAGE = 4, 5, 6


def crashed(b):
    second = run(b, RUN_MS + WATCHDOG_MS + 60)
    assert (second["cause"], second["uptime_s"], second["stalled"], second["run"]) == ("watchdog", 1, 0, 1)
    assert second["counts"] == {"power_on": 1, "watchdog": 1}
    return second


def assert_inside(b, second, function):
    """The program counter is in the function, and the link register in main, which called it."""
    assert b.symbols[function] & ~1 <= second["crash"]["pc"] < (b.symbols[function] & ~1) + 0x60
    assert b.symbols["main"] & ~1 <= second["crash"]["lr"] & ~1 < (b.symbols["main"] & ~1) + 0x200


@pytest.mark.parametrize(
    ("how", "exception", "cfsr", "address"),
    [
        (BUS_FAULT, BUS, PRECISE | BFARVALID, 0x30000000),
        (NO_INSTRUCTION, USAGE, 1 << 16, 0),
        (NULL_READ, MEMORY, DACCVIOL | MMARVALID, 8),
    ],
)
def test_a_crash_is_told_with_its_registers(board, how, exception, cfsr, address):
    b = board(how)
    second = crashed(b)
    crash = second["crash"]
    assert (crash["exception"], crash["cfsr"], crash["hfsr"], crash["address"]) == (exception, cfsr, 0, address)
    assert_inside(b, second, "fail")
    assert not second["stack_overflow"]
    top = b.symbols["stack_top"]
    assert top - 512 < crash["sp"] < top
    # The stack holds the way back to where main called.
    assert any(b.symbols["main"] & ~1 <= word & ~1 < (b.symbols["main"] & ~1) + 0x200 for word in second["stack"])


def test_a_write_to_flash_crashes(board):
    b = board(FLASH_WRITE)
    second = crashed(b)
    assert second["crash"]["exception"] in (MEMORY, BUS)  # test_images.py tells which of them, on QEMU
    assert_inside(b, second, "fail")


def test_code_in_ram_is_not_executed(board):
    second = crashed(board(RAM_CODE))
    assert second["crash"]["exception"] == MEMORY
    assert second["crash"]["cfsr"] == IACCVIOL
    assert 0x20000000 <= second["crash"]["pc"] < 0x20002000


def test_a_stack_overflow_is_told_as_such_with_its_latest_calls(board):
    b = board(OVERFLOW)
    second = crashed(b)
    assert second["stack_overflow"]
    assert second["crash"]["exception"] in (MEMORY, BUS)  # test_images.py tells which of them, on QEMU
    begin = b.symbols["overflow"] & ~1
    assert any(begin <= word & ~1 < begin + 0x60 for word in second["stack"])


def test_a_crash_that_is_over_is_forgotten_and_counted(board):
    b = board(NULL_READ, RESTART)
    crashed(b)
    third = run(b, 2 * RUN_MS + WATCHDOG_MS + 90)
    assert (third["cause"], third["crash"], third["run"]) == ("software", None, 2)
    assert third["counts"] == {"power_on": 1, "watchdog": 1, "software": 1}


def test_the_serial_port_tells_a_crash_at_once(image):
    heard = bytearray()
    with Emulator(
        image,
        Configuration(stop_at_fault=False),
        parameter_page=bytes([NULL_READ]) + bytes(1000),
        uart_out=lambda uart, byte, time: heard.append(byte),
    ) as b:
        b.run(int((RUN_MS + 20) * MS))
    assert b"\0crash pc=080" in heard
    assert b" cfsr=00000082 hfsr=00000000 ipsr=00000004\r\n\0" in heard
