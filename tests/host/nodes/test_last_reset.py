"""What a board tells of its last reset: words, the place of a crash in the source, and reports that come in part."""

import subprocess

import can
import pytest

from goldfield.errors import UserError
from goldfield.nodes.elf_lines import ElfLines
from goldfield.nodes.last_reset import PARTS, REGISTERS, Crash, LastReset, words_of
from goldfield.nodes.roster import Roster
from goldfield_protocol import encode
from tests.host.fake_sensor import heartbeat

NOTHING = {"cause": 0, "crashed": 0, "stack_overflow": 0, "exception": 0, "stalled": 0, "uptime": 0}
COUNTS = {
    f"resets_{cause}": 0 for cause in ("power_on", "brown_out", "pin", "software", "watchdog", "window", "low_power")
}


def item(number, **signals):
    return encode("RESET_REPORT", {"item": number, **signals}, node=100, index=number)


def report(counts=(), registers=None, **cause):
    """Return the messages of a report."""
    messages = [item(0, **NOTHING | cause), item(1, **COUNTS | {f"resets_{name}": n for name, n in counts})]
    if registers is not None:
        messages += [item(2 + i, **{name: registers.get(name, 0)}) for i, name in enumerate(REGISTERS)]
    return messages


def node_of(*messages):
    roster = Roster()
    for identifier, data in messages:
        roster.take(can.Message(arbitration_id=identifier, data=data), 0.0)
    return roster.nodes[100]


def test_a_crash_is_what_the_messages_say():
    registers = {name: 0x08000000 + i for i, name in enumerate(REGISTERS)}
    told = node_of(
        *report((("power_on", 1), ("watchdog", 255)), registers, cause=4, crashed=1, exception=5, uptime=11520)
    ).last_reset
    assert (told.cause, told.uptime_s, told.counts) == ("watchdog", 11520, {"power_on": 1, "watchdog": 255})
    assert (told.crash.exception, told.crash.registers, told.crash.stack_overflow) == (5, registers, False)
    assert told.whole


def test_a_report_in_part_is_not_whole_and_a_restart_forgets_it():
    messages = report((("power_on", 1),), {}, cause=4, crashed=1, exception=3)
    assert node_of(heartbeat()).last_reset is None
    assert node_of(*messages[1:]).last_reset is None
    assert not node_of(messages[0]).last_reset.whole
    assert not node_of(*messages[:-1]).last_reset.whole
    assert node_of(*messages).last_reset.whole
    assert node_of(*messages, heartbeat(state=0)).last_reset is None
    assert node_of(*messages, *report((("power_on", 1),))).last_reset.crash is None


@pytest.mark.parametrize("bit", range(len(PARTS)))
def test_what_stood_still_is_named(bit):
    told = node_of(*report(cause=4, stalled=1 << bit)).last_reset
    assert told.stalled == (PARTS[bit],)
    assert words_of(told) == [f"reset by its watchdog; before that no longer alive: {PARTS[bit]}"]


@pytest.mark.parametrize(
    ("cfsr", "exception", "words"),
    [
        (0x00000082, 4, "a memory protection fault at 0x08001000, on address 0x00000004"),
        (0x00000001, 4, "a memory protection fault at 0x08001000"),
        (0x00008200, 5, "a bus fault at 0x08001000, on address 0x00000004"),
        (0x00000400, 3, "a bus fault at 0x08001000"),
        (0x00010000, 6, "an undefined instruction at 0x08001000"),
        (0x01000000, 6, "an unaligned access at 0x08001000"),
        (0x02000000, 6, "a division by zero at 0x08001000"),
        (0, 3, "a hard fault at 0x08001000"),
        (0, 2, "a non-maskable interrupt at 0x08001000"),
        (0, 16 + 37, "interrupt 37, which has no handler at 0x08001000"),
    ],
)
def test_a_fault_is_named_by_its_status(cfsr, exception, words):
    crash = Crash(exception, False, {"pc": 0x08001000, "cfsr": cfsr, "address": 4})
    assert words_of(LastReset("watchdog", 60, (), {}, crash)) == [
        f"reset by its watchdog after 1 min; before that {words}"
    ]


def test_quiet_starts_and_counts():
    assert words_of(LastReset("power_on", 0, (), {"power_on": 1}, None)) == []
    assert words_of(LastReset("software", 5, (), {"power_on": 1, "software": 1}, None)) == [
        "reset on command after 5 s"
    ]
    assert words_of(LastReset("watchdog", 1, (), {"power_on": 1, "watchdog": 2, "pin": 1}, None)) == [
        "reset by its watchdog after 1 s; before that its main loop hung",
        "3 resets since power-on: 2 by the watchdog, 1 by the pin",
    ]


SOURCE = """int before(int a) {
    return a + 1;
}

int culprit(volatile int *where) {
    return *where;
}
"""


@pytest.fixture(scope="module")
def elf(tmp_path_factory):
    directory = tmp_path_factory.mktemp("elf")
    source = directory / "drive.c"
    source.write_text(SOURCE)
    path = directory / "beacon.elf"
    command = ["arm-none-eabi-gcc", "-mcpu=cortex-m4", "-mthumb", "-g", "-O1", "-nostdlib", "-Wl,-e,culprit"]
    subprocess.run([*command, "-Wl,-Ttext=0x08001000", str(source), "-o", str(path)], check=True)
    nm = subprocess.run(["arm-none-eabi-nm", str(path)], check=True, capture_output=True, text=True).stdout
    symbols = {line.split()[2]: int(line.split()[0], 16) & ~1 for line in nm.splitlines()}
    return path, symbols


def test_the_line_of_a_crash_is_that_of_the_debugging_information(elf):
    path, symbols = elf
    lines = ElfLines(str(path))
    for name, within in (("before", (0, 2)), ("culprit", (0, 2))):
        for address in (symbols[name] + offset for offset in within):
            command = ["arm-none-eabi-addr2line", "-e", str(path), hex(address)]
            told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            number = told.split()[0].rpartition(":")[2]
            assert number in "123" if name == "before" else number in "567"
            assert lines.place(address) == f"beacon.elf: drive.c:{number}, {name}"
    assert lines.place(0x08000FFF) is None
    assert lines.place(0x0800F000) is None
    crash = Crash(5, False, {"pc": symbols["culprit"], "cfsr": 0x8200, "address": 0x30000000})
    (words,) = words_of(LastReset("watchdog", 0, (), {}, crash), lines)
    assert f"a bus fault at {symbols['culprit']:#010x} (beacon.elf: drive.c:" in words
    overflow = Crash(4, True, {"pc": 0, "cfsr": 0x92, "stack_0": 5, "stack_3": symbols["before"] | 1})
    (words,) = words_of(LastReset("watchdog", 0, (), {}, overflow), lines)
    assert words.startswith("reset by its watchdog; before that a stack overflow below beacon.elf: drive.c:")
    assert words.endswith(", before")


def test_a_file_that_tells_no_lines_is_refused(tmp_path, elf):
    with pytest.raises(UserError, match="give the ELF file that was flashed"):
        ElfLines(str(tmp_path / "nowhere.elf"))
    (tmp_path / "text.elf").write_text("no ELF")
    with pytest.raises(UserError, match="is no ELF file"):
        ElfLines(str(tmp_path / "text.elf"))
    stripped = tmp_path / "beacon.elf"
    subprocess.run(["arm-none-eabi-strip", str(elf[0]), "-o", str(stripped)], check=True)
    with pytest.raises(UserError, match="no debugging information"):
        ElfLines(str(stripped))
