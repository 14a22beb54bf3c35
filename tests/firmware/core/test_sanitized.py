"""The core under the compiler's sanitizers."""

import subprocess
from pathlib import Path

import pytest

from hil_sim.clib import ROOT


@pytest.mark.parametrize("sanitizer", ["address,undefined", "thread"])
def test_sanitizers_find_nothing(tmp_path, sanitizer):
    program = tmp_path / "sanitized"
    flags = [
        "-std=c11",
        "-D_GNU_SOURCE",
        "-O1",
        "-g",
        "-pthread",
        f"-fsanitize={sanitizer}",
        "-fno-sanitize-recover=all",
    ]
    firmware = ROOT / "firmware"
    sources = [Path(__file__).with_name("sanitized.c"), *sorted(firmware.glob("core/*/*.c"))]
    sources += sorted(firmware.glob("third_party/*/*.c"))
    includes = [f"-I{ROOT / path}" for path in ("firmware", "build/protocol")]
    subprocess.run(["gcc", *flags, *includes, *map(str, sources), "-o", str(program)], check=True)
    result = subprocess.run([program], capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (0, "")
