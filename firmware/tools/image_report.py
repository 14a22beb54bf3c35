"""Flash, RAM, core-coupled memory and worst-case stack of the ARM images.

``python firmware/tools/image_report.py build/firmware/sensor.elf ...`` prints one line an image.

Stack: each function's frame and the calls it makes come from GCC (``-fstack-usage -fcallgraph-info=su``, the ``.ci``
files beside the objects); of library functions, which came compiled, from their disassembly. Calls through the pointers
of ``hal_events_t`` are resolved by `HANDLERS`. The worst case is main's deepest path plus, for each interrupt priority,
the deepest handler of that priority and the frame that the processor stacks: handlers of one priority do not interrupt
each other. A fault handler starts its own stack. Recursion, a frame of unbounded size, or a pointer call that
`HANDLERS` does not know is an error.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

TOOLS = "arm-none-eabi-"
ENGINE = "firmware/boards/stm32f405/chip_engine.c"
FLASH_BYTES = 384 * 1024
"""One of the two slots; the boot loader's own sector has 16 kB."""
BOOT = "boot"
"""The image without interrupts."""
RAM_BYTES = 128 * 1024
CORE_MEMORY_BYTES = 64 * 1024

HANDLERS: Mapping[str, tuple[str, ...]] = {
    f"{ENGINE}:plan_block": ("on_plan",),
    "DMA2_Stream1_Handler": ("on_samples",),
    "PendSV_Handler": ("on_sync",),
    "ADC_Handler": ("on_current", "on_edge"),
    "TIM1_BRK_TIM9_Handler": ("on_fault",),
    "PVD_Handler": ("on_fault",),
}
"""Which handlers in the application's file a function of the board calls through `hal_events_t`."""

ABSENT: Mapping[str, tuple[str, ...]] = {
    "beacon": ("on_samples",),
    "sensor": ("on_current", "on_edge", "on_fault"),
    "anchor": ("on_edge",),
}
"""Handlers that an application does not have; the board then never calls them (`hal_chips_start`)."""

PRIORITIES: tuple[tuple[str, ...], ...] = (
    ("NMI_Handler",),
    ("TIM7_Handler",),
    ("CAN1_TX_Handler", "CAN1_RX1_Handler", "TIM8_CC_Handler"),
    ("ADC_Handler", "TIM1_BRK_TIM9_Handler", "TIM8_BRK_TIM12_Handler", "PVD_Handler"),
    (
        "CAN1_RX0_Handler",
        "CAN1_SCE_Handler",
        "DMA1_Stream1_Handler",
        "DMA1_Stream3_Handler",
        "DMA2_Stream1_Handler",
        "PendSV_Handler",
    ),
    ("SysTick_Handler",),
)
"""Handlers by priority, as `interrupt_enable` and `board_start` set them."""

EXCEPTION_FRAME = 108
"""Bytes the processor stacks: 26 words with floating point (ARMv7-M ARM, B1.5.6), and 4 to align to 8."""


class ReportError(Exception):
    """Something that makes the worst case unknown."""


@dataclass
class Function:
    """Frame size in bytes (None: not known) and the functions called."""

    frame: int | None = None
    calls: set[str] = field(default_factory=set)


@dataclass(frozen=True)
class Image:
    """What an image uses, in bytes; `core_memory` is not in `ram`; `path` is the deepest path of calls in main."""

    flash: int
    ram: int
    core_memory: int
    stack: int
    stack_reserved: int
    path: tuple[str, ...]


def read_call_graph(texts: Iterable[str]) -> dict[str, Function]:
    """Merge the contents of ``.ci`` files.

    Raises
    ------
    ReportError
        A frame whose size depends on the run.
    """
    graph: dict[str, Function] = {}
    for text in texts:
        for title, label in re.findall(r'^node: \{ title: "([^"]+)" label: "([^"]*)"', text, re.M):
            function = graph.setdefault(title, Function())
            frame = re.search(r"(\d+) bytes \((\w[\w,]*)\)", label)
            if frame is not None:
                if frame[2] == "dynamic":
                    raise ReportError(f"{title} takes stack of a size that depends on the run")
                function.frame = int(frame[1])
        for source, target in re.findall(r'^edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text, re.M):
            graph.setdefault(source, Function()).calls.add(target)
    return graph


def read_disassembly(text: str) -> dict[str, Function]:
    """Frames and calls of compiled functions, from ``objdump -d``: every push summed, so never too little."""
    functions: dict[str, Function] = {}
    current = Function(0)
    for line in text.splitlines():
        start = re.match(r"[0-9a-f]+ <(.+)>:$", line)
        if start:
            current = functions.setdefault(start[1], Function(0))
            continue
        instruction = line.split("\t")[2:]
        if not instruction or current.frame is None:
            continue
        name, operands = instruction[0].strip(), (instruction[1:] or [""])[0]
        if name.startswith(("push", "vpush")) or (name.startswith("stmdb") and operands.startswith("sp!")):
            registers = operands[operands.index("{") + 1 : operands.index("}")].split(",")
            count = 0
            for item in registers:
                ends = re.findall(r"[rs](\d+)|d(\d+)", item)
                span = int(ends[1][0] or ends[1][1]) - int(ends[0][0] or ends[0][1]) + 1 if "-" in item else 1
                count += span * (2 if "d" in item else 1)
            current.frame += 4 * count
        elif name.startswith("sub") and re.match(r"sp, (sp, )?#", operands):
            current.frame += int(operands.split("#")[1].split()[0], 0)
        elif name.startswith("str") and (moved := re.search(r"\[sp, #-(\d+)\]!", operands)):
            current.frame += int(moved[1])
        elif name.startswith("b") and (target := re.search(r"<([^+>]+)>$", operands)):
            current.calls.add(target[1])
    for name, function in functions.items():
        function.calls.discard(name)  # A branch inside: a loop, not a call.
    return functions


def deepest(graph: Mapping[str, Function], root: str) -> tuple[int, tuple[str, ...]]:
    """Worst stack of a root in bytes, and the path that takes it.

    Raises
    ------
    ReportError
        Recursion, an unknown function, or a pointer call.
    """
    known: dict[str, tuple[int, tuple[str, ...]]] = {}

    def visit(name: str, above: tuple[str, ...]) -> tuple[int, tuple[str, ...]]:
        if name in above:
            raise ReportError("recursion: " + " -> ".join((*above, name)))
        if name not in known:
            function = graph.get(name)
            if function is None or function.frame is None:
                raise ReportError(f"nothing is known of {name}, called by {above[-1] if above else 'nobody'}")
            below = [visit(call, (*above, name)) for call in sorted(function.calls)]
            most, path = max(below, key=lambda b: b[0], default=(0, ()))
            known[name] = function.frame + most, (name, *path)
        return known[name]

    return visit(root, ())


def resolve(graph: dict[str, Function], role: str) -> None:
    """Replace pointer calls by the application's handlers.

    Raises
    ------
    ReportError
        A pointer call, or a handler, that `HANDLERS` does not tell.
    """
    for name, function in graph.items():
        if "__indirect_call" not in function.calls:
            continue
        function.calls.discard("__indirect_call")
        if name not in HANDLERS:
            raise ReportError(f"{name} calls through a pointer that HANDLERS in {Path(__file__).name} does not know")
        for handler in HANDLERS[name]:
            path = f"firmware/apps/{role}.c:{handler}"
            if path in graph:
                function.calls.add(path)
            elif handler not in ABSENT[role]:
                raise ReportError(f"{name} calls {path}, which does not exist")


def run(tool: str, *arguments: str) -> str:
    """Return what a tool of the cross compiler prints."""
    return subprocess.run([TOOLS + tool, *arguments], check=True, capture_output=True, text=True).stdout


def report(elf: Path) -> Image:
    """Measure an image; its ``.ci`` files are looked for below its directory."""
    role = elf.stem
    texts = [
        path.read_text()
        for path in sorted(elf.parent.rglob("*.ci"))
        if path.parent.name != "images" or path.stem == role
    ]
    graph = read_call_graph(texts)
    resolve(graph, role)
    for name, function in read_disassembly(run("objdump", "-d", str(elf))).items():
        if name not in graph or graph[name].frame is None:
            graph[name] = function
    stack, path = deepest(graph, "Reset_Handler")
    for names in PRIORITIES if role != BOOT else ():
        stack += EXCEPTION_FRAME + max(deepest(graph, name)[0] for name in names)

    text, data, bss = map(int, run("size", str(elf)).splitlines()[1].split()[:3])
    symbols = {
        line.split()[2]: int(line.split()[0], 16) for line in run("nm", str(elf)).splitlines() if len(line.split()) == 3
    }
    reserved = symbols["stack_top"] - symbols["stack_bottom"]
    parts = ("core_memory", "retained") if role != BOOT else ()
    core_memory = sum(symbols[f"{part}_end"] - symbols[f"{part}_start"] for part in parts)
    return Image(
        flash=text + data,
        ram=data + bss - core_memory,
        core_memory=core_memory,
        stack=stack,
        stack_reserved=reserved,
        path=path,
    )


def main(arguments: list[str]) -> int:
    """Print the table; 1 if an image's worst case is unknown or more than reserved."""
    print(
        f"image      flash of {FLASH_BYTES}     RAM of {RAM_BYTES}  core memory of {CORE_MEMORY_BYTES}"
        "  stack (inside RAM)  deepest path of main"
    )
    worst = 0
    for argument in arguments:
        try:
            image = report(Path(argument))
        except ReportError as error:
            print(f"error: {argument}: {error}", file=sys.stderr)
            worst = 1
            continue
        path = " > ".join(name.rpartition(":")[2] for name in image.path)
        stack = f"{image.stack} of {image.stack_reserved}"
        print(f"{Path(argument).stem:8} {image.flash:>15} {image.ram:>17} {image.core_memory:>21} {stack:>19}  {path}")
        if image.stack > image.stack_reserved:
            print(f"error: {argument} may need more stack than it reserves", file=sys.stderr)
            worst = 1
    return worst


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
