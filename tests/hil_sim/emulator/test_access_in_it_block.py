"""What follows an IT block runs whole, whatever page the accesses of the block reach."""

from pathlib import Path

from tests.hil_sim.emulator import oracle

PAGES, ROUNDS = 6, 2
ALL_RAN, STORED = 2 + 3 + 10 + 20 + 40, 0x77


def test_nothing_behind_an_it_block_is_skipped(tmp_path: Path) -> None:
    """Unicorn would go on in the ITSTATE of an access that it asks about, as of the first access to a page.

    Which access that is depends on its table of pages, whose size follows the clock on the wall: a board beside which
    other programs ran left a loop early.
    """
    image = oracle.build(tmp_path, oracle.PROGRAMS / "it_accesses.c")
    with oracle.load(image, strict=True) as board:
        ours = oracle.run_on_emulator(board)
    assert ours == [ALL_RAN, ALL_RAN, ALL_RAN, STORED] * PAGES * ROUNDS
    assert ours == oracle.run_on_qemu(image)
