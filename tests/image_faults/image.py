"""What an image is made of, by its ELF file: its instructions, the module of each, and where its variables lie."""

from __future__ import annotations

import bisect
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from elftools.elf.elffile import ELFFile

from hil_sim.emulator.elf_image import read_image

MODULES = {
    "current": ("core/drive/current.c", "core/drive/waveform.c"),
    "protection": ("core/drive/", "services/drive", "boards/stm32f405/alarms.c", "boards/stm32f405/guards.c"),
    "board": ("stm32f405/bridge.c", "stm32f405/chip_engine.c", "stm32f405/converters.c"),
    "parser": ("core/link/", "services/requests.c", "services/parameter_requests.c", "services/access.c"),
    "storage": ("core/storage/", "services/storage.c", "stm32f405/flash.c", "stm32f405/flash_operation.c"),
    "boot": ("core/boot/", "stm32f405/boot/", "stm32f405/images.c"),
    "signature": ("third_party/monocypher/",),
}
"""Source files of each module, parts of their paths; the first that fits counts."""


@dataclass(frozen=True)
class Instruction:
    """One instruction of an image."""

    address: int
    size: int
    function: str
    module: str


def module_of(path: str) -> str | None:
    """Return the module of a source file; None: none of these."""
    return next((name for name, parts in MODULES.items() if any(part in path for part in parts)), None)


def _data_begins(table: Any) -> tuple[list[int], list[bool]]:
    """Return where code and data take turns, by the mapping symbols (AAELF32, 5.5.5), and whether it is data then."""
    marks = sorted(
        (int(symbol["st_value"]), symbol.name.startswith("$d"))
        for symbol in table.iter_symbols()
        if symbol.name[:2] in ("$t", "$d")
    )
    return [at for at, _ in marks], [data for _, data in marks]


def _functions(elf: ELFFile) -> Iterator[tuple[int, int, str, str]]:
    """Yield address, size, name and module of each function."""
    dwarf: Any = elf.get_dwarf_info()  # type: ignore[no-untyped-call]
    ranges = dwarf.get_aranges()
    seen = set()
    for symbol in elf.get_section_by_name(".symtab").iter_symbols():
        address, size = int(symbol["st_value"]) & ~1, int(symbol["st_size"])
        if symbol["st_info"]["type"] != "STT_FUNC" or size == 0 or address in seen:
            continue
        offset = ranges.cu_offset_at_addr(address)
        if offset is None:
            continue
        path = dwarf.get_CU_at(offset).get_top_DIE().attributes["DW_AT_name"].value.decode()
        module = module_of(path)
        if module is not None:
            seen.add(address)
            yield address, size, symbol.name, module


@cache
def instructions(path: Path) -> dict[int, Instruction]:
    """Return the instructions of the modules, by address."""
    found = {}
    with path.open("rb") as file:
        elf = ELFFile(file)
        at, is_data = _data_begins(elf.get_section_by_name(".symtab"))
        text = elf.get_section_by_name(".text")
        start, data = int(text["sh_addr"]), text.data()
        for first, size, name, module in _functions(elf):
            place = first
            while place < first + size:
                mark = bisect.bisect_right(at, place) - 1
                if is_data[mark]:
                    place = at[mark + 1] if mark + 1 < len(at) else first + size
                    continue
                word = int.from_bytes(data[place - start : place - start + 2], "little")
                length = 4 if word >> 11 >= 0x1D else 2
                found[place] = Instruction(place, length, name, module)
                place += length
    return found


@cache
def text_of(path: Path) -> range:
    """Return the addresses of an image's code."""
    with path.open("rb") as file:
        text = ELFFile(file).get_section_by_name(".text")
        return range(int(text["sh_addr"]), (int(text["sh_addr"]) + int(text["sh_size"]) + 1) & ~1)


@cache
def name_of(path: Path) -> str:
    """Return what tells the code of an image from all others: addresses are as good as the build."""
    found = hashlib.sha256()
    for address, data in read_image(path)[0]:
        found.update(address.to_bytes(4, "little") + data)
    return found.hexdigest()[:12]


def _plain(die: Any) -> Any:
    while die is not None and die.tag in ("DW_TAG_typedef", "DW_TAG_const_type", "DW_TAG_volatile_type"):
        die = die.get_DIE_from_attribute("DW_AT_type") if "DW_AT_type" in die.attributes else None
    return die


def _size(die: Any) -> int:
    die = _plain(die)
    if die.tag == "DW_TAG_array_type":
        count = 1
        for bound in die.iter_children():
            count *= int(bound.attributes["DW_AT_upper_bound"].value) + 1
        return count * _size(die.get_DIE_from_attribute("DW_AT_type"))
    return int(die.attributes["DW_AT_byte_size"].value)


def _variable(elf: ELFFile, name: str) -> Any:
    dwarf: Any = elf.get_dwarf_info()  # type: ignore[no-untyped-call]
    for unit in dwarf.iter_CUs():
        for die in unit.get_top_DIE().iter_children():
            if die.tag != "DW_TAG_variable" or "DW_AT_location" not in die.attributes:
                continue
            said = die  # A header may have declared it.
            if "DW_AT_specification" in die.attributes:
                said = die.get_DIE_from_attribute("DW_AT_specification")
            if "DW_AT_name" in said.attributes and said.attributes["DW_AT_name"].value.decode() == name:
                return said
    raise KeyError(f"the image has no variable '{name}'")


@cache
def place_of(path: Path, dotted: str) -> range:
    """Return the addresses of a variable, or of a member of it, as ``beacon.drive.current[1].state``.

    Raises
    ------
    KeyError
        There is none.
    """
    with path.open("rb") as file:
        elf = ELFFile(file)
        variable, *members = dotted.split(".")
        [symbol] = elf.get_section_by_name(".symtab").get_symbol_by_name(variable)
        address = int(symbol["st_value"])
        die = _variable(elf, variable).get_DIE_from_attribute("DW_AT_type")
        for named in members:
            member, _, place = named.rstrip("]").partition("[")
            die = next(
                (
                    child
                    for child in _plain(die).iter_children()
                    if child.tag == "DW_TAG_member" and child.attributes["DW_AT_name"].value.decode() == member
                ),
                None,
            )
            if die is None:
                raise KeyError(f"'{dotted}' has no member '{member}'")
            address += int(die.attributes["DW_AT_data_member_location"].value)
            die = die.get_DIE_from_attribute("DW_AT_type")
            if place:
                die = _plain(die).get_DIE_from_attribute("DW_AT_type")
                address += int(place) * _size(die)
        return range(address, address + _size(die))
