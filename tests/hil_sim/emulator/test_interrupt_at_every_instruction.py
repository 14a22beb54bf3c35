"""An interrupt after every k-th instruction leaves no trace: not in IT blocks, not in flags, not in floating point."""

from pathlib import Path

import pytest

from hil_sim.emulator import Probe
from tests.hil_sim.emulator import oracle


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return oracle.build(tmp_path_factory.mktemp("interrupted"), oracle.PROGRAMS / "interrupted.c")


@pytest.fixture(scope="module")
def truth(image: Path) -> list[int]:
    """What QEMU ends with, undisturbed."""
    notes = oracle.run_on_qemu(image)
    assert len(set(notes)) > 40
    return notes


@pytest.fixture(scope="module")
def undisturbed(image: Path, truth: list[int]) -> Probe:
    """Instructions of the workload without an interrupt."""
    with oracle.load(image) as board:
        board.probe("workload")
        assert oracle.run_on_emulator(board) == truth
        return board.probes()["workload"]


@pytest.mark.parametrize("distance", range(1, 30))
def test_interrupted(image: Path, truth: list[int], undisturbed: Probe, distance: int) -> None:
    with oracle.load(image, argument=distance) as board:
        board.probe("workload")
        assert oracle.run_on_emulator(board) == truth
        assert board.probes()["workload"] == undisturbed
        taken = oracle.word(board, "handler_count")
    # Inside an IT block an interrupt waits for up to four instructions; main() adds a few of its own.
    assert undisturbed.total / (distance + 4) < taken < (undisturbed.total + 50) / distance


def test_interrupted_without_probe(image: Path, truth: list[int]) -> None:
    """A probe makes the emulator look at each instruction; without it, only deadlines do."""
    for distance in (1, 2, 3, 5, 7, 11):
        with oracle.load(image, argument=distance) as board:
            assert oracle.run_on_emulator(board) == truth


def test_qemu_interrupted_too(image: Path, truth: list[int]) -> None:
    assert oracle.run_on_qemu(image, argument=1000) == truth
