"""``make flash`` takes every parameter of a board, and nothing that the board would refuse; a probe comes first."""

import json
import os
import re
import subprocess
import sys

import pytest

from goldfield_protocol.image import KEY_PLACE, key_place
from goldfield_protocol.parameters import PARAMETERS, parse_page
from hil_sim.clib import ROOT


def value_of(parameter):
    """The parameter's maximum, as it is written on make's command line."""
    elements = parameter.count if parameter.exact else parameter.group
    return ",".join([str(parameter.high)] * elements)


def probes(*unique_ids, **more):
    """What ``pyocd json --probes`` prints."""
    boards = [{"unique_id": unique_id, "info": f"STM32 STLink {unique_id}"} for unique_id in unique_ids]
    return json.dumps({"pyocd_version": "0.46.0", "status": 0, "boards": boards} | more)


ONE_PROBE = probes("066DFF01")


IDCODE, FLASH_SIZE, CPUID, OPTKEYR, OPTCR = 0xE0042000, 0x1FFF7A20, 0xE000ED00, 0x40023C08, 0x40023C14
CHIP = {IDCODE: 0x10076413, FLASH_SIZE: 0x04000000, CPUID: 0x410FC241, 0x40023C0C: 0, OPTCR: 0x0FFFAAED}

PYOCD = """#!{python}
import json, re, sys
from pathlib import Path
here = Path("{here}")
words = sys.argv[1:]
if words[0] == "json":
    print((here / "probes.json").read_text())
elif words[0] == "pack":
    print("STM32F4xx_DFP")
else:
    with (here / "told").open("a") as told:
        print(*words, file=told)
if words[0] == "commander":
    state = json.loads((here / "chip.json").read_text())
    if state["dead"]:
        sys.exit("No ACK received")
    chip = {{int(a): v for a, v in state["words"].items()}}
    for command in (words[i + 1].split() for i, word in enumerate(words) if word == "-c"):
        if command[0] == "read32":
            address = int(command[1], 0)
            print(f"{{address:08x}}:  {{chip[address]:08x}}    |....|")
        elif command[0] == "write32":
            address, value = int(command[1], 0), int(command[2], 0)
            state["written"].append([address, value])
            if address == {optcr} and state["keeps_options"]:
                chip[address] = value & ~2
        elif command[0] == "savemem":
            address, count = int(command[1], 0), int(command[2])
            from elftools.elf.elffile import ELFFile
            loaded = [w for w in (here / "told").read_text().splitlines() if w.startswith("load")][-1].split()
            data = b""
            for name in loaded:
                if name.endswith(".elf"):
                    with open(name, "rb") as file:
                        for s in ELFFile(file).iter_segments():
                            if s["p_paddr"] == address and s["p_filesz"]:
                                data = s.data()
                elif "@" in name and int(name.partition("@")[2], 0) == address:
                    data = Path(name.partition("@")[0]).read_bytes()
                    (here / f"at_{{address:08x}}").write_bytes(data)
            data = bytearray(data[:count])
            if state["wrong_byte"] is not None and address == 0x08020200:
                data[state["wrong_byte"]] ^= 1
            Path(command[3]).write_bytes(data)
    state["words"] = chip
    (here / "chip.json").write_text(json.dumps(state))
"""


@pytest.fixture
def flash(tmp_path):
    """Run ``make flash`` with a program in place of pyOCD that writes down its arguments, and the images as built."""
    probe, told, page, listed = (tmp_path / name for name in ("pyocd", "told", "page.bin", "probes.json"))
    probe.write_text(PYOCD.format(python=sys.executable, here=tmp_path, optcr=OPTCR))
    probe.chmod(0o755)

    def run(*assignments, probes=ONE_PROBE, chip=(), **state):
        listed.write_text(probes)
        usual = {"words": CHIP | dict(chip), "dead": False, "keeps_options": True, "wrong_byte": None, "written": []}
        (tmp_path / "chip.json").write_text(json.dumps(usual | state))
        own = [f"PYOCD={probe}", f"STM32_PAGE={page}", "-o", "firmware"]
        bare = {name: value for name, value in os.environ.items() if name != "MAKEFLAGS"}  # of the make that tests us
        command = ["make", "-s", "flash", *own, *assignments]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, env=bare)
        lines = told.read_text().splitlines() if told.exists() else []
        loaded = [line for line in lines if line.startswith("load")]
        done.loaded = {path.name: path.read_bytes() for path in tmp_path.glob("at_*")}
        done.written = json.loads((tmp_path / "chip.json").read_text())["written"]
        return done, loaded[-1] if loaded else "", page

    return run


def words(loaded):
    """What pyOCD is told to load; the directory of the boot loader and the empty slot is left out."""
    return re.sub(r"\S*/(boot_and_key|empty_slot)", r"\1", loaded)


def load(role):
    """What pyOCD is told to load for an image alone."""
    return f"build/firmware/{role}.elf boot_and_key.bin@0x08000000 empty_slot.bin@0x08080000"


def test_every_parameter_can_be_flashed(flash):
    assignments = [f"{name.upper()}={value_of(p)}" for name, p in PARAMETERS.items()]
    done, loaded, page = flash("ROLE=anchor", *assignments)
    assert done.returncode == 0, done.stderr
    saved = page.with_name("saved.bin")  # in place of what the board has saved, which would overrule the page
    files = f"{page}@0x080E0000 {saved}@0x08004000"
    assert words(loaded) == f"load --target stm32f405rgtx {load('anchor')} {files}"
    assert saved.read_bytes() == b"\xff" * 32768
    stored = parse_page(page.read_bytes())
    assert set(stored) == set(PARAMETERS)
    assert stored["node"] == 4095
    assert stored["codes"] == [2048] * 4


def test_what_a_board_refuses_is_not_flashed(flash):
    done, loaded, page = flash("ROLE=beacon", "NODE=3", "AMPLITUDE=100")
    assert done.returncode == 2
    assert "error: amplitude is 100 A; it must be 0 to 15.9 A" in done.stderr
    assert not loaded
    assert not page.exists()


def test_parameters_need_the_node(flash):
    done, loaded, _ = flash("ROLE=beacon", "AMPLITUDE=10")
    assert done.returncode == 2
    assert "needs NODE=n as well" in done.stdout
    assert not loaded


def test_an_image_alone_leaves_the_page_and_what_is_saved(flash):
    done, loaded, page = flash("ROLE=sensor")
    assert done.returncode == 0, done.stderr
    assert words(loaded) == f"load --target stm32f405rgtx {load('sensor')}"
    assert not page.exists()


def test_the_boot_loader_comes_with_its_key_and_an_empty_other_slot(flash):
    """What a board has got over its link is newer by its number: it must be gone."""
    key = bytes(range(32))
    done, _, _ = flash("ROLE=sensor", f"KEY={key.hex()}")
    assert done.returncode == 0, done.stderr
    loader = (ROOT / "build/boot/boot.bin").read_bytes()
    first = done.loaded["at_08000000"]
    assert first.startswith(loader)
    assert first[KEY_PLACE - 0x08000000 :] == key_place(key)
    assert set(first[len(loader) : KEY_PLACE - 0x08000000]) == {0xFF}
    assert done.loaded["at_08080000"] == b"\xff" * 512
    assert "no KEY" not in done.stdout
    done, _, _ = flash("ROLE=sensor")
    assert done.loaded["at_08000000"] == loader
    assert "no KEY is given: this board will take no image over its links" in done.stdout


@pytest.mark.parametrize("key", ["12", "x" * 64, "00" * 33])
def test_a_key_that_is_none_is_refused(flash, key):
    done, loaded, _ = flash("ROLE=sensor", f"KEY={key}")
    assert done.returncode == 2
    assert f"KEY={key} is no public key: give the 64 hexadecimal digits of one" in done.stderr
    assert not loaded


def test_a_mistyped_parameter_is_refused(flash):
    done, loaded, page = flash("ROLE=beacon", "NODE=3", "AMPLITUD=10")
    assert done.returncode == 2
    assert "error: there is no parameter 'amplitud'; the nearest is 'amplitude'" in done.stderr
    assert not loaded
    assert not page.exists()


NOT_FLASHED = [
    (
        probes(),
        (),
        "no debug probe was found: connect one by USB (an ST-LINK, a J-Link or any CMSIS-DAP); one that is c",
    ),
    (ONE_PROBE, ("PROBE=0770",), "there is no debug probe 0770: give one of PROBE=066DFF01 (STM32 STLink 066DFF01)"),
    (
        probes("066DFF01", "066DFF02"),
        ("PROBE=066D",),
        "several debug probes are connected: give one of PROBE=066DFF01 (",
    ),
    (
        probes("066DFF01", "066DFF02"),
        (),
        "several debug probes are connected: give one of PROBE=066DFF01 (STM32 STLink 066",
    ),
    (probes(status=1, error="no USB\nhere"), (), "the search for a debug probe failed: no USB here: plug the probe in"),
    ("Traceback", (), "json --probes: does not list the debug probes: run it to see why"),
    ("[]", (), "json --probes: does not list the debug probes: run it to see why"),
    (
        ONE_PROBE,
        ("PYOCD=no/such/pyocd",),
        "no/such/pyocd: No such file or directory: pyOCD programs boards, and make set",
    ),
]


@pytest.mark.parametrize(("listed", "assignments", "sentence"), NOT_FLASHED)
def test_no_probe_is_told_before_anything_is_built_or_flashed(flash, listed, assignments, sentence):
    done, loaded, page = flash("ROLE=beacon", "NODE=3", *assignments, probes=listed)
    assert done.returncode == 2
    told, make = done.stderr.splitlines()
    assert sentence in told
    assert "flash-ready" in make
    assert not loaded
    assert not page.exists()


def test_the_probe_is_named_and_the_one_of_several_used(flash):
    done, loaded, _ = flash("ROLE=sensor")
    assert done.stdout.splitlines()[0] == "debug probe: STM32 STLink 066DFF01, 066DFF01"
    done, loaded, _ = flash("ROLE=sensor", "PROBE=FF02", probes=probes("066DFF01", "066DFF02"))
    assert done.stdout.splitlines()[0] == "debug probe: STM32 STLink 066DFF02, 066DFF02"
    assert words(loaded) == f"load --uid FF02 --target stm32f405rgtx {load('sensor')}"


def test_the_chip_is_named_the_flash_compared_and_the_brown_out_level_set(flash):
    done, _, _ = flash("ROLE=beacon", "NODE=3")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "chip: STM32F405, device id 0x413, revision 0x1007, 1024 kB of flash" in lines
    assert any(line.startswith("verified: ") for line in lines)
    assert lines[-1] == "option bytes: brown-out reset set to level 3 (2.7 V); it acts from the next power-on"
    wanted = 0x0FFFAAE0  # all but the level and the lock as before
    assert done.written == [
        *([OPTKEYR, 0x08192A3B], [OPTKEYR, 0x4C5D6E7F], [OPTCR, wanted], [OPTCR, wanted | 2], [OPTCR, wanted | 1])
    ]


def test_option_bytes_that_are_right_are_left_alone(flash):
    done, _, _ = flash("ROLE=beacon", chip={OPTCR: 0x0FFFAAE1})
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "option bytes: brown-out reset at level 3 (2.7 V) already"
    assert done.written == []


@pytest.mark.parametrize(
    ("chip", "sentence"),
    [
        ({IDCODE: 0x10016419}, "the chip's device id is 0x419 and its core 0xc24; those of an STM32F405 are 0x413 and"),
        (
            {IDCODE: 0x20006411, CPUID: 0x412FC230},
            "the chip's device id is 0x411 and its core 0xc23; those of an STM32",
        ),
        (
            {FLASH_SIZE: 0x02000000},
            "the chip has 512 kB of flash, and the parameter page needs 1024 kB: take an STM32F",
        ),
    ],
)
def test_another_chip_is_not_programmed(flash, chip, sentence):
    done, loaded, _ = flash("ROLE=beacon", chip=chip)
    assert done.returncode == 2
    assert sentence in done.stderr
    assert not loaded
    assert done.written == []


def test_the_first_silicon_is_told(flash):
    done, loaded, _ = flash("ROLE=beacon", chip={IDCODE: 0x10006411})
    assert done.returncode == 0, done.stderr
    assert "device id 0x411, revision 0x1000, which reads its flash without prefetch" in done.stdout
    assert loaded


@pytest.mark.parametrize(
    ("state", "sentence"),
    [
        ({"dead": True}, "pyOCD cannot reach the chip (No ACK received): check the board's power and the wires SWDIO"),
        ({"wrong_byte": 16}, "the flash differs from build/firmware/beacon.elf at 0x08020210: program it again"),
        ({"keeps_options": False}, "the chip did not take the brown-out level (FLASH_OPTCR 0x0fffaaed): power it off"),
    ],
)
def test_what_does_not_work_is_told(flash, state, sentence):
    done, _, _ = flash("ROLE=beacon", **state)
    assert done.returncode == 2
    assert sentence in done.stderr
