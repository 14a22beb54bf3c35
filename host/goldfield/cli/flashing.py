"""What ``goldfield flash`` does on an open link, and how it prints it."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from goldfield.cli.node_boards import meant
from goldfield.cli.output import json_line
from goldfield.errors import SystemFailure, UserError, counted, tell
from goldfield.nodes.commissioning import Board, boards_of, refuse_driven
from goldfield.nodes.conversation import Conversation
from goldfield.update.image_files import NAMES, Image, version_number
from goldfield.update.over_link import NO_KEY, OLDER, REFUSALS, UNCONFIRMED, Outcome, State, Told, Updater


def flash(conversation: Conversation, arguments: argparse.Namespace, images: Sequence[Image], *, shared: bool) -> None:
    """Bring images to the boards that are asked for, and print what became of each.

    Raises
    ------
    UserError
        A board that is named cannot take any of the images.
    SystemFailure
        There is no such board, or one of them was not updated.
    """
    conversation.listen()
    boards = _chosen(boards_of(conversation), arguments, images)
    refuse_driven(conversation, boards, pause=arguments.pause, why="which is off during an update")
    updater = Updater(conversation, shared=shared, forced=arguments.force, progress=tell)
    before = {board: conversation.roster.nodes[board.number].version or "0.0.0" for board in boards}
    printed = _Printed(arguments.json, before)
    told = _settled(updater, boards)
    for image, group in _groups(told, images, updater, before, forced=arguments.force):
        printed.show(updater.outcomes)
        updater.bring(group, image)
    printed.show(updater.outcomes)
    failed = [outcome for outcome in updater.outcomes if not outcome.done]
    if len(boards) > 1 and not arguments.json:
        printed.line(f"{len(boards) - len(failed)} of {counted(len(boards), 'boards')} updated")
    if failed:
        which = ", ".join(str(outcome.board.number) for outcome in failed)
        raise SystemFailure(f"{conversation.name}: not updated: {counted(len(failed), 'nodes')}, {which}: see above")
    if printed.error is not None:
        raise printed.error


def _chosen(boards: Sequence[Board], arguments: argparse.Namespace, images: Sequence[Image]) -> list[Board]:
    """Return the boards that are asked for; each must be of a role for which there are images."""
    held = {image.role for image in images}
    if arguments.nodes:
        chosen = [meant(boards, number) for number in dict.fromkeys(arguments.nodes)]
    else:
        roles = held if arguments.all else {arguments.role}
        chosen = [meant(boards, board.number) for board in boards if board.role in roles]
    for board in chosen:
        if board.role not in held:
            raise UserError(
                f"{arguments.file}: holds images of {' and '.join(sorted(held))}, and node {board.number} is a "
                f"{board.role or 'board that tells no role'}: sign those of its role"
            )
    if not chosen:
        role = " or ".join(sorted(held)) if arguments.all else arguments.role
        raise SystemFailure(f"no {role} is on the link: see who is there with goldfield nodes")
    return chosen


TRIAL_S = 5.0
"""An image that has just heard its first command confirms itself within this time, s."""


def _settled(updater: Updater, boards: Sequence[Board]) -> dict[Board, Told]:
    """Return what boards tell of their images, those with a new one once it had the time to confirm itself."""
    told = updater.tell(boards)
    fresh = [board for board, one in told.items() if one.running is State.TRIED]
    if fresh:
        updater.pause(TRIAL_S)
        told |= updater.tell(fresh)
    return told


def _groups(
    told: dict[Board, Told], images: Sequence[Image], updater: Updater, before: dict[Board, str], *, forced: bool
) -> list[tuple[Image, list[Board]]]:
    """Return which boards take which image; what a board would refuse at the end is told before anything is erased."""
    groups: dict[tuple[str, int], list[Board]] = {}
    for board, one in told.items():
        wanted = [image for image in images if image.role == board.role and image.slot != one.slot]
        if not one.has_key:
            updater.refuse(board, REFUSALS[NO_KEY])
        elif one.running is not State.CONFIRMED:
            updater.refuse(board, REFUSALS[UNCONFIRMED])
        elif not wanted:
            slot = NAMES[one.slot]
            updater.refuse(board, f"runs slot {slot}, and the file has no {board.role} image for the other: sign both")
        elif wanted[0].header.version < version_number(before[board]) and not forced:
            updater.refuse(board, REFUSALS[OLDER])
        else:
            groups.setdefault((board.role or "", one.slot), []).append(board)
    return [
        (next(i for i in images if i.role == role and i.slot != slot), group) for (role, slot), group in groups.items()
    ]


class _Printed:
    """Prints outcomes, each once.

    Attributes
    ----------
    error : OSError or None
        Why a line was not written: a disk that is full, or a reader that went away, must end no update amid its boards.
    """

    def __init__(self, as_json: bool, before: dict[Board, str]) -> None:
        self._json = as_json
        self._before = before
        self._count = 0
        self.error: OSError | None = None

    def line(self, text: str) -> None:
        try:
            print(text)
        except OSError as error:
            self.error = error

    def show(self, outcomes: Sequence[Outcome]) -> None:
        for outcome in outcomes[self._count :]:
            board = outcome.board
            if self._json:
                record = {"node": board.number, "unique_id": board.unique_id, "role": board.role}
                record |= {"version_before": self._before[board], "updated": outcome.done, "text": outcome.text}
                self.line(json_line(record))
            elif outcome.done:
                self.line(f"node {board.number} {outcome.text}; it had {self._before[board]}")
            else:
                tell(f"node {board.number} {outcome.text}", failure=True)
        self._count = len(outcomes)
