"""What tells the sources that a trial has run from all others: a file of outcomes that goes on may hold several."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from hil_sim.clib import ROOT

FOLDERS = ("firmware", "protocol", "hil_sim", "host/goldfield", "tests/campaign")
ENDINGS = (".c", ".h", ".py", ".toml", ".dbc", ".ld", ".S")


@cache
def build_of(root: Path = ROOT) -> str:
    """Return a name of all sources that make boards, bench, host and faults what they are."""
    found = hashlib.sha256()
    for folder in FOLDERS:
        for path in sorted((root / folder).rglob("*")):
            if path.suffix in ENDINGS and path.is_file():
                found.update(f"{path.relative_to(root)}\n".encode() + path.read_bytes())
    return found.hexdigest()[:12]
