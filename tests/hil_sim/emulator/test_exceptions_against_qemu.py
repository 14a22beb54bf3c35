"""Exceptions: the same program notes the same states on the emulator and on QEMU."""

from pathlib import Path

from tests.hil_sim.emulator import oracle


def test_exceptions_equal_qemu(tmp_path: Path) -> None:
    image = oracle.build(tmp_path, oracle.PROGRAMS / "exceptions.c")
    with oracle.load(image) as board:
        ours = oracle.run_on_emulator(board)
        interrupts = board.statistics().interrupts
    theirs = oracle.run_on_qemu(image)
    assert [hex(value) for value in ours] == [hex(value) for value in theirs]
    assert len(theirs) > 150
    assert interrupts > 40
