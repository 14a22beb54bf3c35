"""The flashable images: size, stack, no heap; and their start on QEMU's netduinoplus2.

Its USART, timers and core are somebody else's models.
"""

import importlib.util
import re
import selectors
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from elftools.elf.elffile import ELFFile

from goldfield_protocol import FrameDecoder, decode, protocol_hash

ROOT = Path(__file__).resolve().parents[4]
OUT = ROOT / "build" / "firmware"
BOARD = "firmware/boards/stm32f405"
ROLES = {"beacon": 0, "sensor": 1, "anchor": 3}

specification = importlib.util.spec_from_file_location("image_report", ROOT / "firmware" / "tools" / "image_report.py")
image_report = importlib.util.module_from_spec(specification)
sys.modules["image_report"] = image_report
specification.loader.exec_module(image_report)


@pytest.fixture(params=ROLES)
def role(request):
    return request.param


@pytest.fixture
def elf(role):
    path = OUT / f"{role}.elf"
    assert path.exists(), f"{path} is missing: run make firmware"
    return path


@pytest.fixture
def boot_elf():
    return ROOT / "build" / "boot" / "boot.elf"


@pytest.fixture
def qemu_elf(elf):
    """The image with its vectors and the core-coupled memory where QEMU before 8.0 wants them.

    From 8.0 on it has that memory where the chip has it, and what the image takes for it is missing.
    """
    version = subprocess.run(["qemu-system-arm", "--version"], check=True, capture_output=True, text=True).stdout
    major = int(re.search(r"version (\d+)", version)[1])
    return elf.parent / ("qemu8" if major >= 8 else "qemu") / elf.name


def symbols(path):
    with path.open("rb") as file:
        return {s.name: s["st_value"] for s in ELFFile(file).get_section_by_name(".symtab").iter_symbols() if s.name}


def test_no_heap(elf):
    assert not {"malloc", "_malloc_r", "calloc", "free", "_free_r", "_sbrk", "realloc"} & symbols(elf).keys()


@pytest.mark.parametrize(("folder", "slot"), [("", 0x08020000), ("slot_b", 0x08080000)])
def test_image_fills_its_slot_and_nothing_else(elf, folder, slot):
    """Sectors 5 to 7 or 8 to 10 (RM0090, table 5): neither what a board saves nor its parameter page."""
    with (elf.parent / folder / elf.name).open("rb") as file:
        segments = [s for s in ELFFile(file).iter_segments() if s["p_type"] == "PT_LOAD" and s["p_filesz"]]
        assert min(s["p_paddr"] for s in segments) == slot
        assert max(s["p_paddr"] + s["p_filesz"] for s in segments) <= slot + 0x60000
    names = symbols(elf)
    assert names["stack_bottom"] == 0x20000000
    assert names["bss_end"] <= 0x20020000


def test_vectors(elf):
    names = symbols(elf)
    with elf.open("rb") as file:
        words = struct.unpack("<98I", ELFFile(file).get_section_by_name(".vectors").data())
    assert words[0] == names["stack_top"]
    assert words[1] == names["Reset_Handler"]
    assert words[15] == names["SysTick_Handler"]
    assert words[16 + 57] == names["DMA2_Stream1_Handler"]
    others = {words[i] for i in range(16, 98)} - {v for n, v in names.items() if n.endswith("_Handler")}
    assert not others


def test_binary_files_hold_the_image(elf):
    with elf.open("rb") as file:
        vectors = ELFFile(file).get_section_by_name(".vectors").data()
    binary = elf.with_suffix(".bin").read_bytes()
    assert binary[512:].startswith(vectors)
    assert elf.with_suffix(".hex").read_text().startswith(":020000040802F0")


@pytest.mark.parametrize(("folder", "slot"), [("", 0), ("slot_b", 1)])
def test_the_header_tells_what_the_image_is(elf, role, folder, slot):
    with (elf.parent / folder / elf.name).open("rb") as file:
        file_ = ELFFile(file)
        head = file_.get_section_by_name(".image_head").data()
        loaded = [(s["p_paddr"], s.data()) for s in file_.iter_segments() if s["p_type"] == "PT_LOAD" and s["p_filesz"]]
    words = struct.unpack_from("<7I", head, 448)
    end = max(address + len(data) for address, data in loaded)
    address = (0x08020000, 0x08080000)[slot]
    version = tuple(re.findall(r"_(?:MAJOR|MINOR|PATCH) (\d+)u", (ROOT / "firmware/services/version.h").read_text()))
    assert words[0] == 0x4D494647
    assert end <= address + 512 + words[1] < end + 4
    assert words[2:5] == (address, 1, ROLES[role])
    assert ".".join(version) == f"{words[5] >> 16}.{words[5] >> 8 & 255}.{words[5] & 255}"
    assert words[6] == protocol_hash()
    state = struct.unpack_from("<16I", head, 0)
    mark, erased = 0x5AC3A53C, 0xFFFFFFFF
    assert state[:7] == ((1, erased - 1, erased, mark, mark, mark, mark) if slot == 0 else 7 * (erased,))
    assert set(head[28:128]) | set(head[132:448]) == {0xFF}


def test_the_boot_loader_leaves_room_for_its_key(boot_elf):
    with boot_elf.open("rb") as file:
        segments = [s for s in ELFFile(file).iter_segments() if s["p_type"] == "PT_LOAD" and s["p_filesz"]]
        assert [s["p_paddr"] for s in segments] == [0x08000000]
        assert segments[0]["p_filesz"] <= 0x3FC0
    image = image_report.report(boot_elf)
    assert 1000 < image.stack <= image.stack_reserved
    assert image.ram == image.stack_reserved  # It has no variables, which nothing would initialise.
    names = symbols(boot_elf)
    assert names["stack_bottom"] == 0x20000000
    assert not {"malloc", "free", "_sbrk"} & names.keys()


def test_stack_and_sizes(elf):
    image = image_report.report(elf)
    assert image.stack <= image.stack_reserved
    assert image.flash <= 160 * 1024  # Its slot has 384 KB, three sectors: an update erases two, 2 s.
    assert image.ram <= 123 * 1024  # There are 128 KB.
    assert image.core_memory <= 64 * 1024  # All there is; the sensor's acquire.h and tracking.h lie there.
    assert image.path[:2] == ("Reset_Handler", "main")
    assert image.stack > 200  # An empty call graph would pass all the above.


CI = 'node: {{ title: "{0}" label: "{0}\\nfile.c:1:1\\n{1} bytes ({2})" }}\n'
EDGE = 'edge: {{ sourcename: "{0}" targetname: "{1}" label: "x" }}\n'


def test_stack_of_a_known_graph():
    text = "".join(CI.format(n, b, "static") for n, b in [("a", 8), ("b", 100), ("c", 40), ("d", 64)])
    text += EDGE.format("a", "b") + EDGE.format("a", "c") + EDGE.format("c", "d")
    assert image_report.deepest(image_report.read_call_graph([text]), "a") == (112, ("a", "c", "d"))


def test_stack_refuses_what_it_cannot_bound():
    loop = CI.format("a", 8, "static") + CI.format("b", 8, "static") + EDGE.format("a", "b") + EDGE.format("b", "a")
    with pytest.raises(image_report.ReportError, match="recursion: a -> b -> a"):
        image_report.deepest(image_report.read_call_graph([loop]), "a")
    with pytest.raises(image_report.ReportError, match="depends on the run"):
        image_report.read_call_graph([CI.format("a", 8, "dynamic")])
    pointer = image_report.read_call_graph([CI.format("a", 8, "static") + EDGE.format("a", "__indirect_call")])
    with pytest.raises(image_report.ReportError, match="through a pointer"):
        image_report.resolve(pointer, "sensor")
    with pytest.raises(image_report.ReportError, match="nothing is known of memcpy, called by a"):
        image_report.deepest(
            image_report.read_call_graph([CI.format("a", 8, "static") + EDGE.format("a", "memcpy")]), "a"
        )


def test_stack_of_disassembled_functions():
    text = (
        "08000000 <f>:\n 8000000:\tb5f0      \tpush\t{r4, r5, r6, r7, lr}\n"
        " 8000002:\ted2d 8b04 \tvpush\t{d8-d9}\n 8000006:\tb083      \tsub\tsp, #12\n"
        " 8000008:\tf7ff fffa \tbl\t8000100 <g>\n 800000c:\te7fe      \tb.n\t800000c <f+0xc>\n"
        "08000100 <g>:\n 8000100:\tf84d ed04 \tstr.w\tlr, [sp, #-4]!\n 8000104:\te92d 4ff0 \tstmdb\tsp!, {r4-r11, lr}\n"
    )
    functions = image_report.read_disassembly(text)
    assert (functions["f"].frame, functions["f"].calls) == (20 + 16 + 12, {"g"})
    assert functions["g"].frame == 4 + 36


class Qemu:
    """The image on QEMU: bytes of the third serial port, and exceptions taken as QEMU logs them."""

    def __init__(self, path):
        command = [
            "qemu-system-arm",
            "-M",
            "netduinoplus2",
            "-kernel",
            str(path),
            "-display",
            "none",
            "-monitor",
            "none",
        ]
        self.process = subprocess.Popen(
            [*command, "-serial", "null", "-serial", "null", "-serial", "stdio", "-d", "int"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            bufsize=0,
        )
        self.serial = b""
        self.log = b""

    def exceptions(self):
        """Return the numbers of the exceptions taken (but returns), in order."""
        return [int(n) for n in re.findall(rb"\.\.\.taking pending nonsecure exception (\d+)\n", self.log)]

    def run_until(self, reached):
        """Collect until reached() is true or the process ends; the test's time-out bounds it."""
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            selector.register(self.process.stderr, selectors.EVENT_READ)
            while not reached():
                for key, _ in selector.select():
                    chunk = key.fileobj.read(65536)
                    assert chunk, f"QEMU ended early: {self.log[-500:]!r}"
                    if key.fileobj is self.process.stdout:
                        self.serial += chunk
                    else:
                        self.log += chunk


@pytest.fixture
def qemu():
    started = []

    def start(path):
        started.append(Qemu(path))
        return started[-1]

    yield start
    for machine in started:
        machine.process.kill()
        machine.process.communicate()


def patched(elf, directory, symbol, code):
    """Return a copy of the image with other instructions at the start of a function, and the function's address."""
    address = symbols(elf)[symbol] & ~1
    data = bytearray(elf.read_bytes())
    with elf.open("rb") as file:
        for segment in ELFFile(file).iter_segments():
            if segment["p_vaddr"] <= address < segment["p_vaddr"] + segment["p_filesz"]:
                offset = address - segment["p_vaddr"] + segment["p_offset"]
                data[offset : offset + len(code)] = code
    path = directory / "patched.elf"
    path.write_bytes(data)
    return path, address


def test_first_heartbeat_and_then_no_fault(qemu_elf, role, qemu):
    machine = qemu(qemu_elf)
    machine.run_until(lambda: machine.serial.count(b"\0") >= 2)  # One before the first frame.
    decoder = FrameDecoder()
    frames = list(decoder.feed(machine.serial))
    assert decoder.bad_crc == decoder.malformed == decoder.overlong == 0
    message = decode(frames[0].identifier, frames[0].data)
    assert message.name == "HEARTBEAT"
    assert message.signals["protocol_hash"] == protocol_hash()
    assert message.signals["role"] == ROLES[role]
    # Then it lives on its tick: 200 of them, and no other exception.
    machine.run_until(lambda: len(machine.exceptions()) >= 200)
    assert set(machine.exceptions()) == {15}
    assert b"crash" not in machine.serial


CRASH = re.compile(rb"\0crash pc=(\w{8}) lr=(\w{8}) cfsr=(\w{8}) hfsr=(\w{8}) ipsr=(\w{8})\r\n\0")


def test_crash_report(qemu_elf, qemu, tmp_path):
    undefined = bytes.fromhex("00de")
    path, address = patched(qemu_elf, tmp_path, "hal_wait", undefined)
    machine = qemu(path)
    machine.run_until(lambda: CRASH.search(machine.serial))
    pc, lr, cfsr, hfsr, ipsr = (int(v, 16) for v in CRASH.search(machine.serial).groups())
    main = symbols(qemu_elf)["main"]
    assert pc == address
    assert main <= lr < main + 256
    assert cfsr == 1 << 16  # UNDEFINSTR
    assert hfsr == 0
    assert ipsr == 6  # the usage fault's own exception
    # A receiver of frames loses nothing but the report.
    decoder = FrameDecoder()
    assert len(list(decoder.feed(machine.serial))) >= 1
    assert decoder.overlong == 1


def test_a_stack_that_runs_over_is_a_fault_with_a_report(qemu_elf, qemu, tmp_path):
    push_for_ever = bytes.fromhex("ffb4 fde7")
    path, _ = patched(qemu_elf, tmp_path, "hal_wait", push_for_ever)
    machine = qemu(path)
    machine.run_until(lambda: CRASH.search(machine.serial))
    assert CRASH.search(machine.serial)[1] == b"00000000"


@pytest.mark.parametrize("role", ["beacon"], indirect=True)  # The guards are the board's, whatever the role.
@pytest.mark.parametrize(
    ("how", "cfsr", "ipsr"),
    [
        (3, 0x8200, 5),  # a bus fault: nothing is at that address
        (4, 0x10000, 6),  # no instruction
        (6, 0x82, 4),  # a stack that runs over meets its guard
        (7, 0x82, 4),  # a null pointer
        (8, 0x82, 4),  # a write to flash
        (9, 0x01, 4),  # code in RAM
    ],
)
def test_guards_on_a_processor_of_somebody_elses(how, cfsr, ipsr, qemu_elf, qemu, tmp_path):
    script = qemu_elf.with_suffix(".ld")
    objects = map(str, sorted((OUT / BOARD).glob("*.o")))
    cpu = ["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O1", "-std=c11"]
    options = [f"-DHOW={how}u", "-DRUN_US=1000u", f"-I{ROOT / 'firmware'}", "-nostartfiles", "--specs=nano.specs"]
    source, path = Path(__file__).parent / "reset_probe.c", tmp_path / "probe.elf"
    command = ["arm-none-eabi-gcc", *cpu, *options, "-T", str(script), str(source), *objects, "-o", str(path)]
    subprocess.run([*command, "-Wl,--gc-sections"], check=True)
    machine = qemu(path)
    machine.run_until(lambda: CRASH.search(machine.serial))
    _, _, told_cfsr, hfsr, told_ipsr = (int(v, 16) for v in CRASH.search(machine.serial).groups())
    # The frame of an overflow cannot be pushed either (MSTKERR).
    assert (told_cfsr & ~0x10, hfsr, told_ipsr) == (cfsr, 0, ipsr)
