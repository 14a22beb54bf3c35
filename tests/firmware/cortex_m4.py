"""A program on a Cortex-M4 of its own (Unicorn), whose functions are called one by one; their instructions counted."""

from __future__ import annotations

import struct
import subprocess
from collections.abc import Iterable
from pathlib import Path

import unicorn
from elftools.elf.elffile import ELFFile
from unicorn import arm_const as arm

CPU = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-std=c11")
FLASH, RAM, STACK, STOP = 0x08000000, 0x20000000, 0x20040000, 0x0803FF00
STACK_BYTES = 8192


def link(elf: Path, sources: Iterable[Path], flags: Iterable[str]) -> None:
    """Compile and link sources for `Machine`; what nothing calls is left out if the flags make a section of each."""
    layout = (f"-Ttext={FLASH:#x}", f"-Tdata={RAM:#x}", "-nostartfiles", "--specs=nano.specs")
    rest = ("-Wl,-e,0,--no-warn-rwx-segments", "-o", str(elf))
    subprocess.run(["arm-none-eabi-gcc", *CPU, *flags, *map(str, sources), *layout, *rest], check=True)


class Machine:
    """A program that `link` made; instructions are counted a basic block at a time."""

    def __init__(self, elf: Path) -> None:
        self.unicorn = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB)
        self.unicorn.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        self.unicorn.mem_map(FLASH, 0x40000)
        self.unicorn.mem_map(RAM, 0x40000)
        self.symbols = {}
        with elf.open("rb") as file:
            loaded = ELFFile(file)
            for segment in loaded.iter_segments("PT_LOAD"):
                self.unicorn.mem_write(segment["p_vaddr"], segment.data())
            for symbol in loaded.get_section_by_name(".symtab").iter_symbols():
                self.symbols[symbol.name] = symbol["st_value"], symbol["st_size"]
        self.unicorn.reg_write(arm.UC_ARM_REG_C1_C0_2, 0xF << 20)
        self.unicorn.reg_write(arm.UC_ARM_REG_FPEXC, 1 << 30)
        self.blocks: dict[tuple[int, int], int] = {}
        self.count = 0
        self.unicorn.hook_add(unicorn.UC_HOOK_BLOCK, self._block)

    def _block(self, _: unicorn.Uc, address: int, size: int, __: object) -> None:
        if (address, size) not in self.blocks:
            halfwords = struct.unpack(f"<{size // 2}H", self.unicorn.mem_read(address, size))
            place = count = 0
            while place < len(halfwords):
                place += 2 if halfwords[place] >= 0xE800 else 1  # Thumb-2: such a halfword begins a long instruction.
                count += 1
            self.blocks[address, size] = count
        self.count += self.blocks[address, size]

    def call(self, name: str) -> tuple[int, int]:
        """Return instructions and stack of a call."""
        self.count = 0
        self.unicorn.mem_write(STACK - STACK_BYTES, b"\xa5" * STACK_BYTES)
        self.unicorn.reg_write(arm.UC_ARM_REG_SP, STACK)
        self.unicorn.reg_write(arm.UC_ARM_REG_LR, STOP | 1)
        self.unicorn.emu_start(self.symbols[name][0] | 1, STOP)
        used = bytes(self.unicorn.mem_read(STACK - STACK_BYTES, STACK_BYTES)).lstrip(b"\xa5")
        return self.count, len(used)

    def write(self, name: str, data: bytes) -> None:
        """Write a variable."""
        self.unicorn.mem_write(self.symbols[name][0], data)

    def read(self, name: str) -> bytes:
        """Return the bytes of a variable."""
        return bytes(self.unicorn.mem_read(*self.symbols[name]))

    def word(self, name: str) -> int:
        """Return the value of a variable of 32 bits."""
        return int(struct.unpack("<I", self.unicorn.mem_read(self.symbols[name][0], 4))[0])
