"""``python -m hil_sim.emulator``: output, statistics, fault report, bad input."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.hil_sim.emulator import oracle


def command(*arguments: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run([sys.executable, "-m", "hil_sim.emulator", *arguments], capture_output=True, check=False)


@pytest.fixture(scope="module")
def printer(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("printer"), oracle.PROGRAMS / "printer.c")


def test_bytes_and_statistics(printer: Path) -> None:
    result = command(str(printer), "--seconds", "0.01", "--uart", "1", "--stats", "--probe", "main")
    assert (result.returncode, result.stdout) == (0, b"hello")
    counts = json.loads(result.stderr)
    assert counts["cycles"] == 160_000
    assert counts["violations"] == 0
    assert counts["sleep_share"] == pytest.approx(counts["sleep_cycles"] / counts["cycles"])
    assert counts["probes"]["main"]["calls"] == 1


def test_another_port_is_silent(printer: Path) -> None:
    result = command(str(printer), "--seconds", "0.01", "--uart", "2")
    assert (result.returncode, result.stdout, result.stderr) == (0, b"", b"")


def test_fault_report(tmp_path: Path) -> None:
    source = tmp_path / "crash.c"
    source.write_text(f'#define CRASH\n#include "{oracle.PROGRAMS / "printer.c"}"\n')
    image = oracle.build(tmp_path, source)
    result = command(str(image), "--seconds", "1", "--uart", "1")
    report = result.stderr.decode()
    assert (result.returncode, result.stdout) == (3, b"hello")
    for part in (
        "PC 0x",
        "LR 0x",
        "CFSR 0x",
        "undefined instruction",
        "last peripheral access: 4-byte read of 0x40011000",
    ):
        assert part in report


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(None, "cannot be read"), (b"not an image", "is not an ELF image"), (b"\x7fELF", "is not an ELF image")],
)
def test_bad_image_is_one_sentence(tmp_path: Path, content: bytes | None, sentence: str) -> None:
    image = tmp_path / "image.elf"
    if content is not None:
        image.write_bytes(content)
    result = command(str(image), "--seconds", "1", "--uart", "1")
    assert result.returncode == 2
    assert sentence in result.stderr.decode()
    assert result.stderr.count(b"\n") == 1


def test_image_for_another_address(printer: Path) -> None:
    result = command(str(printer.parent / "program.elf"))
    assert result.returncode == 2
    assert b"outside of the flash" in result.stderr


def test_bad_parameter_page(printer: Path) -> None:
    result = command(str(printer), "--parameters", str(printer.parent / "nowhere"))
    assert result.returncode == 2
    assert b"cannot be read" in result.stderr
