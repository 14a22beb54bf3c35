"""The models under the processor: one bare-metal program (programs/peripherals.c), no driver of the project."""

import subprocess
from itertools import pairwise
from pathlib import Path

import pytest

from hil_sim.emulator import Configuration, Emulator

PROGRAMS = Path(__file__).parent / "programs"
MILLISECOND = 1_000_000_000
LED, SIGN = 44, 45


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("peripherals") / "flash.elf"
    flags = ["-mcpu=cortex-m4", "-mthumb", "-O1", "-nostdlib", "-ffreestanding", "-Wl,--build-id=none"]
    linking = ["-Wl,--defsym=LOAD_OFFSET=0x08000000", "-T", str(PROGRAMS / "program.ld")]
    sources = [str(PROGRAMS / "peripherals.c"), "-lgcc"]
    subprocess.run(["arm-none-eabi-gcc", *flags, *linking, "-o", str(output), *sources], check=True)
    return output


@pytest.mark.parametrize("ppm", [0.0, 30.0])
def test_whole_way(image: Path, ppm: float) -> None:
    sent: list[tuple[int, int]] = []
    pins: list[tuple[int, bool, int]] = []
    with Emulator(
        image,
        Configuration(crystal_ppm=ppm),
        uart_out=lambda uart, byte, time: sent.append((byte, time)),
        pin_out=lambda pin, level, time: pins.append((pin, level, time)),
    ) as board:
        assert board.run(30 * MILLISECOND), board.report()
        assert board.statistics().violations == 0, board.report()
    scale = 1 + ppm * 1e-6
    # Nothing is connected to the converters: 0 V, 24 results, one a byte time, without gaps.
    assert [byte for byte, _ in sent] == [0] * 24
    gaps = [b[1] - a[1] for a, b in pairwise(sent)]
    assert all(abs(gap - 5_000_000 / scale) <= 2 for gap in gaps)
    # The compare interrupt comes every 100 us; the processor answers with the same delay, to a few instructions.
    # Its first edge is the pin becoming an output, its last may be the reset that takes it back.
    led = [time for pin, _, time in pins if pin == LED][1:-1]
    assert len(led) > 50
    assert all(abs(b - a - 100_000_000 / scale) < 1_000_000 for a, b in pairwise(led) if b - a < 2e8)
    # The watchdog's reset, 10 ms after its start; the program finds the flag and raises the sign.
    low, high = (time for pin, _, time in pins if pin == SIGN)
    assert low < high < 20 * MILLISECOND
    assert led[-1] < low
    assert 9.5 * MILLISECOND < low - sent[0][1] < 10.5 * MILLISECOND
