"""Objects of C sources that several tests link, compiled once and kept in ``build/objects`` by what goes into them."""

from __future__ import annotations

import hashlib
import subprocess
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

from hil_sim.clib import ROOT

OBJECTS = ROOT / "build" / "objects"

SANITIZED = (
    "-std=c11",
    "-D_GNU_SOURCE",
    "-Og",
    "-g",
    "-fsanitize=address,undefined,float-cast-overflow",
    "-fno-sanitize-recover=all",
)
"""Flags of the tests under the address and undefined-behaviour sanitizers: those of all, so that they share objects."""

INCLUDES = tuple(f"-I{ROOT / folder}" for folder in ("firmware", "build/protocol"))


def objects(sources: Iterable[Path], flags: Sequence[str] = SANITIZED) -> list[str]:
    """Return the object of each source, compiled with `flags` and `INCLUDES`, without warnings, unless it is kept.

    The name of an object is the hash of the compiler's version, the flags and the preprocessed text, which has the
    names of all files in it: what is kept is what compiling anew would give. Each is moved to its place when it is
    whole, so that two tests may compile at once.

    Raises
    ------
    subprocess.CalledProcessError
        A source does not compile.
    """
    OBJECTS.mkdir(parents=True, exist_ok=True)
    command = ["gcc", *flags, "-w", *INCLUDES]
    version = subprocess.run(["gcc", "--version"], check=True, capture_output=True).stdout
    return [str(_object(command, version, source)) for source in sources]


def _object(command: list[str], version: bytes, source: Path) -> Path:
    text = subprocess.run([*command, "-E", str(source)], check=True, capture_output=True).stdout
    kept = OBJECTS / f"{hashlib.sha256(b'|'.join([version, ' '.join(command).encode(), text])).hexdigest()}.o"
    if not kept.exists():
        with tempfile.TemporaryDirectory(dir=OBJECTS) as folder:
            made = Path(folder) / "made.o"
            subprocess.run([*command, "-c", str(source), "-o", str(made)], check=True)
            made.replace(kept)
    return kept


def shared_library(source: Path) -> Path:
    """Return the library of one C source of the tests and the C mathematics, compiled with warnings as errors.

    Two tests may compile it at once: it is moved to its place, in ``build/tests``, when it is whole.

    Raises
    ------
    subprocess.CalledProcessError
        The source does not compile.
    """
    library = ROOT / "build" / "tests" / f"libgf_{source.stem}.so"
    library.parent.mkdir(parents=True, exist_ok=True)
    command = ["gcc", "-std=c11", "-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC", f"-I{ROOT / 'firmware'}"]
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        made = Path(folder) / "made.so"
        subprocess.run([*command, f"-I{source.parent}", str(source), "-lm", "-o", str(made)], check=True)
        made.replace(library)
    return library
