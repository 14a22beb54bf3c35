"""Load a shared library of ours through cffi with the declarations of its own headers."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cffi

ROOT = Path(__file__).resolve().parent.parent
INCLUDES = ("firmware", "hil_sim", "build/protocol")


@cache
def declarations(headers: tuple[str, ...], defines: tuple[str, ...] = ()) -> str:
    """Preprocess headers and keep what stands in this project's own files, as cffi's cdef wants it.

    Integer macros become enum constants. Inline functions, attributes and static assertions are dropped.
    """
    includes = [f"-I{ROOT / path}" for path in INCLUDES]
    command = ["gcc", "-E", "-dD", *includes, *(f"-D{d}" for d in defines), "-x", "c", "-"]
    source = "".join(f'#include "{header}"\n' for header in headers)
    text = subprocess.run(command, input=source, capture_output=True, text=True, check=True).stdout
    kept: list[str] = []
    ours = False
    for line in text.splitlines():
        marker = re.match(r'# \d+ "(.*?)"', line)
        if marker:
            ours = marker[1].startswith(str(ROOT))
        elif ours:
            macro = re.match(r"#define (\w+) (?:\(?\s*)((?:0x[0-9a-fA-F]+|\d+))[uUlL]*\)?\s*$", line)
            if macro:
                kept.append(f"#define {macro[1]} {macro[2]}")
            elif not line.startswith("#"):
                kept.append(line)
    joined = "\n".join(kept)
    joined = re.sub(r"__attribute__\s*\(\((?:[^()]|\([^()]*\))*\)\)", "", joined)
    joined = re.sub(r"\bextern const\b", "extern", joined)  # cffi takes a const object for an integer constant
    joined = re.sub(r"_Static_assert\s*\((?:[^()\"]|\([^()]*\)|\"[^\"]*\")*\)\s*;", "", joined)
    return re.sub(r"static inline[^{;]*\{[^{}]*(?:\{[^{}]*\}[^{}]*)*\}", "", joined)


def load(library: str | Path, headers: Sequence[str], defines: Sequence[str] = ()) -> tuple[cffi.FFI, Any]:
    """Open a library with the declarations of its headers.

    Parameters
    ----------
    library : path
        Shared library, relative to the project or absolute.
    headers : sequence of str
        Header names, found on the project's include paths.
    defines : sequence of str
        Preprocessor definitions.

    Raises
    ------
    FileNotFoundError
        If the library has not been built.
    """
    path = Path(library) if Path(library).is_absolute() else ROOT / library
    if not path.exists():
        raise FileNotFoundError(f"{path} is not built: run 'make all'")
    return _open(path, tuple(headers), tuple(defines))


@cache  # cffi unloads a library when its handle goes; objects made by it may outlive the handle
def _open(path: Path, headers: tuple[str, ...], defines: tuple[str, ...]) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    ffi.cdef(declarations(headers, defines))
    return ffi, ffi.dlopen(str(path))
