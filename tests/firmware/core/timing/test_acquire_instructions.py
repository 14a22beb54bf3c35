"""Instructions of acquire.c on a Cortex-M4 (Unicorn), through a search, a capture and tracking of a real signal."""

import importlib.util
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import unicorn
from elftools.elf.elffile import ELFFile
from unicorn import arm_const as arm

from hil_sim.clib import ROOT

_spec = importlib.util.spec_from_file_location("field_signal", Path(__file__).with_name("field_signal.py"))
field_signal = importlib.util.module_from_spec(_spec)
sys.modules["field_signal"] = field_signal
_spec.loader.exec_module(field_signal)

FLAGS = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-std=c11", "-O2", "-ffreestanding")
RAM, STACK, STOP = 0x20000000, 0x20040000, 0x0800FF00
CODES = [2, 3, 4, 5, 6, 7, 8, 9]
HARNESS = """
#include "core/timing/acquire.h"
acquire_t acquire;
chip_clock_t clock;
chip_clock_chip_t planned;
uint16_t burst[8][3];
uint16_t codes[8] = {2, 3, 4, 5, 6, 7, 8, 9};
uint32_t chip;
const uint32_t size = sizeof acquire;
void init(void) {
    chip_clock_init(&clock, &(chip_clock_config_t){1023, 16422, 16000, 16900, true});
    acquire_init(&acquire, &(acquire_config_t){16422, 14672, 216, 267});
    acquire_codes(&acquire, codes, 8);
}
void plan(void) { acquire_plan(&acquire, &clock); }
void feed(void) { acquire_feed(&acquire, chip++, &planned, (const uint16_t (*)[3])burst); }
uint32_t next(void) { planned = chip_clock_plan(&clock); return planned.position; }
int16_t sample[3];
void without_last(void) { acquire_sample((const uint16_t (*)[3])burst, sample); }
uint32_t stage(void) { return acquire.stage; }
uint32_t records(void) { return acquire.captures; }
void step(void) { acquire_step(&acquire); }
"""
SOURCES = ("timing/*", "math/*", "codes/gold")
SLEW_CHIPS = 24
"""A record begins at most so many chips after a correction of the clock."""
STAGES = ("recording", "transforming", "amplitudes", "edge", "measuring")


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    """Call a function of the harness: (instructions, r0)."""
    directory = tmp_path_factory.mktemp("acquire")
    source, elf = directory / "harness.c", directory / "acquire.elf"
    source.write_text(HARNESS)
    core = [path for name in SOURCES for path in sorted((ROOT / "firmware/core").glob(f"{name}.c"))]
    layout = ("-Ttext=0x08000000", f"-Tdata={RAM:#x}", "-nostartfiles", "--specs=nano.specs")
    link = (*layout, "-Wl,-e,0,--no-warn-rwx-segments")
    command = ["arm-none-eabi-gcc", *FLAGS, f"-I{ROOT / 'firmware'}", source, *core, *link, "-o", elf]
    subprocess.run([str(word) for word in command], check=True)
    cpu = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB)
    cpu.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
    cpu.mem_map(0x08000000, 0x10000)
    cpu.mem_map(RAM, 0x40000)
    with elf.open("rb") as file:
        loaded = ELFFile(file)
        for segment in loaded.iter_segments("PT_LOAD"):
            cpu.mem_write(segment["p_vaddr"], segment.data())
        symbols = {s.name: s["st_value"] for s in loaded.get_section_by_name(".symtab").iter_symbols()}
    cpu.reg_write(arm.UC_ARM_REG_C1_C0_2, 0xF << 20)
    cpu.reg_write(arm.UC_ARM_REG_FPEXC, 1 << 30)
    total = [0]

    def block(_uc, address, size, _data):
        code = bytes(cpu.mem_read(address, size))
        while code:  # 32-bit Thumb instructions begin with 0b11101, 0b11110 or 0b11111.
            total[0] += 1
            code = code[4 if code[1] >> 3 >= 0b11101 else 2 :]

    cache = {}

    def counted(_uc, address, size, _data):
        if address not in cache:
            before = total[0]
            block(_uc, address, size, _data)
            cache[address] = total[0] - before
        else:
            total[0] += cache[address]

    cpu.hook_add(unicorn.UC_HOOK_BLOCK, counted)

    def call(name):
        total[0] = 0
        cpu.reg_write(arm.UC_ARM_REG_SP, STACK)
        cpu.reg_write(arm.UC_ARM_REG_LR, STOP | 1)
        cpu.emu_start(symbols[name] | 1, STOP)
        return total[0], cpu.reg_read(arm.UC_ARM_REG_R0)

    call.write = lambda name, data: cpu.mem_write(symbols[name], data)
    call.read = lambda name, size: bytes(cpu.mem_read(symbols[name], size))
    return call


def test_each_step_within_what_the_header_says(machine, gold_family):
    random = np.random.default_rng(3)
    signal = field_signal.random_signal(random, gold_family(10).astype(float), CODES)
    machine("init")
    most = dict.fromkeys(("feed", "plan", "sample", *STAGES), 0)
    work = dict.fromkeys(STAGES, 0)

    def steps():
        """Main's work on a record, until it waits for the next."""
        while True:
            stage = STAGES[machine("stage")[1]]
            count, _ = machine("step")
            most[stage], work[stage] = max(most[stage], count), work[stage] + count
            if STAGES[machine("stage")[1]] == "recording":
                return

    for record in (1023, 341, 341, 341, 1023):  # a sweep, three captures, a tracked cycle
        length = record + SLEW_CHIPS
        most["plan"] = max(most["plan"], machine("plan")[0])
        starts = np.array([machine("next")[1] for _ in range(length)], dtype=float)
        holds = starts[:, None] + field_signal.FIRST_HOLD + field_signal.CONVERSION * np.arange(8)
        label = struct.unpack("<IHHI", machine.read("planned", 12))[1]
        bursts = signal.counts(holds / 168e6)
        for i, burst in enumerate(bursts):
            machine.write("planned", struct.pack("<IHHI", 0, (label - length + 1 + i) % 1023, 16422, int(starts[i])))
            machine.write("burst", burst.tobytes())
            most["feed"] = max(most["feed"], machine("feed")[0])
        most["sample"] = max(most["sample"], machine("without_last")[0])
        steps()
    assert machine("records")[1] == 3
    size = struct.unpack("<I", machine.read("size", 4))[0]
    print({"largest": most, "in all": work, "bytes": size})
    bounds = {"feed": 170, "sample": 100, "plan": 900, "transforming": 800_000, "recording": 500_000}
    bounds |= {"amplitudes": 550_000, "edge": 750_000, "measuring": 700_000}
    assert {name: n for name, n in most.items() if n > bounds[name]} == {}
    assert work["transforming"] + work["amplitudes"] + work["edge"] < 10_000_000
    assert size < 42_000
