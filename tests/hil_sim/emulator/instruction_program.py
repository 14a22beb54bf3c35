"""Writes the assembly program that runs each instruction on many operands and notes a hash of what it left behind."""

from __future__ import annotations

import random
import struct
from pathlib import Path

CASES = 1000

# One instruction, or short sequence, a line. Operands are in r0..r3 (r0 is also the destination), s0..s2 hold r0..r2,
# flags come from r4; r5 is free, r11 points to scratch memory. Those in floating.txt run in all four rounding modes;
# VCVT from fixed point (the last of integer.txt) does not: it rounds to nearest whatever FPSCR says (ARMv7-M manual),
# but Unicorn 2.1.4 heeds FPSCR.
PROGRAMS = Path(__file__).parent / "programs"
INTEGER = (PROGRAMS / "integer.txt").read_text().splitlines()
FLOATING = (PROGRAMS / "floating.txt").read_text().splitlines()


def templates() -> list[str]:
    """Return every instruction, or short sequence, under test."""
    return INTEGER + FLOATING


def operands(seed: int, count: int) -> list[int]:
    """Return random words: special values, small numbers, plain random bits and floats of all sizes."""
    source = random.Random(seed)
    special = [0, 1, 2, 31, 32, 33, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF]
    special += [
        0x7F800000,
        0xFF800000,
        0x7FC00001,
        0x7F800001,
        0x00000001,
        0x007FFFFF,
        0x00800000,
        0x3F800000,
        0xBF800000,
    ]
    kinds = [
        lambda: source.choice(special),
        lambda: source.getrandbits(32),
        lambda: source.getrandbits(source.randrange(1, 33)),
        lambda: struct.unpack("<I", struct.pack("<f", source.uniform(-2, 2) * 2.0 ** source.randrange(-40, 40)))[0],
    ]
    return [source.choice(kinds)() for _ in range(count)]


def write(seed: int) -> str:
    """Return the program: main() calls one loop per template; each appends its hash to the notes."""
    lines = [
        ".syntax unified",
        ".thumb",
        ".text",
        ".global main",
        ".type main, %function",
        "main:",
        "push {r4-r11, lr}",
    ]
    lines += ["ldr r0, =0xE000ED88", "movw r1, #0", "movt r1, #0xF0", "str r1, [r0]", "dsb", "isb"]
    lines += [f"bl case_{i}" for i in range(len(templates()))] + ["pop {r4-r11, pc}", ".ltorg"]
    for index, template in enumerate(templates()):
        rounding = "and r5, r4, #0x03C00000; vmsr fpscr, r5" if template in FLOATING else "mov r5, #0; vmsr fpscr, r5"
        body = "; ".join(part.strip() for part in template.split(";"))
        lines += [
            f".thumb_func\ncase_{index}:",
            "push {lr}",
            "ldr r8, =operand_table",
            f"movw r9, #{CASES}",
            "mov r10, #0",
            "ldr r11, =scratch",
            "1001:",
            "ldmia r8, {r0-r4}",
            "add r8, #4",
            rounding,
            "vmov s0, r0; vmov s1, r1; vmov s2, r2",
            "bfc r4, #20, #7",
            "msr APSR_nzcvqg, r4",
            body,
            "mrs r4, APSR",
            "movw r5, #0x0193; movt r5, #0x0100",
        ]
        for register in ("r0", "r1", "r4", "s0", "s1", "fpscr"):
            if register[0] == "s":
                lines.append(f"vmov r4, {register}")
            elif register == "fpscr":
                lines.append("vmrs r4, fpscr")
            lines.append(f"eor r10, {register if register[0] == 'r' else 'r4'}; mul r10, r10, r5")
        lines += [
            "ror r10, #5",
            "subs r9, #1",
            "bne.w 1001b",
            "ldr r0, [r11]",
            "eor r0, r10",
            "bl note",
            "pop {pc}",
            ".ltorg",
        ]
    lines += [".balign 4", "operand_table:"] + [f".word {value}" for value in operands(seed, CASES + 8)]
    lines += [".bss", ".balign 8", ".space 64", "scratch: .space 64"]
    return "\n".join(lines) + "\n"
