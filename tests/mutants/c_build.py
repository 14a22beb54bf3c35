"""Builds of the core that hold all its mutants: one to run, and one that traces which mutants a test infects."""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from tests.mutants.c_sites import Instrumented
from tests.mutants.mutant import Mutant, with_distinct_names

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
OUT = ROOT / "build/mutants"
COMPILE = ("gcc", "-std=gnu11", "-O1", "-fPIC", "-w", "-fwrapv", "-ftrack-macro-expansion=0", "-fmax-errors=0")
INCLUDES = tuple(f"-I{path}" for path in (OUT / "source/firmware", ROOT / "firmware", ROOT / "build/protocol"))
OF_A_FILE = 1000
"""Numbers that each source has, so that a change of one leaves those of the others, and their objects."""
FRONT = ("-include", str(HERE / "mutants.h"))
ERROR = re.compile(r"^(/[^:]+):(\d+):\d+: (?:fatal )?error: (.*)$", re.M)
MARK = re.compile(r"/\*@(\d+)\*/")


@dataclass(frozen=True)
class Build:
    """What was built.

    Attributes
    ----------
    mutants : list of Mutant
        In order of their numbers.
    library, trace : Path
        The core with its mutants, and the one that tells what a test infects.
    """

    mutants: list[Mutant]
    library: Path
    trace: Path

    def digest(self) -> str:
        """Digest of all that numbers the mutants."""
        return hashlib.sha256("\n".join(f"{m.number} {m.name}" for m in self.mutants).encode()).hexdigest()[:16]


class _Sources:
    """The instrumented copies of the core's sources."""

    def __init__(self) -> None:
        self.paths = [path for path in sorted((ROOT / "firmware/core").glob("*/*.[ch]"))]
        self.left_out: dict[Path, set[tuple[int, str]]] = {path: set() for path in self.paths}
        self.mutants: list[Mutant] = []
        self.places: dict[int, tuple[Path, tuple[int, str]]] = {}

    def copy(self, path: Path) -> Path:
        return OUT / "source" / path.relative_to(ROOT)

    def write(self) -> None:
        """Instrument all; a file that has not changed is not touched."""
        self.mutants, self.places = [], {}
        for i, path in enumerate(self.paths):
            name = str(path.relative_to(ROOT))
            made = Instrumented(name, path.read_bytes(), i * OF_A_FILE + 1, self.left_out[path])
            if len(made.mutants) >= OF_A_FILE:
                raise RuntimeError(
                    f"{name} has {len(made.mutants)} mutants: raise OF_A_FILE in tests/mutants/c_build.py"
                )
            self.mutants += made.mutants
            self.places |= {number: (path, place) for number, place in made.places.items()}
            copy = self.copy(path)
            copy.parent.mkdir(parents=True, exist_ok=True)
            if not copy.exists() or copy.read_text() != made.text:
                copy.write_text(made.text)

    def refuse(self, words: str) -> None:
        """Leave out the mutants at which the compiler found errors."""
        found = False
        for file, line, _ in ERROR.findall(words):
            lines = Path(file).read_text().splitlines() if Path(file).is_relative_to(OUT / "source") else []
            for number in MARK.findall(lines[int(line) - 1]) if lines else ():
                path, place = self.places[int(number)]
                self.left_out[path].add(place)
                found = True
        if not found:
            raise RuntimeError(f"an instrumented source does not compile:\n{words[:3000]}")


def _objects(sources: list[Path], name: str, flags: tuple[str, ...], workers: int) -> tuple[list[Path], str]:
    """Compile; return the objects and what the compiler says."""

    def compile_one(source: Path) -> tuple[Path, str]:
        target = OUT / name / source.relative_to(OUT / "source" if source.is_relative_to(OUT) else ROOT)
        target = target.with_suffix(".o")
        target.parent.mkdir(parents=True, exist_ok=True)
        headers = [path for path in (OUT / "source").rglob("*.h")] + [HERE / "mutants.h"]
        newest = max(path.stat().st_mtime for path in (source, *headers))
        if target.exists() and target.stat().st_mtime > newest:
            return target, ""
        command = [*COMPILE, *flags, *FRONT, *INCLUDES, "-c", str(source), "-o", str(target)]
        return target, subprocess.run(command, capture_output=True, text=True, check=False).stderr

    with ThreadPoolExecutor(workers) as pool:
        made = list(pool.map(compile_one, sources))
    return [target for target, _ in made], "".join(words for _, words in made)


def _link(objects: list[Path], name: str, flags: tuple[str, ...], count: int) -> Path:
    library = OUT / f"{name}.so"
    runtime = [*COMPILE, *flags, *FRONT, f"-DGF_COUNT={count}", str(HERE / "mutants.c")]
    subprocess.run([*runtime, "-shared", *map(str, objects), "-o", str(library)], check=True)
    return library


def _kinds(library: Path) -> dict[int, bool]:
    """Return for each mutant that depends on it whether real numbers meet where it is."""

    class Kind(ctypes.Structure):
        _fields_ = (("mutant", ctypes.c_int), ("real", ctypes.c_int))

    opened = ctypes.CDLL(str(library))
    opened.gf_kinds.restype = ctypes.POINTER(Kind)
    kinds = opened.gf_kinds()
    return {kinds[i].mutant: bool(kinds[i].real) for i in range(opened.gf_kinds_count())}


def build(workers: int = 1) -> Build:
    """Build both libraries, if the sources have changed; while another process builds, wait for it.

    Raises
    ------
    RuntimeError
        If the compiler finds an error where no mutant is.
    """
    OUT.mkdir(parents=True, exist_ok=True)
    with (OUT / "build.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return _build(workers)


def _build(workers: int) -> Build:
    """See `build`. It writes the sources anew, so that two at a time would compile those of each other."""
    sources = _Sources()
    while True:
        sources.write()
        files = [sources.copy(path) for path in sources.paths if path.suffix == ".c"]
        stamp = OUT / "build.stamp"
        texts = [sources.copy(path) for path in sources.paths] + [HERE / "mutants.h", HERE / "mutants.c"]
        digest = hashlib.sha256(b"".join(path.read_bytes() for path in texts)).hexdigest()
        known = OUT / "left_out.txt"
        if stamp.exists() and stamp.read_text() == digest:
            break
        if known.exists() and not any(sources.left_out.values()):
            _read_left_out(sources, known)
            if any(sources.left_out.values()):
                continue
        objects, words = _objects(files, "run", (), workers)
        if ERROR.search(words):
            sources.refuse(words)
            continue
        others = sorted((ROOT / "firmware/third_party").glob("*/*.c"))
        objects += _objects(others, "run", (), workers)[0]
        traced, _ = _objects([*files, *others], "trace", ("-DGF_TRACE",), workers)
        count = len(sources.paths) * OF_A_FILE
        _link(objects, "libgf_core_mutants", (), count)
        _link(traced, "libgf_core_traced", ("-DGF_TRACE",), count)
        _write_left_out(sources, known)
        stamp.write_text(digest)
        break
    library, trace = OUT / "libgf_core_mutants.so", OUT / "libgf_core_traced.so"
    kinds = _kinds(library)
    there = [m for m in sources.mutants if m.real is None or kinds.get(m.number) == m.real]
    return Build(with_distinct_names(there), library, trace)


def _write_left_out(sources: _Sources, known: Path) -> None:
    """Keep what the compiler refused, with a digest of each source, for the next build."""
    lines = []
    for path, places in sources.left_out.items():
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        lines += [f"{path}\t{digest}\t{at}\t{change}" for at, change in sorted(places)]
    known.write_text("\n".join(lines))


def _read_left_out(sources: _Sources, known: Path) -> None:
    digests = {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in sources.paths}
    for line in known.read_text().splitlines():
        path, digest, at, change = line.split("\t")
        if digests.get(path) == digest:
            sources.left_out[Path(path)].add((int(at), change))
