"""The core under the compiler's sanitizers."""

import subprocess
from pathlib import Path

import pytest

from hil_sim.clib import ROOT
from tests.objects import SANITIZED, objects

THREADS = ("-std=c11", "-D_GNU_SOURCE", "-O1", "-g", "-fsanitize=thread", "-fno-sanitize-recover=all")


@pytest.mark.parametrize(
    ("name", "flags"),
    [("sanitized.c", SANITIZED), ("sanitized.c", THREADS), ("sanitized_track.c", SANITIZED)],
    ids=["address,undefined", "thread", "track"],
)
def test_sanitizers_find_nothing(tmp_path, name, flags):
    program = tmp_path / "sanitized"
    firmware = ROOT / "firmware"
    sources = [Path(__file__).with_name(name), *sorted(firmware.glob("core/*/*.c"))]
    sources += sorted(firmware.glob("third_party/*/*.c"))
    subprocess.run(["gcc", *flags, "-pthread", *objects(sources, flags), "-lm", "-o", str(program)], check=True)
    result = subprocess.run([program], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")
