"""The corpora without a fuzzer: each harness runs over its files, those of the core under the sanitizers of gcc."""

from __future__ import annotations

import importlib
import subprocess
from pathlib import Path

import pytest

from hil_sim.clib import ROOT
from tests.objects import INCLUDES, SANITIZED, objects

HERE = Path(__file__).parent
CORE = sorted(path.stem for path in (HERE / "core").glob("*.c") if path.stem != "standalone")
HOST = sorted(path.stem for path in (HERE / "host").glob("[a-z]*.py") if path.stem != "judging")
BOARD = ("services", "apps", "boards/host")
"""What the harness of a whole board takes beside the core."""
STRICT = ["-Wall", "-Wextra", "-Wconversion", "-Wsign-conversion", "-Wshadow", "-Werror"]


def corpus(target: str) -> list[Path]:
    """Return the files of a target."""
    return sorted((HERE / "corpus" / target).iterdir())


def test_every_harness_has_a_corpus_and_every_corpus_a_harness() -> None:
    """Nothing is left over, and none is empty."""
    there = {f"{side.name}/{target.name}" for side in (HERE / "corpus").iterdir() for target in side.iterdir()}
    assert there == {f"core/{name}" for name in CORE} | {f"host/{name}" for name in HOST}
    assert all(len(corpus(target)) >= 2 for target in there)


def test_the_core_holds_over_its_corpora(tmp_path: Path) -> None:
    """The core is compiled once; what fails names the file and the line that does not hold."""
    firmware = ROOT / "firmware"
    sources = [*sorted(firmware.glob("core/*/*.c")), *sorted(firmware.glob("third_party/*/*.c"))]
    sources += [ROOT / "build" / "protocol" / "goldfield.c", HERE / "core" / "standalone.c"]
    core = objects(sources)
    board = objects(path for part in BOARD for path in sorted(firmware.glob(f"{part}/*.c")))
    for name in CORE:
        program, harness = tmp_path / f"run_{name}", HERE / "core" / f"{name}.c"
        parts = [str(harness), *core, *(board if name == "board" else [])]
        flags = [*SANITIZED, *STRICT, *INCLUDES, f"-I{HERE / 'core'}"]
        subprocess.run(["gcc", *flags, *parts, "-lm", "-o", str(program)], check=True)
        run = subprocess.run([program, *corpus(f"core/{name}")], capture_output=True, text=True)
        assert run.returncode == 0, f"{name}: {run.stderr[-3000:]}"
        assert run.stderr.count("\n") == len(corpus(f"core/{name}"))


@pytest.mark.parametrize("name", HOST)
def test_the_host_holds_over_its_corpora(name: str) -> None:
    """Every error but the project's own with its sentence goes through."""
    harness = importlib.import_module(f"tests.fuzz.host.{name}")
    for path in corpus(f"host/{name}"):
        harness.one_input(path.read_bytes())
