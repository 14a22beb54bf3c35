"""A site file with other codes: read whatever codes it has, and written with all else as its author wrote it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit

from goldfield.errors import UserError
from goldfield.files.inputs import name_of
from goldfield.files.toml_table import parse_table, read_text
from goldfield.site import Site
from goldfield.site.reading import site_of
from goldfield.site.revision import put, written


class CodedText:
    """The text of a site file whose beacons get other codes.

    Parameters
    ----------
    path : Path

    Raises
    ------
    UserError
        If it is no site file, but for the codes, which may be missing or the same.

    Attributes
    ----------
    site : Site
        As the file has it, with a code of no meaning for each beacon.
    """

    def __init__(self, path: Path) -> None:
        self._name = name_of(path)
        self._text = text = read_text(path, "site file")
        parse_table(text, self._name, "site file")  # A complaint about its form is that of any command.
        self._document: Any = tomlkit.parse(text)
        self._had = self._document.get("site", {}).get("shared_codes")
        beacons = self._document.get("beacon", [])
        for table in beacons if isinstance(beacons, list) else []:
            if "codes" in table:
                raise UserError(
                    f'{self._name}: beacon "{table.get("id")}" has several codes: one code a beacon is planned'
                )
        self.site = self._read([0] * len(beacons), shared=True)
        if self.site.access != "cdma":
            raise UserError(f"{self._name}: the site's access is {self.site.access}: it has no codes to plan")

    def with_codes(self, codes: Sequence[int]) -> str:
        """Return the text with these codes, in the order of the beacons; ``shared_codes`` is as they need it."""
        self._read(codes, shared=len(set(codes)) < len(codes))
        return written(self._document, self._text)

    def _read(self, codes: Sequence[int], *, shared: bool) -> Site:
        """Set codes, and read the site."""
        document = self._document
        for table, code in zip(document.get("beacon", []), codes, strict=True):
            put(table, "code", int(code))
        if "site" in document:
            if shared or self._had is not None:
                put(document["site"], "shared_codes", shared)
            else:
                document["site"].pop("shared_codes", None)
        return site_of(parse_table(tomlkit.dumps(document), self._name, "site file"))
