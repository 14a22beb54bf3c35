"""Run one program on the emulator and on QEMU's Cortex-M4 (mps2-an386, the oracle) and hand back what it noted."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

from hil_sim.emulator import Configuration, Emulator

PROGRAMS = Path(__file__).parent / "programs"
FLAGS = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16", "-O1", "-nostdlib", "-ffreestanding"]
MILLISECOND = 1_000_000_000


def build(directory: Path, *sources: Path) -> Path:
    """Link a program for address 0, once to be loaded there (QEMU), once into our flash, which also appears at 0."""
    files = [*map(str, sources), str(PROGRAMS / "runtime.c")]
    for name, offset in (("program.elf", 0), ("flash.elf", 0x08000000)):
        command = ["arm-none-eabi-gcc", *FLAGS, f"-I{PROGRAMS}", "-Wl,--build-id=none"]
        command += [f"-Wl,--defsym=LOAD_OFFSET={offset:#x}", "-T", str(PROGRAMS / "program.ld")]
        subprocess.run([*command, "-o", str(directory / name), *files, "-lgcc"], check=True)
    return directory / "flash.elf"


def load(image: Path, *, strict: bool = False, argument: int = 0, cycles_per_instruction: float = 1.0) -> Emulator:
    """Make a board that tolerates violations and handles faults, as QEMU would, or stops at either.

    The program finds the argument at 0xE0000.
    """
    configuration = Configuration(strict=strict, stop_at_fault=strict, cycles_per_instruction=cycles_per_instruction)
    return Emulator(image, configuration, parameter_page=struct.pack("<I", argument))


def words(data: bytes) -> list[int]:
    return list(struct.unpack(f"<{len(data) // 4}I", data))


def word(board: Emulator, symbol: str) -> int:
    return words(board.memory(board.symbols[symbol], 4))[0]


def run_on_emulator(board: Emulator, limit_ms: int = 4000) -> list[int]:
    """Run until the program says that it has finished; return its notes."""
    while word(board, "finished") != 1:  # What RAM holds before the program starts is random.
        assert board.run(board.now_ps + 5 * MILLISECOND), board.report()
        assert board.now_ps < limit_ms * MILLISECOND, board.report()
    return words(board.memory(board.symbols["results"], 4 * word(board, "result_count")))


def run_on_qemu(image: Path, argument: int = 0) -> list[int]:
    """Run the same program, linked for the same address, on QEMU; return its notes."""
    directory = image.parent
    command = ["qemu-system-arm", "-M", "mps2-an386", "-nographic", "-monitor", "none", "-serial", "none"]
    command += ["-semihosting-config", "enable=on,target=native", "-kernel", str(directory / "program.elf")]
    command += ["-device", "loader,addr=0x2001F000,data=0x51454D55,data-len=4"]
    command += ["-device", f"loader,addr=0xE0000,data={argument},data-len=4"]
    subprocess.run(command, cwd=directory, check=True, stdin=subprocess.DEVNULL)
    return words((directory / "results.bin").read_bytes())
