"""Every base address, register offset and bit of registers.h against ST's SVD.

The F405's peripherals are a subset of the F429's. The compiler is asked where it puts each member and what each
constant is, so that what is checked is what the driver uses.
"""

import functools
import importlib.resources
import re
import subprocess
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

HEADER = Path(__file__).resolve().parents[4] / "firmware" / "boards" / "stm32f405" / "registers.h"

# ARMv7-M Architecture Reference Manual, tables B3-4, B3-7, B3-8 and B3-11: the SVD has of the core the NVIC only.
CORE = {
    "SYSTICK": (0xE000E010, {"CTRL": 0x0, "LOAD": 0x4, "VAL": 0x8, "CALIB": 0xC}),
    "SCB": (
        0xE000ED00,
        {
            **{"CPUID": 0x00, "ICSR": 0x04, "VTOR": 0x08, "AIRCR": 0x0C, "SCR": 0x10, "CCR": 0x14, "SHPR1": 0x18},
            **{"SHPR2": 0x1C, "SHPR3": 0x20, "SHCSR": 0x24, "CFSR": 0x28, "HFSR": 0x2C, "DFSR": 0x30, "MMFAR": 0x34},
            **{"BFAR": 0x38, "AFSR": 0x3C, "CPACR": 0x88},
        },
    ),
    "MPU": (0xE000ED90, {"TYPE": 0x0, "CTRL": 0x4, "RNR": 0x8, "RBAR": 0xC, "RASR": 0x10}),
}
CORE_BITS = {
    "SYSTICK_CTRL_ENABLE": 1 << 0,
    "SYSTICK_CTRL_TICKINT": 1 << 1,
    "SYSTICK_CTRL_CLKSOURCE": 1 << 2,
    "SCB_CPACR_FPU_FULL": 0xF << 20,
    "SCB_SHCSR_MEMFAULTENA": 1 << 16,  # B3.2.13
    "SCB_SHCSR_BUSFAULTENA": 1 << 17,
    "SCB_SHCSR_USGFAULTENA": 1 << 18,
    "MPU_CTRL_ENABLE": 1 << 0,  # B3.5.5
    "MPU_CTRL_PRIVDEFENA": 1 << 2,
    "MPU_RASR_ENABLE": 1 << 0,  # B3.5.9
    "MPU_RASR_XN": 1 << 28,
    "SCB_CFSR_MSTKERR": 1 << 4,  # ARMv7-M ARM, table B3-19: MMFSR is the lowest byte of CFSR
    "SCB_CFSR_MMARVALID": 1 << 7,
    "SCB_CFSR_STKERR": 1 << 8 + 4,  # BFSR is the second byte
    "SCB_CFSR_BFARVALID": 1 << 8 + 7,
    "SCB_ICSR_PENDSVSET": 1 << 28,
    "SCB_AIRCR_SYSRESETREQ": 0x05FA << 16 | 1 << 2,  # with the key without which AIRCR is not written
}
# How registers.h names what the SVD numbers or names otherwise.
PREFIXES = {"DMA": "DMA2", "TIM": "TIM1", "ADC": "ADC1", "USART": "USART3", "CAN": "CAN1"}
# Constants that are all flags of a stream: the stream.
ALL_FLAGS = {f"DMA_{'LIFCR' if n < 4 else 'HIFCR'}_STREAM{n}": n for n in (0, 1, 2, 3, 4, 5, 7)}


@functools.cache
def svd():
    """Return {peripheral: (base, {register: (offset, {field: (bit, width)})})}."""
    archive = importlib.resources.files("pyocd") / "debug" / "svd" / "svd_data.zip"
    with zipfile.ZipFile(str(archive)) as opened:
        root = ElementTree.fromstring(opened.read("STM32F429x.svd"))
    nodes = {p.findtext("name"): p for p in root.iter("peripheral")}
    result = {}
    for name, node in nodes.items():
        source = nodes[node.get("derivedFrom")] if node.get("derivedFrom") else node
        registers = {
            r.findtext("name"): (
                int(r.findtext("addressOffset"), 0),
                {
                    f.findtext("name"): (int(f.findtext("bitOffset")), int(f.findtext("bitWidth")))
                    for f in r.iter("field")
                },
            )
            for r in source.iter("register")
        }
        result[name] = int(node.findtext("baseAddress"), 0), registers
    return result


@functools.cache
def interrupts():
    archive = importlib.resources.files("pyocd") / "debug" / "svd" / "svd_data.zip"
    with zipfile.ZipFile(str(archive)) as opened:
        root = ElementTree.fromstring(opened.read("STM32F429x.svd"))
    return {i.findtext("name"): int(i.findtext("value")) for i in root.iter("interrupt")}


def evaluate(expressions, directory):
    source = directory / "registers.c"
    lines = "".join(f'  printf("%llu\\n", (unsigned long long)({e}));\n' for e in expressions)
    source.write_text(
        f'#include <stddef.h>\n#include <stdio.h>\n#include "{HEADER}"\nint main(void) {{\n{lines}  return 0;\n}}\n'
    )
    subprocess.run(["gcc", "-std=c11", "-w", str(source), "-o", str(directory / "registers")], check=True)
    output = subprocess.run([directory / "registers"], check=True, capture_output=True, text=True).stdout
    return dict(zip(expressions, map(int, output.split()), strict=True))


def members(body):
    for declaration in re.findall(r"volatile uint(?:8|32)_t ([^;]+);", body):
        for name in declaration.split(","):
            name = name.strip()
            if not name.startswith("reserved"):
                yield re.sub(r"\[.*", "", name)


@pytest.fixture(scope="module")
def header(tmp_path_factory):
    """Return (pointers {name: (struct, base)}, offsets {struct: {member: offset}}, constants {name: value})."""
    text = HEADER.read_text().replace("\\\n", "")
    structs = {name: list(members(body)) for body, name in re.findall(r"typedef struct \{(.*?)\} (\w+);", text, re.S)}
    pointers = dict(re.findall(r"#define (\w+) +\(\((\w+) \*\)", text))
    constants = [
        name
        for name, value in re.findall(r"^#define (\w+) +(.+)$", text, re.M)
        if name not in pointers and "*)" not in value
    ]
    extra = [f"offsetof(DMA_registers, S[{i}])" for i in range(8)] + [
        f"offsetof(CAN_registers, T[{i}])" for i in range(3)
    ]
    enums = re.findall(r"^ +(IRQ_\w+) = \d+", text, re.M)
    expressions = [
        *(f"offsetof({struct}, {member})" for struct, names in structs.items() for member in names),
        *(f"(size_t){name}" for name in pointers),
        *constants,
        *extra,
        *enums,
    ]
    values = evaluate(expressions, tmp_path_factory.mktemp("registers"))
    return {
        "bases": {name: (struct, values[f"(size_t){name}"]) for name, struct in pointers.items()},
        "offsets": {s: {m: values[f"offsetof({s}, {m})"] for m in names} for s, names in structs.items()},
        "constants": {name: values[name] for name in constants if name != "STM32F405_REGISTERS_H"},
        "dma_streams": [values[e] for e in extra[:8]],
        "can_mailboxes": [values[e] for e in extra[8:]],
        "interrupts": {name: values[name] for name in enums},
    }


def test_header_was_understood(header):
    assert {"RCC", "GPIOC", "DMA2", "TIM1", "ADC3", "C_ADC", "USART3", "CAN1", "IWDG", "SCB"} <= header["bases"].keys()
    assert len(header["constants"]) > 100
    assert sum(map(len, header["offsets"].values())) > 150


def test_bases(header):
    for name, (_, base) in header["bases"].items():
        if name == "NVIC":
            assert base == svd()["NVIC"][0] + svd()["NVIC"][1]["ISER0"][0]
        else:
            assert base == (CORE[name][0] if name in CORE else svd()[name][0]), name


def test_offsets(header):
    for name, (struct, _) in header["bases"].items():
        expected = CORE[name][1] if name in CORE else {r: offset for r, (offset, _) in svd()[name][1].items()}
        for member, offset in header["offsets"][struct].items():
            if name == "NVIC":
                assert offset + 0x100 == expected[member + "0"], member
            elif struct != "TIM_registers" or name in ("TIM1", "TIM8") or member in expected:
                assert offset == expected[member], (name, member)


def test_dma_streams_and_can_mailboxes(header):
    dma, can = svd()["DMA2"][1], svd()["CAN1"][1]
    for i, start in enumerate(header["dma_streams"]):
        for member, offset in header["offsets"]["DMA_stream_registers"].items():
            assert start + offset == dma[f"S{i}{member}"][0]
    for i, start in enumerate(header["can_mailboxes"]):
        for member, offset in header["offsets"]["CAN_mailbox_registers"].items():
            assert start + offset == can[f"{member[:-1]}{i}R"][0]


def test_bits(header):
    checked = 0
    for name, value in header["constants"].items():
        if name in CORE_BITS:
            assert value == CORE_BITS[name]
            continue
        if name in ALL_FLAGS:
            stream = ALL_FLAGS[name]
            register = svd()["DMA2"][1]["LISR" if stream < 4 else "HISR"][1]
            assert value == sum(1 << bit for field, (bit, _) in register.items() if field.endswith(f"IF{stream}")), name
            continue
        peripheral, register, field = re.fullmatch(r"(C_ADC|[A-Z]+\d?)_(DBGMCU_APB1_FZ|[A-Z0-9]+)_(\w+)", name).groups()
        registers = svd()[PREFIXES.get(peripheral, peripheral)][1]
        layouts = [
            fields for r, (_, fields) in registers.items() if r in (register, register + "_Output", register + "_Input")
        ]
        places = [
            place
            for fields in layouts
            for candidate, place in fields.items()
            if field == candidate or field.startswith(candidate + "_")
        ]
        if places:
            bit, width = max(places)
            assert value & ~(((1 << width) - 1) << bit) == 0, name
            assert value != 0, name
            checked += 1
        else:
            pytest.fail(f"{name}: the SVD has no such field in {peripheral}.{register}")
    assert checked > 90


def test_interrupt_positions(header):
    for name, position in header["interrupts"].items():
        if name != "IRQ_COUNT":
            plain = name.removeprefix("IRQ_").replace("STREAM", "Stream")
            assert position == interrupts()[plain], name
