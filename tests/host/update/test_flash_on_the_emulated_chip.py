"""``goldfield image sign`` and ``goldfield flash`` with the ARM images that were built, behind their boot loader."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from goldfield.cli import main
from goldfield.link.line import FASTEST, Link
from goldfield_protocol import FrameDecoder, encode_frame
from goldfield_protocol.image import MARK
from goldfield_protocol.parameters import build_page
from hil_sim.clib import ROOT
from hil_sim.emulator.emulator import PARAMETER_PAGE
from tests.firmware.boards.stm32f405.boot_flash import boot_loader, flash, probed, state_of
from tests.firmware.core.boot.slots import KEY, OTHER_KEY
from tests.firmware.host_rig import MS, SENSOR, US, Board
from tests.host.update.boards_on_a_link import VirtualLink, run

A, B = 0, 1
FRAME = 100 * US


class ChipLink(VirtualLink):
    """The serial line of an emulated board."""

    shared, line, name = False, FASTEST[Link.SERIAL], "chip"

    def __init__(self, cells: bytes) -> None:
        super().__init__()
        self.board = Board(SENSOR, {"node": 9}, emulated=True, cells=cells)
        self.busy = self.blocks = 0
        self._decoder, self._taken = FrameDecoder(), 0
        self._advance(300 * MS)

    def send(self, identifier: int, data: bytes) -> None:
        self.busy = max(self.busy, self.now)
        self.board.receive(encode_frame(identifier, data), self.busy)
        self.busy += FRAME

    def _advance(self, until: int) -> None:
        self.board.run(until)
        self.now = until
        new = self.board.serial[self._taken :]
        self._taken += len(new)
        for frame in self._decoder.feed(bytes(byte for _, byte in new)):
            self._hear(frame.identifier, frame.data, until)


def signed(tmp_path, capsys, key):
    """Return an update file of the sensor's images, signed by the command."""
    place, path = tmp_path / "site.key", tmp_path / "sensor.gfi"
    place.touch(mode=0o600)
    place.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    files = [str(ROOT / "build/firmware" / name) for name in ("sensor.elf", "slot_b/sensor.elf")]
    assert main(["image", "sign", *files, "--key", str(place), "--out", str(path)]) == 0
    capsys.readouterr()
    return str(path)


def link_to_a_new_board() -> ChipLink:
    """Return the link to a board that a probe has programmed, with the public key of `KEY`."""
    return ChipLink(flash(*boot_loader(), probed(), (PARAMETER_PAGE, build_page({"node": 9}))))


@pytest.mark.long
def test_the_chip_takes_what_is_signed_and_confirms_it(tmp_path, capsys, monkeypatch):
    link = link_to_a_new_board()
    code, out, told = run(monkeypatch, link, "flash", signed(tmp_path, capsys, KEY), "9")
    print(f"{link.monotonic():.1f} s from power-on to the confirmation")
    assert (code, out) == (0, "node 9 runs sensor 0.1.0 in slot B, confirmed; it had 0.1.0\n"), told
    assert "25 % sent" in told
    assert state_of(link.board.emulator.cells(), B)[2:] == (0, MARK, MARK, MARK, MARK)
    link.board.close()


@pytest.mark.slow
def test_the_chip_refuses_what_another_key_has_signed(tmp_path, capsys, monkeypatch):
    link = link_to_a_new_board()
    code, out, told = run(monkeypatch, link, "flash", signed(tmp_path, capsys, OTHER_KEY), "9")
    assert (code, out) == (3, "")
    assert "node 9 refuses the signature, and keeps the image that it had" in told
    assert state_of(link.board.emulator.cells(), A)[3:] == (MARK, MARK, MARK, MARK)
    assert state_of(link.board.emulator.cells(), B)[3] != MARK
    link.board.close()
