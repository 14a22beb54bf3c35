"""The parts of the project whose mutants are tried: where their sources and tests are, and how one becomes a mutant."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import cffi

from tests.mutants import py_runtime
from tests.mutants.c_build import OF_A_FILE, OUT, ROOT, Build, build
from tests.mutants.mutant import Mutant, with_distinct_names
from tests.mutants.plugin import Noted
from tests.mutants.py_sites import Instrumented, install

CORE_LIBRARY = "libgf_core.so"
"""The library in whose place those with mutants are loaded."""


class Part(Protocol):
    """What `run` asks of a part."""

    sources: Sequence[Path]
    """All files whose mutants are tried."""
    tests: Sequence[str]
    """Where its tests are."""
    not_tests: Sequence[str]
    """Patterns of files of tests that do not run it in their own process."""
    rewriter: str
    """The file beside this one that numbers the mutants."""
    warm: bool
    """Whether a test may run before, without a mutant: nothing that its sources compute is kept from it."""

    def mutants(self, workers: int) -> list[Mutant]:
        """Build what holds all mutants, and return them."""
        ...

    def trace(self) -> None:
        """From now on nothing acts, and `noted` tells what would."""
        ...

    def ready(self) -> None:
        """From now on `become` selects a mutant."""
        ...

    def noted(self) -> Noted:
        """Return what was noted since the last call."""
        ...

    def become(self, number: int) -> None:
        """Be this mutant."""
        ...


class Core:
    """The core of the firmware, in C, as its tests load it."""

    def __init__(self) -> None:
        self.sources = sorted((ROOT / "firmware/core").glob("*/*.[ch]"))
        self.tests = ["tests/firmware/core"]
        self.not_tests = ["*_instructions.py", "*test_sanitized.py"]
        self.rewriter, self.warm = "c_sites.py", True
        self._build: Build | None = None
        self._library = ""
        self._dlopen = cffi.FFI.dlopen

    def mutants(self, workers: int) -> list[Mutant]:
        """See `Part`."""
        self._build = build(workers)
        return self._build.mutants

    def _load(self, library: Path) -> None:
        """Let whoever loads the core through cffi get another build of it."""
        usual = self._dlopen

        def dlopen(ffi: cffi.FFI, name: Any, flags: int = 0) -> Any:
            ours = isinstance(name, str) and Path(name).name == CORE_LIBRARY
            return usual(ffi, str(library) if ours else name, flags)

        cffi.FFI.dlopen = dlopen  # type: ignore[method-assign]
        self._opened = ctypes.CDLL(str(library))

    def trace(self) -> None:
        """See `Part`."""
        assert self._build is not None
        self._load(self._build.trace)

    def ready(self) -> None:
        """See `Part`."""
        assert self._build is not None
        self._load(self._build.library)

    def noted(self) -> Noted:
        """See `Part`; the compiler has told apart what can be."""
        count = len(self.sources) * OF_A_FILE
        infected = (ctypes.c_ubyte * count).in_dll(self._opened, "gf_infected")
        raw = bytes(infected)
        ctypes.memset(infected, 0, count)
        return {"infected": [i for i, byte in enumerate(raw) if byte], "applicable": [], "empty": []}

    def become(self, number: int) -> None:
        """See `Part`."""
        ctypes.c_int.in_dll(self._opened, "gf_mutant").value = number


class Package:
    """A package of `goldfield`, in Python, as its tests import it."""

    def __init__(self, name: str) -> None:
        self.sources = sorted((ROOT / "host/goldfield" / name).glob("*.py"))
        self.tests = [f"tests/host/{name}"]
        self.not_tests: list[str] = []
        self.rewriter, self.warm = "py_sites.py", False

    def mutants(self, workers: int) -> list[Mutant]:
        """See `Part`."""
        OUT.mkdir(parents=True, exist_ok=True)
        names = {path: str(path.relative_to(ROOT)) for path in self.sources}
        modules = {
            path: Instrumented(name, path.read_text(encoding="utf-8"), i * OF_A_FILE + 1)
            for i, (path, name) in enumerate(names.items())
        }
        install(modules)
        return with_distinct_names(mutant for module in modules.values() for mutant in module.mutants)

    def trace(self) -> None:
        """See `Part`."""
        py_runtime.tracing = True

    def ready(self) -> None:
        """See `Part`."""
        py_runtime.tracing = False

    def noted(self) -> Noted:
        """See `Part`."""
        self._forget()
        sets = (py_runtime.infected, py_runtime.applicable, py_runtime.reached - py_runtime.applicable)
        told = {name: sorted(numbers) for name, numbers in zip(("infected", "applicable", "empty"), sets, strict=True)}
        for numbers in (py_runtime.infected, py_runtime.applicable, py_runtime.reached):
            numbers.clear()
        return told

    def become(self, number: int) -> None:
        """See `Part`."""
        py_runtime.mutant = number

    @staticmethod
    def _forget() -> None:
        """Empty the caches of functions: what one test had computed, the next one is to reach, too."""
        for name, module in list(sys.modules.items()):
            if name.startswith("goldfield."):
                for value in list(vars(module).values()):
                    clear = getattr(value, "cache_clear", None)
                    if callable(clear):
                        clear()


ELSEWHERE = ("access", "calibration", "field", "link", "planning", "recording", "sensor", "site", "survey", "track")
"""Packages that compute or read what others send, beside the locator."""
PARTS: dict[str, Callable[[], Part]] = {"core": Core, "locator": partial(Package, "locate")}
PARTS |= {name: partial(Package, name) for name in ELSEWHERE}
