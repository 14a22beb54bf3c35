"""The ELF files that an emulated board is flashed with."""

from __future__ import annotations

from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any

from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

from goldfield_protocol.image import KEY_PLACE, key_place
from hil_sim.emulator.kept_flash import FLASH, BadImageError


def first_words(segments: list[tuple[int, bytes]], vectors: Any) -> list[tuple[int, bytes]]:
    """Return the segment that starts an image alone, which lies in a slot: what a boot loader would do for it.

    The processor reads its first stack pointer and where it begins from the beginning of the flash. There the first two
    words of the image's vector table are put, if the image has a section ``.vectors`` and holds nothing there itself.
    """
    if (
        not segments
        or vectors is None
        or any(address <= FLASH.start < address + len(data) for address, data in segments)
    ):
        return []
    return [(FLASH.start, bytes(vectors.data()[:8]))]


def read_image(path: str | Path) -> tuple[list[tuple[int, bytes]], dict[str, int]]:
    """Read an ELF image.

    Returns
    -------
    segments : list of (address, bytes)
        What lies in flash, by physical address, and what starts it (`first_words`).
    symbols : dict
        Addresses by name; those of functions carry the Thumb bit.

    Raises
    ------
    BadImageError
        The file cannot be read, is no ARM ELF image, or does not fit the flash.
    """
    try:
        segments, symbols = _parsed(str(path), Path(path).read_bytes())
    except OSError as error:
        raise BadImageError(f"{path} cannot be read ({error.strerror}): give the ELF file of an image") from error
    except (ELFError, UnicodeDecodeError) as error:
        raise BadImageError(f"{path} is not an ELF image ({error}): give the file that the linker wrote") from error
    return list(segments), dict(symbols)


@lru_cache(maxsize=16)  # Boards of a rig have the same few images, and their symbols take longer than a boot.
def _parsed(path: str, content: bytes) -> tuple[list[tuple[int, bytes]], dict[str, int]]:
    elf = ELFFile(BytesIO(content))
    if elf.get_machine_arch() != "ARM":
        raise BadImageError(f"{path} is for {elf.get_machine_arch()}, not for ARM: give the image built for the board")
    segments = [
        (int(segment["p_paddr"]), bytes(segment.data()))
        for segment in elf.iter_segments()
        if segment["p_type"] == "PT_LOAD" and segment["p_filesz"] > 0
    ]
    segments += first_words(segments, elf.get_section_by_name(".vectors"))
    table = elf.get_section_by_name(".symtab")
    symbols: dict[str, int] = {}
    if isinstance(table, SymbolTableSection):
        symbols = {symbol.name: int(symbol["st_value"]) for symbol in table.iter_symbols() if symbol.name}
    if not segments:
        raise BadImageError(f"{path} holds nothing to load: give a linked image, not an object file")
    for address, data in segments:
        if address not in FLASH or address + len(data) > FLASH.stop:
            raise BadImageError(
                f"{path} has {len(data)} bytes for 0x{address:08x}, outside of the flash at "
                f"0x{FLASH.start:08x}..0x{FLASH.stop - 1:08x}: check the linker script"
            )
    return segments, symbols


def behind(boot: str | Path | None, key: bytes | None, image: list[tuple[int, bytes]]) -> list[tuple[int, bytes]]:
    """Return what is flashed of an image behind a boot loader that knows a public key, if there are such."""
    segments = list(image)
    if boot is not None:
        segments = [*read_image(boot)[0], *((at, data) for at, data in segments if at != FLASH.start)]
    if key is not None:
        segments.append((KEY_PLACE, key_place(key)))
    return segments
