"""An emulated board does the same whatever the clock on the wall says: a loaded machine changes nothing."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil_sim import clib

STOPPED, A_SECOND_EACH_TIME = "0", "1000000000"


@pytest.fixture(scope="module")
def clock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    library = tmp_path_factory.mktemp("clock") / "wall_clock.so"
    source = Path(__file__).with_name("wall_clock.c")
    subprocess.run(["gcc", "-std=gnu11", "-O1", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    return library


def run(image: str, clock: Path, step_ns: str) -> tuple[bytes, bytes]:
    """Return what a board says in half a second, and its statistics."""
    command = ["-m", "hil_sim.emulator", str(clib.built(f"firmware/{image}.elf")), "--uart", "3", "--seconds", "0.5"]
    before = os.environ.get("LD_PRELOAD", "").split()
    environment = {**os.environ, "LD_PRELOAD": " ".join([*before, str(clock)]), "WALL_STEP_NS": step_ns}
    result = subprocess.run([sys.executable, *command, "--stats"], capture_output=True, check=True, env=environment)
    return result.stdout, result.stderr


@pytest.mark.parametrize("image", ["beacon", "sensor", "anchor"])
def test_the_clock_on_the_wall_changes_nothing(clock: Path, image: str) -> None:
    """Unicorn makes its table of pages smaller by that clock, and asks about more of them then."""
    stopped = run(image, clock, STOPPED)
    assert stopped[0]
    assert run(image, clock, A_SECOND_EACH_TIME) == stopped
