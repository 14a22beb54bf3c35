"""Instructions on random operands: the same results and flags on the emulator and on QEMU."""

from pathlib import Path

import pytest

from tests.hil_sim.emulator import instruction_program, oracle


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_instructions_equal_qemu(tmp_path: Path, seed: int) -> None:
    source = tmp_path / "instructions.S"
    source.write_text(instruction_program.write(seed))
    image = oracle.build(tmp_path, source)
    with oracle.load(image) as board:
        ours = oracle.run_on_emulator(board)
        executed = board.statistics().instructions
    theirs = oracle.run_on_qemu(image)
    names = instruction_program.templates()
    assert len(theirs) == len(names) > 200
    differing = [name for name, a, b in zip(names, ours, theirs, strict=True) if a != b]
    assert not differing
    assert executed > 20 * instruction_program.CASES * len(names)
    assert len(set(theirs)) > 0.9 * len(names)  # The hashes do see the operands.
