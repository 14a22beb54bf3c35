"""Make the corpus of a target anew, of what it holds and what was found: ``python -m tests.fuzz.keep core/store``.

The fewest files that show all that the old and the new ones show stand in place of the old. libFuzzer tells it of the
core; of the host, where its merge does not work under atheris, the lines that each file reaches are counted here.
"""

from __future__ import annotations

import argparse
import importlib
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from goldfield.errors import SystemFailure, UserError
from tests.command import ended

ROOT = Path(__file__).resolve().parents[2]
FUZZ, CORPUS = ROOT / "build" / "fuzz", ROOT / "tests" / "fuzz" / "corpus"
TARGETS = sorted(
    f"{side}/{path.stem}"
    for side, pattern in (("core", "*.c"), ("host", "[a-z]*.py"))
    for path in Path(__file__).parent.joinpath(side).glob(pattern)
    if path.stem not in ("standalone", "judging")
)
"""Every harness, by side and name."""
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
    if not Path(words[0]).exists():
        raise SystemFailure(f"{words[0]}: is not built: `make fuzz-build` builds it")
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemFailure(
            f"core/{name}: libFuzzer ended with {done.returncode}: {(done.stderr.splitlines() or [''])[-1]}"
        )
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
    """Make the corpus of a target anew; return how many files it has.

    Raises
    ------
    UserError
        If there is no such target, or nothing of it to choose from.
    SystemFailure
        If libFuzzer does not choose.
    """
    side, _, name = target.partition("/")
    kept = CORPUS / target
    if target not in TARGETS:
        raise UserError(f"{target} is none of {', '.join(TARGETS)}")
    old = [path for folder in (kept, FUZZ / "found" / target) if folder.exists() for path in folder.iterdir()]
    if not old:
        raise UserError(f"{target}: there is nothing to keep: `make fuzz-long` finds it")
    chosen = of_core(name, old) if side == "core" else of_host(name, old)
    contents = sorted({path.read_bytes() for path in chosen})
    FUZZ.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=FUZZ) as folder:
        new = Path(folder) / name
        new.mkdir()
        for number, content in enumerate(contents):
            (new / f"{number:02d}").write_bytes(content)
        shutil.rmtree(kept, ignore_errors=True)
        new.replace(kept)
    return len(contents)


def main(words: Sequence[str] | None = None) -> int:
    """Make the corpora of targets anew."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("target", nargs="+", help=", ".join(TARGETS))
    for target in parser.parse_args(words).target:
        print(f"{target}: {keep(target)} files")
    return 0


if __name__ == "__main__":
    sys.exit(ended(main))
