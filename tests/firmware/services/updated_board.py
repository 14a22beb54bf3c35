"""Host boards that take a new image over their serial port into slots that outlive them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tests.firmware.core.boot.slots import ADDRESSES, BOARD, CODE, Image, Node, PowerLost
from tests.firmware.host_rig import FFI, LIBRARY, MS, PIN_ENABLE, SENSOR, Board
from tests.firmware.services.saved_flash import NAMED

BEGIN, BEGIN_FORCED, PAGE, MISSING, END, TELL = range(10, 16)
OK, REFUSED, FLASH_FAILED, OK_RESTARTS = 0, 2, 4, 5
NO_IMAGE, DAMAGED, WRONG_BOARD, WRONG_ROLE, WRONG_SLOT, OLDER, NO_KEY, WRONG_SIGNATURE = range(6, 14)
UNCONFIRMED, WRONG_LENGTH = 14, 15
FIRST_BLOCK = 8
"""The blocks before hold the state words."""
BLOCK_TIME = MS // 5


class UpdatedBoard:
    """One life of a board whose image lies in the slots of a `Node`.

    Parameters
    ----------
    node : Node
        The slots, which outlive the board.
    running : int
        The slot whose image runs.
    board : Board, optional
        A host board; by default a sensor.
    """

    def __init__(self, node: Node, running: int, board: Board | None = None) -> None:
        self.node, self.running, self.lost = node, running, False
        self.board = Board(SENSOR, {"node": 9}) if board is None else board
        self.now = 20 * MS
        self.enabled: list[bool] = []
        """Whether the bridges were on at each step of the flash."""
        self._keep = [
            FFI.callback("bool(void *, uint32_t, uint32_t, uint32_t)", lambda _, s, i, v: self._step(s, i, v)),
            FFI.callback("bool(void *, uint32_t, uint32_t)", lambda _, s, n: self._step(s, None, n)),
        ]
        images = FFI.new("host_images_t *", {"program": self._keep[0], "erase": self._keep[1]})
        images.images.slot = [FFI.cast("const uint32_t *", address) for address in node.places()]
        images.images.address, images.images.words = ADDRESSES, node.flash.words
        images.images.running, images.images.board = running, BOARD
        images.images.key = FFI.cast("const uint8_t *", node.key_place())
        LIBRARY.host_board_images(self.board.handle, images)

    def _step(self, slot: int, index: int | None, value: int) -> bool:
        assert not self.lost, "a board without power touches its flash"
        self.enabled.append(bool(self.board.level.get(PIN_ENABLE)))
        try:
            self.node.carry_out(slot, index, value)
        except PowerLost:
            self.lost = True
        return not self.lost

    def run(self, ms: float) -> None:
        self.now += round(ms * MS)
        self.board.run(self.now)

    def command(self, index: int, argument: int = 0, *, named: int = NAMED, node: int = 9, ms: int = 40) -> Any:
        """Give a command, and return the status and value of its answer; None: there is none within the time."""
        told = len(self.answers(index))
        self.board.send_serial("COMMAND", {"board": named, "argument": argument}, node, index, self.now)
        self.run(ms)
        answers = self.answers(index)[told:]
        assert len(answers) <= 1
        return answers[0] if answers else None

    def answers(self, index: int) -> list[tuple[int, int]]:
        return [
            (int(m.signals["status"]), int(m.signals["value"]))
            for m in self.board.messages("COMMAND_ANSWER")
            if m.index == index
        ]

    def data(self, words: list[int], blocks: Iterable[int]) -> None:
        """Send blocks of a page."""
        for block in blocks:
            values = {"first": words[2 * block], "second": words[2 * block + 1]}
            self.board.send_serial("UPDATE_DATA", values, 9, block, self.now)
            self.now += BLOCK_TIME
        self.board.run(self.now)

    def starts(self) -> int:
        return [m.signals["state"] for m in self.board.messages("HEARTBEAT")].count(0)

    def close(self) -> None:
        self.board.close()


def blocks_of(image: Image) -> int:
    return -(-(CODE + len(image.code)) // 2)


def send(life: UpdatedBoard, image: Image, words: list[int] | None = None, *, forced: bool = False) -> Any:
    """Bring an image; return the status of its end, or of what refused it before. None: the board says nothing."""
    words = image.at(1 - life.running).words() if words is None else words
    begun = life.command(BEGIN_FORCED if forced else BEGIN, blocks_of(image))
    if begun is None or begun[0] != OK:
        return None if begun is None else begun[0]
    life.data(words, range(FIRST_BLOCK, blocks_of(image)))
    ended = life.command(END)
    return None if ended is None else ended[0]
