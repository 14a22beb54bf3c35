"""All boards of a link brought to another bit rate, or none of them.

A board reads its rate at its start. So each is given the new one, and nothing has happened yet; then all save it at
once, and all are reset at once. A board that must erase flash to save restarts by itself, a quarter of a second after
it was asked: all the others have saved by then. Whatever fails before the reset is undone; from then on power off and
on brings all boards to the new rate.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from contextlib import suppress

from goldfield.errors import SystemFailure, UserError, counted, listed, tell
from goldfield.link.access import board_of
from goldfield.link.budget import message_s
from goldfield.link.line import PARAMETER, RATES, checked_rate
from goldfield.link.requests import ANSWER_S, Value
from goldfield.nodes.commissioning import RESTART_S, Board, refuse_driven
from goldfield.nodes.conversation import (
    DONE,
    DONE_RESTARTS,
    REFUSALS,
    REFUSED,
    RESET,
    SAVE,
    TRIES,
    WINDOW,
    Conversation,
)
from goldfield_protocol.messages import Message, encode
from goldfield_protocol.parameters import PARAMETERS

NOTHING = "nothing was changed"


class Change:
    """A change of the bit rate under way.

    Parameters
    ----------
    conversation : Conversation
    boards : sequence of Board
        All boards of the link.
    bit_rate : int
    pause : bool
        Whether coils may be switched off while boards save.

    Attributes
    ----------
    old_rate : int
        The link's rate at the begin.
    """

    def __init__(self, conversation: Conversation, boards: Sequence[Board], bit_rate: int, *, pause: bool) -> None:
        self._conversation, self._boards, self._pause = conversation, boards, pause
        self.bit_rate, self.old_rate = bit_rate, conversation.line.bit_rate
        self._rates, name = RATES[conversation.line.link], PARAMETER[conversation.line.link]
        self._index = self._rates.index(checked_rate(conversation.line.link, bit_rate))
        self._parameter = PARAMETERS[name].first
        self._ids = {board.number: board.unique_id for board in sorted(boards, key=lambda board: board.number)}
        self._before: dict[int, Value] = {}
        self._saves: dict[int, int | None] = {}
        """What boards that were asked to save have answered; None: nothing."""

    def prepare(self) -> None:
        """Let all boards save the new rate; if any of them does not, all have the old one again.

        Raises
        ------
        UserError
            If two boards share a number, or the link is one of a simulated bench, at whose rate no board would be heard
            any more.
        SystemFailure
            If a board does not take the rate, or does not save it: it is named.
        """
        self._check_all()
        refuse_driven(self._conversation, self._boards, pause=self._pause)
        self._before = self._told()
        try:
            self._conversation.write({(number, self._parameter): self._index for number in self._ids})
            self._save(self._ids)
        except BaseException as error:  # an interrupt, too, must not leave some boards at another rate
            end = self._undone()
            if isinstance(error, SystemFailure):
                raise SystemFailure(f"{error}; {end}") from error
            self._tell_broken_off(end)
            raise

    def reset(self) -> None:
        """Reset the boards that have not restarted yet; who does not answer may have done it."""
        try:
            self._command(RESET, 0, set(self._ids) - self._restarted)
        except BaseException:
            self._tell_broken_off(f"all boards have saved {self.bit_rate} bit/s: power them off and on")
            raise

    def heard(self) -> list[int]:
        """Open the link at the new rate, and return the numbers of the boards that are heard.

        Raises
        ------
        UserError
            If this program cannot set the link's rate.
        """
        conversation = self._conversation
        if conversation.line.bit_rate != self.bit_rate:
            conversation.set_bit_rate(self.bit_rate)
        nodes = conversation.roster.nodes

        def there() -> list[int]:
            at_rate = conversation.line.bit_rate == self.bit_rate  # a serial port finds that of the board
            return [number for number in self._ids if at_rate and number in nodes and nodes[number].role is not None]

        if len(there()) < len(self._ids):
            conversation.wait(lambda _: len(there()) == len(self._ids), RESTART_S)
        return there()

    @property
    def _restarted(self) -> set[int]:
        """The boards that have restarted as they saved."""
        return {number for number, status in self._saves.items() if status == DONE_RESTARTS}

    # ---- Before anything is changed ----

    def _check_all(self) -> None:
        name, nodes = self._conversation.name, self._conversation.roster.nodes
        if self._conversation.virtual:
            raise UserError(
                f"{name}: is a virtual link, and those of a simulated bench keep the rates of its scenario: begin the "
                f"bench anew with others in its [links]; {NOTHING}"
            )
        numbers = [board.number for board in self._boards]
        shared = sorted({number for number in numbers if numbers.count(number) > 1})
        if shared:
            raise UserError(f"node {shared[0]} is two boards: give each its own number with goldfield nodes assign")
        for number, node in sorted(nodes.items()):
            if not node.same_protocol:
                raise SystemFailure(f"{name}: node {number} speaks another protocol: flash it first; {NOTHING}")
            if number not in self._ids:
                raise SystemFailure(
                    f"{name}: node {number} is heard, and does not tell its unique id: power it off and on; {NOTHING}"
                )

    def _told(self) -> dict[int, Value]:
        """Return the values that boards have; `SystemFailure` if one does not tell it."""
        told = self._conversation.read((number, self._parameter) for number in self._ids)
        found: dict[int, Value] = {}
        for number in self._ids:
            value = told.get((number, self._parameter))
            if value is None:
                known = (number, self._parameter) in told
                why = "has no other rate: flash it with this version's firmware" if known else "does not answer"
                raise SystemFailure(f"{self._conversation.name}: node {number} {why}; {NOTHING}")
            found[number] = value
        return found

    # ---- All at once ----

    def _save(self, numbers: Collection[int]) -> None:
        """Let boards save; `SystemFailure` names one that does not."""
        self._saves = dict.fromkeys(numbers)
        self._saves |= self._command(SAVE, int(self._pause), numbers)
        for number, status in self._saves.items():
            if status not in (DONE, DONE_RESTARTS):
                why = "does not answer" if status is None else REFUSALS.get((SAVE, status), "does not save")
                raise SystemFailure(f"{self._conversation.name}: node {number} {why.format(node=number)}")

    def _command(self, command: int, argument: int, numbers: Collection[int]) -> dict[int, int]:
        """Give boards a command, all before the first answer is awaited, and return their answers."""
        told: dict[int, int] = {}
        line = self._conversation.line
        both_s = message_s(line, "COMMAND") + message_s(line, "COMMAND_ANSWER")

        def take(message: Message) -> bool:
            if message.name == "COMMAND_ANSWER" and message.index == command and message.node in numbers:
                told[message.node] = int(message.signals["status"])
            return len(told) == len(numbers)

        for _ in range(TRIES):
            for place, number in enumerate(sorted(set(numbers) - set(told)), start=1):
                signals = {"board": board_of(self._ids[number]), "argument": argument}
                self._conversation.send(*encode("COMMAND", signals, node=number, index=command))
                if place % WINDOW == 0:
                    self._conversation.wait(take, WINDOW * both_s)
            if len(told) == len(numbers) or self._conversation.wait(take, ANSWER_S):
                break
        return told

    # ---- Back again ----

    def _undone(self) -> str:
        """Set all back, and return what has become of them; of what is broken off in its turn nothing is known."""
        try:
            return self._end(self._set_back())
        except BaseException:
            self._tell_broken_off(self._end(list(self._ids)))
            raise

    def _tell_broken_off(self, end: str) -> None:
        tell(f"{self._conversation.name}: broken off; {end}", failure=True)

    def _set_back(self) -> list[int]:
        """Give all boards the rate that they had, saved where need be; return the numbers of those that may lack it."""
        restarted = self._restarted
        left = self._give_back(set(self._ids) - restarted)
        if restarted:  # At the new rate, where they are spoken to.
            try:
                self._conversation.set_bit_rate(self.bit_rate)
                self._conversation.wait(lambda _: restarted <= set(self._conversation.roster.nodes), RESTART_S)
                left += self._give_back(restarted)
                self._command(RESET, 0, restarted - set(left))
                self._conversation.set_bit_rate(self.old_rate)
            except (UserError, SystemFailure):
                left += restarted
        return sorted(set(left))

    def _give_back(self, numbers: Collection[int]) -> list[int]:
        """Give boards that speak at one rate their old one; return the numbers of those that may have saved another."""
        kept = {number for number in numbers if self._saves.get(number, REFUSED) in (None, DONE, DONE_RESTARTS)}
        given = set()
        for number in sorted(numbers):
            with suppress(SystemFailure):
                self._conversation.write({(number, self._parameter): self._before[number]})
                given.add(number)
        told = self._command(SAVE, int(self._pause), kept & given) if kept & given else {}
        return [number for number in kept if told.get(number) not in (DONE, DONE_RESTARTS)]

    def _end(self, left: Sequence[int]) -> str:
        if not left:
            return NOTHING
        return (
            f"{counted(len(left), 'nodes')}, {listed(left)}, may speak at {self.bit_rate} bit/s after the next reset: "
            f"look for them there, and set all back to {self.old_rate} with goldfield nodes bit-rate"
        )
