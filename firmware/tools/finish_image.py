"""Write an image's header into its ELF file: ``python finish_image.py build/firmware/sensor.elf [--confirmed]``.

The linker leaves the section ``.image_head`` empty, since length and CRC are known only when all else is there. The
role is the file's name, the version that of ``firmware/services/version.h``. ``--confirmed`` writes the state words
that a probe leaves: the image counts as the first on its board, and as good.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from elftools.elf.elffile import ELFFile

from goldfield_protocol import protocol_hash
from goldfield_protocol.image import CODE_OFFSET, SLOTS, STM32F405, Header, head

ROLES = {"beacon": 0, "sensor": 1, "anchor": 3}
VERSION = Path(__file__).resolve().parents[1] / "services" / "version.h"


def version(text: str) -> int:
    """Return the version that the text of ``version.h`` tells, as a header has it."""
    parts = {name: int(number) for name, number in re.findall(r"#define VERSION_(\w+) +(\d+)u", text)}
    return parts["MAJOR"] << 16 | parts["MINOR"] << 8 | parts["PATCH"]


def code_of(elf: ELFFile, slot: int) -> bytes:
    """Return what lies behind the head of a slot, up to the last byte that is loaded, in whole words."""
    loaded = [
        (s["p_paddr"], s.data())
        for s in elf.iter_segments()
        if s["p_type"] == "PT_LOAD" and s["p_filesz"] and s["p_paddr"] >= slot
    ]
    end = max(address + len(data) for address, data in loaded)
    result = bytearray(b"\xff" * (end - slot + -end % 4))
    for address, data in loaded:
        result[address - slot : address - slot + len(data)] = data
    return bytes(result[CODE_OFFSET:])


def finish(path: Path, confirmed: bool) -> None:
    """Write the header into the file.

    Raises
    ------
    ValueError
        The image is linked for neither slot.
    """
    with path.open("r+b") as file:
        elf = ELFFile(file)
        section = elf.get_section_by_name(".image_head")
        slot = section["sh_addr"]
        if slot not in SLOTS or section["sh_size"] != CODE_OFFSET:
            raise ValueError(f"{path} has {section['sh_size']} bytes of head at {slot:#010x}, which is no slot's")
        code = code_of(elf, slot)
        header = Header(len(code), slot, STM32F405, ROLES[path.stem], version(VERSION.read_text()), protocol_hash())
        file.seek(section["sh_offset"])
        file.write(head(header, code, confirmed=confirmed))


if __name__ == "__main__":
    finish(Path(sys.argv[1]), "--confirmed" in sys.argv[2:])
