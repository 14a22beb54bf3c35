"""Images that stop something of their board once: the application's and the board's own code, with another main.

`fault_probe.c` is that main; what it stops, and when, stands in the parameter page.
"""

import subprocess
from pathlib import Path

from goldfield_protocol.parameters import build_page
from tests.firmware.host_rig import PIN_ENABLE, PIN_LED, ROOT, SECOND, US, Board, chip_seconds

OUT = ROOT / "build/firmware"
BOARD = "firmware/boards/stm32f405"
NOTHING, HANG_MAIN, HANG_INTERRUPT, MASK_INTERRUPT, STOP_TIMER, STOP_STREAM, STOP_ADC, STOP_BURSTS = range(8)
HANG_MASKED, HANG_ALWAYS = 8, 9
DMA1_STREAM1, DMA1_STREAM3, ADC, CAN1_TX, CAN1_RX0, CAN1_RX1, TIM1_BRK, TIM8_CC, TIM7, DMA2_STREAM1 = (
    *(12, 14, 18, 19, 20, 21),
    *(24, 46, 55, 57),
)
DMA1, DMA2 = 0, 16
"""Add the stream."""
CHIP = round(chip_seconds(0) * SECOND)
RUNNING = 3
"""Chips that go on: the one under way, and the two that a coil's current allows."""
PLANNED = 93
"""Chips of the two blocks that may be planned, and of one that is late and repeats the first of them."""


def build_images(directory: Path) -> dict[str, Path]:
    """Link the images into a directory; return them by role."""
    made = {}
    for role in ("beacon", "anchor"):
        path = directory / f"{role}.elf"
        folders = (f"{OUT}/firmware/{part}" for part in ("core", "services", "apps", "boards", "third_party"))
        objects = [str(o) for folder in folders for o in sorted((ROOT / folder).rglob("*.o"))]
        cpu = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O2", "-std=c11"]
        options = [f"-D{role.upper()}", f"-I{ROOT / 'firmware'}", f"-I{ROOT / 'build/protocol'}", "-nostartfiles"]
        link = ["--specs=nano.specs", "-Wl,--gc-sections", "-T", str(ROOT / BOARD / "stm32f405.ld"), "-o", str(path)]
        source = str(ROOT / "tests" / BOARD / "fault_probe.c")
        protocol = str(OUT / "protocol/goldfield.o")
        subprocess.run(["arm-none-eabi-gcc", *cpu, *options, source, *objects, protocol, *link], check=True)
        made[role] = path
    return made


def fault_page(kind: int, which: int, time: int, amplitude: float = 5.0) -> bytes:
    """Return a parameter page that stops something at a time, ps."""
    page = bytearray(build_page({"node": 9, "code": 2, "amplitude": amplitude, "sync_master": 1}).ljust(8192, b"\xff"))
    page[-6:] = (time // US).to_bytes(4, "little") + bytes((kind, which))
    return bytes(page)


def off_after(board: Board) -> int:
    """Return how long after something was stopped the drive went off, ps."""
    off = board.edges(PIN_ENABLE, False)[0]
    return off - max(time for time in board.edges(PIN_LED, False) if time < off)
