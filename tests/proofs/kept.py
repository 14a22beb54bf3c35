"""Outcomes of proofs, kept in ``build/proofs`` by all that goes into them: what has not changed is not proven anew."""

from __future__ import annotations

import hashlib
import json
import subprocess
import tempfile
from dataclasses import asdict
from functools import cache
from pathlib import Path

from hil_sim.clib import ROOT
from tests.proofs.parts import Part
from tests.proofs.run import Outcome, prove

KEPT = ROOT / "build" / "proofs"
INPUTS = ("firmware/core", "firmware/third_party", "build/protocol", "tests/proofs")
"""Folders that hold whatever Frama-C and what judges its report read, whichever part it is."""


@cache
def inputs() -> str:
    """Return the hash of Frama-C's version and of every file of `INPUTS` but what Python keeps."""
    found = hashlib.sha256(subprocess.run(["frama-c", "-version"], check=True, capture_output=True).stdout)
    for folder in INPUTS:
        for path in sorted((ROOT / folder).rglob("*")):
            if path.is_file() and path.suffix != ".pyc":
                found.update(f"{path.relative_to(ROOT)} {path.stat().st_size}\n".encode() + path.read_bytes())
    return found.hexdigest()


def proven(part: Part) -> Outcome:
    """Return what came of a part, of the last time if nothing has changed since."""
    kept = KEPT / f"{part.name.replace(' ', '_')}-{inputs()}.json"
    if not kept.exists():
        KEPT.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=KEPT) as folder:
            made = Path(folder) / "made"
            made.write_text(json.dumps(asdict(prove(part))))
            made.replace(kept)
    read = json.loads(kept.read_text())
    return Outcome(read["alarms"], {name: (n, of) for name, (n, of) in read["reached"].items()}, read["seconds"])
