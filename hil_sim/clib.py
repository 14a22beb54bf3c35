"""Find what the build makes, and load a shared library of ours through cffi with the declarations of its own headers.

In a checkout libraries and images lie in ``build`` and the compiler's preprocessor reads the headers. An installed
wheel has neither headers nor compiler: it carries the libraries, the images and the declarations in ``hil_sim/built``,
where ``setup.py`` puts them (``python -m hil_sim.clib DIRECTORY`` writes the declarations). A folder that the
environment names in ``GOLDFIELD_LIBRARIES`` comes before both: ``make test-sanitized`` has its libraries there.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cffi

ROOT = Path(__file__).resolve().parent.parent
"""The checkout that this package is part of."""
INSTALLED = Path(__file__).resolve().with_name("built")
"""What an installed wheel carries."""
LIBRARIES_VARIABLE = "GOLDFIELD_LIBRARIES"
"""The environment's variable that names a folder of libraries to be taken before the usual ones."""
INCLUDES = ("firmware", "hil_sim", "build/protocol")
LIBRARIES = {
    "libgf_rig.so": "rig/lockstep.h",
    "libgf_hostboard.so": "boards/host/host_board.h",
    "libgf_emulator.so": "emulator/emulator.h",
}
"""The libraries that the simulator runs on, each with the header of what Python calls."""


def built(name: str) -> Path:
    """Return the path of a library or an image that the build makes, as ``libgf_rig.so`` or ``firmware/sensor.elf``.

    Raises
    ------
    FileNotFoundError
        If it was not built; the message is a sentence for the user.
    """
    chosen = os.environ.get(LIBRARIES_VARIABLE)
    for path in ([Path(chosen) / name] if chosen else []) + [INSTALLED / name, ROOT / "build" / name]:
        if path.exists():
            return path
    if (ROOT / "Makefile").exists():
        raise FileNotFoundError(f"{ROOT / 'build' / name} is not built: run 'make all'")
    if name.startswith("firmware/"):
        raise FileNotFoundError(
            f"this installation of goldfield has no {name}, the image that emulated boards run: use host boards "
            "(--boards host), or install a wheel that 'make wheel' made in a checkout of goldfield"
        )
    raise FileNotFoundError(
        f"this installation of goldfield has no {name}, because no C compiler was there when it was built: "
        "install gcc and make, and build it again"
    )


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
    blocks = 1
    while blocks:  # Those of functions, the innermost first.
        joined, blocks = re.subn(r"(\)|\belse|\bdo)\s*\{[^{}]*\}", r"\1;", joined)
    return re.sub(r"static inline[^{;]*;", "", joined)


def load(library: str | Path, headers: Sequence[str], defines: Sequence[str] = ()) -> tuple[cffi.FFI, Any]:
    """Open a library with the declarations of its headers, which only a checkout has; see `load_built`.

    Parameters
    ----------
    library : path
        Shared library: a name that `built` finds, or a path, relative to the checkout or absolute.
    headers : sequence of str
        Header names, found on the project's include paths.
    defines : sequence of str
        Preprocessor definitions.

    Raises
    ------
    FileNotFoundError
        If the library has not been built, or needs another that is not there.
    """
    path = built(str(library)) if Path(library).name == str(library) else ROOT / library
    if not path.exists():
        raise FileNotFoundError(f"{path} is not built: run 'make all'")
    return _open(path, declarations(tuple(headers), tuple(defines)))


def load_built(library: str) -> tuple[cffi.FFI, Any]:
    """Open one of `LIBRARIES`, in a checkout and in an installation alike.

    Raises
    ------
    FileNotFoundError
        See `load`.
    """
    shipped = INSTALLED / _declarations_file(library)
    if shipped.exists():
        return _open(built(library), shipped.read_text(encoding="utf-8"))
    return load(built(library), [LIBRARIES[library]])


@cache  # cffi unloads a library when its handle goes; objects made by it may outlive the handle
def _open(path: Path, text: str) -> tuple[cffi.FFI, Any]:
    ffi = cffi.FFI()
    ffi.cdef(text)
    try:
        return ffi, ffi.dlopen(str(path))
    except OSError as error:
        raise FileNotFoundError(
            f"{path.name} cannot be loaded ({error}): what the simulator needs comes with pip install 'goldfield[sim]'"
        ) from error


def _declarations_file(library: str) -> str:
    return f"{library.removesuffix('.so')}.cdef"


def write_declarations(directory: Path) -> None:
    """Write the declarations of each of `LIBRARIES` for an installation."""
    for library, header in LIBRARIES.items():
        (directory / _declarations_file(library)).write_text(declarations((header,)), encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m hil_sim.clib DIRECTORY")
    write_declarations(Path(sys.argv[1]))
