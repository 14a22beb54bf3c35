"""Code that a program writes into its RAM runs as it was last written, though stores into RAM are not looked at."""

from pathlib import Path

from tests.hil_sim.emulator import oracle

PAGES = 6


def notes_of_a_round(first: int) -> list[int]:
    """Each page's code in its three versions, the data beside it (word 9 is the version, word 8 holds 8), and all."""
    values = [[first + 3 * page + version for version in range(3)] for page in range(PAGES)]
    return [note for page in values for note in [*page, 2 + 8]] + [page[-1] for page in values]


def test_written_code_equals_qemu(tmp_path: Path) -> None:
    image = oracle.build(tmp_path, oracle.PROGRAMS / "written_code.c")
    with oracle.load(image) as board:
        ours = oracle.run_on_emulator(board)
    assert ours == [*notes_of_a_round(1), 0, *notes_of_a_round(101)]
    assert ours == oracle.run_on_qemu(image)
