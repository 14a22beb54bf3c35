"""New images for the boards of a link, many at once: the order of the messages is that of ``framing.md``, "Updates".

Boards of one role that run the same slot take the same image together. On CAN its blocks go to all at once, each board
tells what it misses, and what any of them misses is sent again. Nothing that happens here costs a board its image: one
that is left alone restarts into the one that it had.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

from goldfield.link.access import COMMAND_LOCKED, board_of
from goldfield.link.budget import message_s
from goldfield.nodes.commissioning import Board
from goldfield.nodes.conversation import (
    DONE,
    DONE_RESTARTS,
    FLASH_FAILED,
    REFUSED,
    TRIES,
    WINDOW,
    Conversation,
)
from goldfield.update.image_files import BLOCK_BYTES, NAMES, Image
from goldfield_protocol.image import STATE_BYTES
from goldfield_protocol.messages import Message, encode

BEGIN, BEGIN_FORCED, PAGE, MISSING, END, TELL = range(10, 16)
"""Numbers of the commands, the index of ``COMMAND``."""
(NO_IMAGE, DAMAGED, WRONG_BOARD, WRONG_ROLE, WRONG_SLOT, OLDER, NO_KEY, WRONG_SIGNATURE, UNCONFIRMED, WRONG_LENGTH) = (
    range(6, 16)
)
"""What is wrong with an image, the status of ``COMMAND_ANSWER``."""
REFUSALS: Mapping[int, str] = {
    REFUSED: "is busy, or has no slots for images: wait 15 s, and try again",
    FLASH_FAILED: (
        "could not write its flash, and keeps the image that it had: its flash is worn, or its supply below 2.7 V"
    ),
    NO_IMAGE: "found no header in what came, and keeps the image that it had: make the update file anew",
    DAMAGED: "got an image of which bits have changed, and keeps the one that it had: try again",
    WRONG_BOARD: "is another kind of board than the image is for, and keeps the one that it had: give one for its kind",
    WRONG_ROLE: "has another role than the image, and keeps the one that it had: give one of its role",
    WRONG_SLOT: "got an image for the other slot, and keeps the one that it had: make the update file anew",
    OLDER: "runs a newer version than the image has, and keeps it: --force lets it go back",
    NO_KEY: (
        "has no key by which it could judge an image: program it once with a probe, make flash KEY= and the site's "
        "public key, which goldfield keys show prints"
    ),
    WRONG_SIGNATURE: (
        "refuses the signature, and keeps the image that it had: the new one is signed with another key than the "
        "board's, or was changed: sign it with the site's key"
    ),
    UNCONFIRMED: (
        "runs an image that is not confirmed, which it would need to fall back to: power it off and on, and try again"
    ),
    WRONG_LENGTH: "has no slot that is large enough for the image: give a smaller one",
}
"""Why a board takes no image, to stand behind its name; each status has a sentence of its own."""

WENT_BACK = (
    "went back to the image that it had, as the new one did not confirm itself: goldfield nodes tells of its last reset"
)
RESTARTED = "has restarted meanwhile, with the image that it had: see why with goldfield nodes, and try again"
LEFT = "does not answer any more, and keeps the image that it had: check its power and its cable, and try again"
UNHEARD = (
    "was not heard since it was to restart: check its power and its cable; a new image that hears no command goes back "
    "to the one before within 90 s"
)
NOT_STARTED = "runs the image that it had, and has not tried the new one: try again"

PAGE_BLOCKS = 1024
FIRST_BLOCK = STATE_BYTES // BLOCK_BYTES
"""The blocks before it hold what became of the image; they are never sent."""
BLOCK_S = 200e-6
"""Least time from one block to the next, s: a board programs both of its words in 0.2 ms at most."""
BURST = 32
"""Blocks that are sent together: 7 ms of waiting are as fine as a computer's clock allows, and half of what fits the
buffer of a board's serial port."""
ERASED_S = 15.0
"""Longest time in which a board empties its slot, s: three sectors of 2 s, and what its coil takes to go off."""
WAITED_S = 3.0
"""How long one board is waited for before those that are ready are told that it goes on, s: they wait 10 s for that."""
ANSWER_S, CHECKED_S, STARTED_S, CONFIRMED_S = 0.5, 2.0, 20.0, 15.0
"""Longest times for the answer to a short command, beside what all of them take on the link, the check of a whole
image, a new image's first answer, and its confirmation, s."""
PATIENCE = 12
"""Rounds without any progress after which a board that misses blocks is given up."""
POLL_S = 0.25


class State(IntEnum):
    """What became of the image in a slot (``select.h``)."""

    NONE = 0
    PENDING = 1
    TRIED = 2
    CONFIRMED = 3
    REJECTED = 4


@dataclass(frozen=True)
class Told:
    """What a board tells of its images.

    Attributes
    ----------
    slot : int
        The slot that runs.
    running, other : State
    has_key : bool
    """

    slot: int
    running: State
    other: State
    has_key: bool

    @classmethod
    def of(cls, value: int) -> Told:
        """Unpack the answer to `TELL`."""
        return cls(value & 15, State(value >> 4 & 15), State(value >> 8 & 15), bool(value >> 12 & 1))


@dataclass(frozen=True)
class Outcome:
    """What became of the update of a board: whether it is done, and what is to be said behind its name."""

    board: Board
    done: bool
    text: str


Answer = tuple[int, int]
"""Status and value of a ``COMMAND_ANSWER``."""


class Updater:
    """Brings images to boards.

    Parameters
    ----------
    conversation : Conversation
    shared : bool
        Whether a message to node 0 reaches all boards: on CAN.
    forced : bool
        Whether an image may be older than the one that runs.
    progress : callable
        Called with words that tell how far it is.
    """

    def __init__(
        self, conversation: Conversation, *, shared: bool, forced: bool, progress: Callable[[str], None]
    ) -> None:
        self._conversation = conversation
        self._shared = shared
        self._forced = forced
        self._progress = progress
        self.outcomes: list[Outcome] = []

    def tell(self, boards: Iterable[Board]) -> dict[Board, Told]:
        """Return what boards tell of their images; of those that do not there is an outcome."""
        boards = list(boards)
        answers = self._ask(boards, TELL)
        return {board: Told.of(answers[board][1]) for board in self._accepted(boards, answers)}

    def bring(self, boards: Sequence[Board], image: Image) -> None:
        """Bring an image to boards of one role that run the same slot; `outcomes` tells what became of each."""
        words = f"{image.text}, {len(boards)} board{'s' * (len(boards) != 1)}"
        self._progress(f"{words}: emptying the slot")
        begun, quarters = self._begin(boards, image), 0
        blocks = range(FIRST_BLOCK, image.blocks)
        for page in range(-(-image.blocks // PAGE_BLOCKS)):
            here = range(max(blocks.start, page * PAGE_BLOCKS), min(blocks.stop, (page + 1) * PAGE_BLOCKS))
            if begun and here:
                begun = self._send_page(begun, image, page, here)
                if quarters < 4 * (here.stop - blocks.start) // len(blocks):
                    quarters = 4 * (here.stop - blocks.start) // len(blocks)
                    self._progress(f"{words}: {25 * quarters} % sent")
        if begun:
            answers = self._ask(begun, END, seconds=CHECKED_S)
            # The answer may be lost: what such a board has done it tells when it is there again.
            unsure = [board for board in begun if answers.get(board, (REFUSED, 0))[0] == REFUSED]
            ended = self._accepted([board for board in begun if board not in unsure], answers, DONE_RESTARTS)
            self._progress(f"{words}: restarting")
            self._await_confirmation([*ended, *unsure], image)

    def refuse(self, board: Board, text: str) -> None:
        """Note why a board gets no image."""
        self._fail(board, text)

    def pause(self, seconds: float) -> None:
        """Let a time pass in which boards are listened to."""
        self._conversation.wait(_nothing, seconds)

    # ---- Steps ----

    def _begin(self, boards: Sequence[Board], image: Image) -> list[Board]:
        command = BEGIN_FORCED if self._forced else BEGIN
        answers = self._ask(boards, command, image.blocks, seconds=WAITED_S, tries=1)
        for _ in range(round(ERASED_S / WAITED_S) - 1):
            if len(answers) == len(boards):
                break
            # Who is done restarts if it hears nothing for 10 s. Nobody is asked to begin once more: it would do so.
            for board in answers:
                self._command(board.number, board_of(board.unique_id), MISSING, 0)
            answers |= self._ask(
                [b for b in boards if b not in answers], command, image.blocks, seconds=WAITED_S, tries=0
            )
        begun = self._accepted(boards, answers)
        wrong = [board for board in begun if answers[board][1] != image.header.address]
        for board in wrong:
            self._fail(board, REFUSALS[WRONG_SLOT])
        return [board for board in begun if board not in wrong]

    def _send_page(self, boards: list[Board], image: Image, page: int, blocks: Sequence[int]) -> list[Board]:
        """Send the blocks of a page until no board misses any; return the boards that have all."""
        # A board that does not know the page would take its blocks for those of the page before.
        boards = self._accepted(boards, self._ask(boards, PAGE, page, everyone=True), refused=RESTARTED)
        wanted: Sequence[int] = blocks
        least, patience = len(boards) * len(blocks), PATIENCE
        while wanted and boards:
            self._send_blocks(boards, image, wanted)
            answers = self._ask(boards, MISSING, everyone=True)
            boards = self._accepted(boards, answers, refused=RESTARTED)
            lacking = {board: answers[board][1] for board in boards if answers[board][1] >> 16}
            total = sum(value >> 16 for value in lacking.values())
            patience = PATIENCE if total < least else patience - 1
            least = min(least, total)
            if patience == 0:
                for board in lacking:
                    self._fail(board, "loses blocks again and again: check the cable, and what else is on the link")
                boards, lacking = [board for board in boards if board not in lacking], {}
            again: set[int] = set()
            for value in lacking.values():
                first, count = page * PAGE_BLOCKS + (value & 0xFFFF), value >> 16
                again |= {block for block in range(first, first + 4 * count) if block < blocks[-1] + 1}
            wanted = sorted(again)
        return boards

    def _send_blocks(self, boards: Sequence[Board], image: Image, blocks: Sequence[int]) -> None:
        nodes = [0] if self._shared else [board.number for board in boards]
        for begin in range(0, len(blocks), BURST):
            part = blocks[begin : begin + BURST]
            for block in part:
                first, second = struct.unpack_from("<II", image.data, block * BLOCK_BYTES)
                for node in nodes:
                    request = encode(
                        "UPDATE_DATA", {"first": first, "second": second}, node=node, index=block % PAGE_BLOCKS
                    )
                    self._conversation.send(*request)
            sent_s = len(nodes) * message_s(self._conversation.line, "UPDATE_DATA")
            self._conversation.wait(_nothing, len(part) * max(BLOCK_S, sent_s))

    def _await_confirmation(self, boards: Sequence[Board], image: Image) -> None:
        """Wait until boards run the image and have confirmed it; each command that they hear lets them do so."""
        started: set[Board] = set()
        left = list(boards)
        for _ in range(round((STARTED_S + CONFIRMED_S) / (POLL_S + ANSWER_S))):
            self._conversation.wait(_nothing, POLL_S)
            answers = self._ask(left, TELL, tries=1)
            for board, (status, value) in answers.items():
                if status != DONE:
                    continue  # It is about to restart.
                told = Told.of(value)
                if told.slot != image.slot:
                    self._fail(board, WENT_BACK if told.other is State.REJECTED else NOT_STARTED)
                elif told.running is State.CONFIRMED:
                    self.outcomes.append(
                        Outcome(
                            board, True, f"runs {image.role} {image.version} in slot {NAMES[image.slot]}, confirmed"
                        )
                    )
                else:
                    started.add(board)
                    continue
                left.remove(board)
            if not left:
                return
        for board in left:
            if board in started:
                self._fail(board, "runs the new image, which did not confirm itself: it goes back within a minute")
            else:
                self._fail(board, UNHEARD)

    # ---- Commands ----

    def _ask(
        self,
        boards: Sequence[Board],
        command: int,
        argument: int = 0,
        *,
        seconds: float = ANSWER_S,
        tries: int = TRIES,
        everyone: bool = False,
        unlocks: bool = True,
    ) -> dict[Board, Answer]:
        """Give boards a command and return their answers; who gives none is asked again, who is locked is unlocked.

        ``tries``: 0 waits for answers to what was asked before. ``everyone``: the command may go to all nodes at once,
        which spares a bus its messages.
        """
        found: dict[Board, Answer] = {}
        by_number = {board.number: board for board in boards}

        def take(message: Message) -> bool:
            if message.name == "COMMAND_ANSWER" and message.index == command and message.node in by_number:
                status, value = int(message.signals["status"]), int(message.signals["value"])
                late = command == PAGE and status == DONE and value != argument  # The answer to the page before.
                if not late:
                    found.setdefault(by_number[message.node], (status, value))
            return len(found) == len(by_number)

        line = self._conversation.line
        both_s = message_s(line, "COMMAND") + message_s(line, "COMMAND_ANSWER")
        for attempt in range(max(1, tries)):
            if tries == 0:
                pass  # It was asked before.
            elif everyone and self._shared and attempt == 0 and len(boards) > 1:
                self._command(0, 0, command, argument)
            else:
                for board in boards:
                    if board not in found:
                        self._command(board.number, board_of(board.unique_id), command, argument)
                        if board.number in _last_of_each_window(boards):
                            self._conversation.wait(take, max(ANSWER_S / WINDOW, WINDOW * both_s))
            if len(found) == len(boards) or self._conversation.wait(take, seconds + len(boards) * both_s):
                break
        locked = [board for board, (status, _) in found.items() if status == COMMAND_LOCKED]
        if locked and unlocks:
            for board in locked:
                self._conversation.unlock(board.number, board.unique_id)
            tries = max(1, tries)
            found |= self._ask(locked, command, argument, seconds=seconds, tries=tries, unlocks=False)
        return found

    def _command(self, node: int, board: int, command: int, argument: int) -> None:
        self._conversation.send(*encode("COMMAND", {"board": board, "argument": argument}, node=node, index=command))

    def _accepted(
        self, boards: Sequence[Board], answers: Mapping[Board, Answer], wanted: int = DONE, refused: str | None = None
    ) -> list[Board]:
        """Return the boards that have accepted a command; of the others there is an outcome.

        ``refused``: what is to be said of those that refuse the command, if it is not what that means as a rule.
        """
        accepted = []
        for board in boards:
            if board not in answers:
                self._fail(board, LEFT)
            elif answers[board][0] != wanted:
                status = answers[board][0]
                if status == REFUSED and refused is not None:
                    self._fail(board, refused)
                    continue
                self._fail(board, REFUSALS.get(status, f"refuses the update (status {status}): flash it with a probe"))
            else:
                accepted.append(board)
        return accepted

    def _fail(self, board: Board, text: str) -> None:
        self.outcomes.append(Outcome(board, False, text))


def _nothing(_: Message) -> bool:
    return False


def _last_of_each_window(boards: Sequence[Board]) -> set[int]:
    return {board.number for board in itertools.islice(boards, WINDOW - 1, None, WINDOW)}
