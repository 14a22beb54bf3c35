"""How long instructions take: a constant factor, and costs by class as the Cortex-M4 manual (DDI 0439D) has them."""

import argparse
import struct
import subprocess
from pathlib import Path

import pytest

from hil_sim.emulator import Configuration, Emulator
from hil_sim.emulator.bench import library
from hil_sim.options import cycles
from tests.hil_sim.emulator import oracle

COSTS = {  # Table 3-1 and 7-1; the unfavourable end of what depends on data.
    "adds r0, r1, r2": 1,
    "mul r0, r1": 1,
    "smull r0, r1, r2, r3": 1,
    "smlad r0, r1, r2, r3": 1,
    "sdiv r0, r1, r2": 12,
    "udiv r8, r9, r10": 12,
    "ldr r0, [r1, #4]": 2,
    "ldr r0, [r1, r2]": 2,
    "ldr.w r8, [r9, #400]": 2,
    "ldrsh.w r8, [r9, r10, lsl #1]": 2,
    "str r0, [r1, #4]": 1,
    "str r0, [r1, r2]": 2,
    "strb.w r8, [r9, #400]": 1,
    "strh.w r8, [r9, r10, lsl #1]": 2,
    "str r0, [sp, #8]": 1,
    "ldrd r0, r1, [r2, #8]": 3,
    "strd r0, r1, [r2, #-8]!": 3,
    "ldrex r0, [r1]": 2,
    "strex r0, r1, [r2]": 2,
    "tbb [r0, r1]": 2,
    "push {r0-r7, lr}": 10,
    "pop {r4, pc}": 3,
    "ldmia r0!, {r1-r4}": 5,
    "stmdb sp!, {r4-r11}": 9,
    "ldmia.w r0!, {r4-r11, pc}": 10,
    "b .": 1,
    "bl .": 1,
    "bx lr": 1,
    "cbz r0, .+6": 1,
    "cpsid i": 2,
    "mrs r0, basepri": 2,
    "msr basepri, r0": 2,
    "dsb": 4,
    "isb": 4,
    "nop": 1,
    "nop.w": 1,
    "ite eq": 1,
    "ssat r0, #8, r1": 1,
    "clz r0, r1": 1,
    "bfi r0, r1, #3, #5": 1,
    "vadd.f32 s0, s1, s2": 1,
    "vmul.f32 s0, s1, s2": 1,
    "vmla.f32 s0, s1, s2": 3,
    "vfma.f32 s0, s1, s2": 3,
    "vfnms.f32 s0, s1, s2": 3,
    "vnmls.f32 s0, s1, s2": 3,
    "vdiv.f32 s0, s1, s2": 14,
    "vsqrt.f32 s0, s1": 14,
    "vabs.f32 s0, s1": 1,
    "vneg.f32 s0, s1": 1,
    "vcvt.s32.f32 s0, s1": 1,
    "vcmp.f32 s0, s1": 1,
    "vmov r0, s1": 1,
    "vmov r0, r1, s2, s3": 2,
    "vmrs APSR_nzcv, fpscr": 1,
    "vldr s0, [r0, #4]": 2,
    "vstr s0, [r0, #4]": 2,
    "vldr d0, [r0]": 3,
    "vldmia r0!, {s0-s7}": 9,
    "vpush {s16-s31}": 17,
}


def assemble(directory: Path, lines: list[str]) -> list[bytes]:
    """Return the bytes of each instruction."""
    source, code = directory / "source.s", directory / "code.bin"
    body = "".join(f"{line} \n .balign 4\n" for line in lines if line != "ite eq")
    source.write_text(f".syntax unified\n.cpu cortex-m4\n.fpu fpv4-sp-d16\n.thumb\n.text\n{body}")
    subprocess.run(["arm-none-eabi-as", str(source), "-o", str(directory / "code.o")], check=True)
    subprocess.run(
        ["arm-none-eabi-objcopy", "-O", "binary", "-j", ".text", str(directory / "code.o"), str(code)], check=True
    )
    words = [code.read_bytes()[i : i + 4] for i in range(0, len(code.read_bytes()), 4)]
    return [struct.pack("<HH", 0xBF0C, 0) if line == "ite eq" else words.pop(0) for line in lines]


def test_costs_by_class(tmp_path: Path) -> None:
    _, lib = library()
    found = {
        line: int(lib.machine_bench_class_cycles(*struct.unpack("<HH", code)))
        for line, code in zip(COSTS, assemble(tmp_path, list(COSTS)), strict=True)
    }
    assert found == COSTS


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("cycles"), oracle.PROGRAMS / "core.c")


def counted(image: Path, cycles: float | str) -> list[int]:
    """Return the cycle counter's and SysTick's steps over a load and five NOPs, and those of a loop of 1000 turns."""
    configuration = Configuration.with_cycles(cycles, strict=True)
    with Emulator(image, configuration, parameter_page=bytes((3, 0, 0, 0))) as board:
        return oracle.run_on_emulator(board)


@pytest.mark.parametrize(("factor", "six"), [(1.0, 6), (1.5, 9), (2.5, 15), (4.0, 24)])
def test_constant_factor(image: Path, factor: float, six: int) -> None:
    first, second, loop = counted(image, factor)
    assert (first, second) == (six, six)
    assert 3005 * factor - 1 <= loop <= 3008 * factor + 1


def test_by_class(image: Path) -> None:
    """A turn is two instructions and a taken branch of 1 + 3 cycles; HSI needs no wait states."""
    first, second, loop = counted(image, "m4")
    assert (first, second) == (7, 7)
    assert 1000 * 2 + 999 * 4 + 1 < loop < 1000 * 2 + 999 * 4 + 30


@pytest.mark.parametrize("factor", [1.0, 2.5, "m4"])
def test_time_passes_by_the_clock(image: Path, factor: float | str) -> None:
    """90 ticks of a millisecond take 90 ms whatever an instruction costs; what is not slept is its cost."""
    configuration = Configuration.with_cycles(factor)
    with Emulator(image, configuration, parameter_page=bytes((1, 0, 0, 0))) as board:
        board.run(8 * oracle.MILLISECOND)  # Before, RAM holds anything.
        times = []
        for tick in (10, 100):
            while oracle.word(board, "ticks") < tick:
                board.run(board.now_ps + oracle.MILLISECOND // 100)
            times.append(board.now_ps)
        counts = board.statistics()
    assert times[1] - times[0] == pytest.approx(90 * oracle.MILLISECOND, abs=oracle.MILLISECOND // 50)
    cost = (counts.cycles - counts.sleep_cycles) / counts.instructions
    assert 1.2 < cost < 2.5 if isinstance(factor, str) else cost == pytest.approx(factor, rel=1e-4)


@pytest.mark.parametrize("factor", [1.5, 2.5, "m4"])
def test_slices_leave_no_trace(image: Path, factor: float | str) -> None:
    """One run of 8 ms equals many short ones: interrupts come at the same instruction."""
    traces = []
    for step in (8 * oracle.MILLISECOND, 62_500, 1_000_003):
        configuration = Configuration.with_cycles(factor)
        with Emulator(image, configuration, parameter_page=bytes((4, 0, 0, 0))) as board:
            until = 0
            while until < 8 * oracle.MILLISECOND:
                until = min(until + step, 8 * oracle.MILLISECOND)
                assert board.run(until)
            registers = [board.register(i) for i in range(24)]
            traces.append((board.statistics(), registers, board.memory(0x20000000, 0x18000)))
    assert traces[0] == traces[1] == traces[2]


def test_values_of_the_option() -> None:
    assert [cycles("1"), cycles("100"), cycles("2.5"), cycles("m4")] == [1.0, 100.0, 2.5, "m4"]
    for text in ("0.99", "100.1", "nan", "m3", ""):
        with pytest.raises(argparse.ArgumentTypeError, match="give 1 to 100, or m4"):
            cycles(text)
