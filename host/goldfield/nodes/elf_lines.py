"""From an address of a board's program to the line of the source, by the debugging information of its ELF file."""

from __future__ import annotations

from bisect import bisect_right
from pathlib import Path
from typing import Any

from goldfield.errors import UserError


class ElfLines:
    """The lines and functions of an ELF file.

    Parameters
    ----------
    path : str
        The file that was flashed, as ``build/firmware/beacon.elf``.

    Raises
    ------
    UserError
        The file is not there, is no ELF file, or has no debugging information; or pyelftools is not installed.
    """

    def __init__(self, path: str) -> None:
        try:
            from elftools.common.exceptions import ELFError
            from elftools.elf.elffile import ELFFile
        except ImportError as error:
            raise UserError("--elf needs pyelftools: install it with pip install 'goldfield[sim]'") from error
        self.name = Path(path).name
        self.role = Path(path).stem
        try:
            with Path(path).open("rb") as file:
                elf = ELFFile(file)
                self._functions = _functions(elf)
                self._rows = _rows(elf) if elf.has_dwarf_info() else []
        except OSError as error:
            raise UserError(f"{path}: {error.strerror}: give the ELF file that was flashed") from error
        except ELFError as error:
            raise UserError(f"{path}: is no ELF file ({error}): give the one that was flashed") from error
        if not self._rows:
            raise UserError(f"{path}: has no debugging information: give the ELF file of make firmware")
        self._starts = [row[0] for row in self._rows]

    def place(self, address: int) -> str | None:
        """Return file, line and function of an address; None if there is no code."""
        at = bisect_right(self._starts, address) - 1
        if at < 0 or self._rows[at][1] is None:
            return None
        _, source, line = self._rows[at]
        function = next((name for begin, end, name in self._functions if begin <= address < end), None)
        return f"{self.name}: {source}:{line}" + (f", {function}" if function else "")


def _functions(elf: Any) -> list[tuple[int, int, str]]:
    table = elf.get_section_by_name(".symtab")
    symbols = () if table is None else table.iter_symbols()
    found = [s for s in symbols if s["st_info"]["type"] == "STT_FUNC" and s["st_size"]]
    return [(s["st_value"] & ~1, (s["st_value"] & ~1) + s["st_size"], s.name) for s in found]


def _rows(elf: Any) -> list[tuple[int, str | None, int]]:
    """Return where each line's code begins, sorted; a row without a file is the end of a piece of code."""
    dwarf, rows = elf.get_dwarf_info(), list[tuple[int, str | None, int]]()
    for unit in dwarf.iter_CUs():
        program = dwarf.line_program_for_CU(unit)
        if program is None:
            continue
        header = program.header
        offset = 0 if header["version"] >= 5 else 1  # Files count from 1 before DWARF 5.
        for entry in program.get_entries():
            state = entry.state
            if state is None:
                continue
            source = header["file_entry"][state.file - offset].name.decode(errors="replace")
            rows.append((state.address, None if state.end_sequence else Path(source).name, state.line))
    # A piece that ends where the next begins: the beginning comes last, and counts.
    return sorted(rows, key=lambda row: (row[0], row[1] is not None))
