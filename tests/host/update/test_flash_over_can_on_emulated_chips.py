"""``goldfield flash`` over CAN to two emulated boards at once, behind their boot loaders, to the confirmation."""

from __future__ import annotations

from pathlib import Path

import pytest

from goldfield_protocol.image import ERASED, MARK
from goldfield_protocol.parameters import build_page
from hil_sim.emulator.emulator import PARAMETER_PAGE
from tests.firmware.boards.stm32f405.boot_flash import boot_loader, flash, probed, state_of
from tests.firmware.core.boot.slots import KEY, OTHER_KEY
from tests.firmware.host_rig import MS, SENSOR, US, Board
from tests.host.update.boards_on_a_link import VirtualLink, run
from tests.host.update.test_flash_on_the_emulated_chip import signed

A, B = 0, 1
FRAME = 160 * US
NODES = (9, 10)


class ChipsLink(VirtualLink):
    """A CAN bus with the host's adapter and emulated boards.

    A frame of a board is through at the end of a step, one of the host within its turn.
    """

    shared, name, step = True, "chips", 2 * MS

    def __init__(self, keys: dict[int, object]) -> None:
        super().__init__()
        self.boards = []
        for node, key in keys.items():
            cells = flash(*boot_loader(key), probed(), (PARAMETER_PAGE, build_page({"node": node})))  # type: ignore[arg-type]
            unique_id = bytes([node, *range(1, 12)])
            self.boards.append(Board(SENSOR, {"node": node}, emulated=True, cells=cells, unique_id=unique_id))
        self.bus = 0
        self._taken = [0] * len(self.boards)
        self._advance(300 * MS)
        self._received.clear()

    def send(self, identifier: int, data: bytes) -> None:
        self.bus = max(self.bus, self.now) + FRAME
        for board in self.boards:
            board.can_in(identifier, data, self.bus)

    def _advance(self, until: int) -> None:
        for place, board in enumerate(self.boards):
            board.run(until)
            new = board.requests[self._taken[place] :]
            self._taken[place] += len(new)
            for _, mailbox, identifier, data in new:
                board.can_sent(mailbox, True, until)
                self._hear(identifier, data, until)
        self.now = until


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_two_chips_take_the_image_at_once_and_a_third_refuses_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two have the key that signed it; the third has another, and keeps the image that it had."""
    link = ChipsLink({NODES[0]: KEY, NODES[1]: KEY, 11: OTHER_KEY})
    code, out, told = run(monkeypatch, link, "flash", signed(tmp_path, capsys, KEY), "9", "10", "11")
    print(f"{link.monotonic():.1f} s from power-on to the end")
    assert code == 3
    *each, all_of_them = out.splitlines()
    assert each == [f"node {node} runs sensor 0.1.0 in slot B, confirmed; it had 0.1.0" for node in NODES]
    assert all_of_them == "2 of 3 boards updated"
    assert "node 11 refuses the signature, and keeps the image that it had" in told
    for board in link.boards[:2]:
        assert state_of(board.emulator.cells(), B)[2:] == (0, MARK, MARK, MARK, MARK)
    refused = state_of(link.boards[2].emulator.cells(), B)
    assert state_of(link.boards[2].emulator.cells(), A)[3:] == (MARK, MARK, MARK, MARK)
    assert refused[3] != MARK
    assert ERASED in refused
    for board in link.boards:
        board.close()
