"""Make the corpus of a target anew, of what it holds and what was found: ``python -m tests.fuzz.keep core/store``.

The fewest files that show all that the old and the new ones show stand in place of the old. libFuzzer tells it of the
core; of the host, where its merge does not work under atheris, the lines that each file reaches are counted here.
"""

from __future__ import annotations

import importlib
import shutil
import subprocess
import sys
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
FUZZ, CORPUS = ROOT / "build" / "fuzz", ROOT / "tests" / "fuzz" / "corpus"
MOST = 40
"""Files of a corpus: those that show most; a fuzzer finds the rest again in seconds."""
LOOKED_AT = ("/host/goldfield/", "/protocol/", "/hil_sim/", "/can/io/", "/mcap/")


def of_core(name: str, old: list[Path]) -> list[Path]:
    """Return the files that libFuzzer's own merge chooses, of which the longest show most."""
    merged = FUZZ / "merged" / name
    shutil.rmtree(merged, ignore_errors=True)
    merged.mkdir(parents=True)
    folders = sorted({str(path.parent) for path in old})
    words = [str(FUZZ / "bin" / name), "-set_cover_merge=1", str(merged), *folders]
    subprocess.run(words, check=True, capture_output=True)
    return sorted(merged.iterdir(), key=lambda path: -path.stat().st_size)[:MOST]


def of_host(name: str, old: list[Path]) -> list[Path]:
    """Return the files that reach most lines, the short ones first."""
    harness = importlib.import_module(f"tests.fuzz.host.{name}")
    reached = {path: lines_of(harness, path.read_bytes()) for path in sorted(old, key=lambda path: path.stat().st_size)}
    chosen: list[Path] = []
    seen: set[tuple[str, int]] = set()
    while len(chosen) < MOST:
        best = max(reached, key=lambda path: len(reached[path] - seen))
        if not reached[best] - seen:
            break
        chosen.append(best)
        seen |= reached[best]
    return chosen


def lines_of(harness: Any, data: bytes) -> set[tuple[str, int]]:
    """Return the lines of the project and its readers that an input reaches."""
    found: set[tuple[str, int]] = set()

    def line(frame: FrameType, event: str, _: Any) -> Any:
        found.add((frame.f_code.co_filename, frame.f_lineno))
        return line

    def call(frame: FrameType, event: str, _: Any) -> Any:
        return line if any(part in frame.f_code.co_filename for part in LOOKED_AT) else None

    sys.settrace(call)
    try:
        harness.one_input(data)
    finally:
        sys.settrace(None)
    return found


def keep(target: str) -> int:
    """Make the corpus of a target anew; return how many files it has."""
    side, name = target.split("/")
    kept = CORPUS / target
    kept.mkdir(parents=True, exist_ok=True)
    old = [path for folder in (kept, FUZZ / "found" / target) if folder.exists() for path in folder.iterdir()]
    chosen = of_core(name, old) if side == "core" else of_host(name, old)
    contents = sorted({path.read_bytes() for path in chosen})
    shutil.rmtree(kept)
    kept.mkdir()
    for number, content in enumerate(contents):
        (kept / f"{number:02d}").write_bytes(content)
    return len(contents)


if __name__ == "__main__":
    print(f"{sys.argv[1]}: {keep(sys.argv[1])} files")
