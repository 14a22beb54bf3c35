"""The conversation with the nodes of a link: listen, read and set parameters.

Whatever arrives meanwhile goes to the `Roster`, so that nothing is missed while an answer is awaited.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping

import can

from goldfield.errors import SystemFailure
from goldfield.link.buses import BusSource
from goldfield.link.requests import ANSWER_S, UNKNOWN, Value, read_request, refusal, set_request, value_of
from goldfield.link.traffic import added
from goldfield.nodes.roster import Node, Roster, decoded
from goldfield_protocol.messages import Message, encode
from goldfield_protocol.parameters import Kind, label_of

TRIES = 3
HEARD_S = 2.2
"""Nodes send a heartbeat once a second: in this time each was heard twice."""
PATIENCE_S = 10.0
"""Longest wait for the first heartbeat."""

IDENTITY, BLINK, RESET, CLEAR, LAST_RESET, SAVE = 0, 1, 2, 3, 4, 5
"""Numbers of the commands, the index of ``COMMAND``."""
DONE, REFUSED, COIL_ON, FLASH_FAILED, DONE_RESTARTS = 0, 2, 3, 4, 5
"""What becomes of a command, the status of ``COMMAND_ANSWER``."""
REFUSALS = {
    (CLEAR, REFUSED): (
        "keeps its drive off, as the cause lasts or was met too often: see it with goldfield nodes, and mend it"
    ),
    (SAVE, REFUSED): "saves nothing, as it is about to restart: wait until it has, and try again",
    (SAVE, COIL_ON): (
        "drives its coil, and its processor stands still for each word that it saves: let it switch the coil off "
        "meanwhile, with goldfield nodes save {node} --pause"
    ),
    (SAVE, FLASH_FAILED): (
        "could not write its flash, and keeps what it had saved before: its flash is worn, or its supply below 2.7 V"
    ),
}
"""What a node says against a command, to stand behind its name."""
IDENTITY_S = 0.5
"""How long the nodes are waited for that have yet to tell their unique ids or their last resets, s."""


def board_of(unique_id: str) -> int:
    """Return what names a board in a ``COMMAND``: the exclusive or of the halves of its unique id.

    Examples
    --------
    >>> hex(board_of("0102030405060000000000ff"))
    '0xf90504030201'
    """
    whole = bytes.fromhex(unique_id)
    return int.from_bytes(whole[:6], "little") ^ int.from_bytes(whole[6:], "little")


class Tap(BusSource):
    """A live link whose messages, both ways, are told to a roster; otherwise it is that link.

    Parameters
    ----------
    link : BusSource
    """

    def __init__(self, link: BusSource) -> None:
        self.name = link.name
        self.shared, self.listen_only, self.reconnects = link.shared, link.listen_only, link.reconnects
        self.roster = Roster()
        self._link = link

    @property
    def traffic(self) -> Mapping[str, int]:
        """What the link dropped, by kind; what it handed on and is no message of a node is in the roster's count."""
        return self._link.traffic

    @property
    def others(self) -> dict[str, int]:
        """All that came and is no message of a node, by the kinds of `goldfield.link.traffic`."""
        return added(self._link.traffic, self.roster.others)

    def receive(self, timeout_s: float) -> can.Message | None:
        """Return the next message, None when none came in time."""
        raw = self._link.receive(timeout_s)
        if raw is not None:
            self.roster.take(raw, time.monotonic())
        return raw

    def send(self, identifier: int, data: bytes) -> None:
        """Send a message."""
        self.roster.sent(identifier, data, time.monotonic())
        self._link.send(identifier, data)

    def close(self) -> None:
        """Let go of the link."""
        self._link.close()


class Conversation:
    """Talks to the nodes of a link.

    Parameters
    ----------
    tap : Tap
    """

    def __init__(self, tap: Tap) -> None:
        self._tap = tap
        self.roster = tap.roster

    @property
    def name(self) -> str:
        """The link's name, for messages."""
        return self._tap.name

    def listen(self, seconds: float = HEARD_S, patience_s: float = PATIENCE_S) -> None:
        """Listen for a time, and for longer while no node has sent a heartbeat: up to ``patience_s``, s."""
        begin_s = time.monotonic()
        first_s: float | None = None
        while (now_s := time.monotonic()) < begin_s + max(seconds, patience_s):
            if first_s is None and any(node.role is not None for node in self.roster.nodes.values()):
                first_s = now_s
            if first_s is not None and now_s >= max(begin_s + seconds, first_s):
                return
            self._tap.receive(min(0.1, seconds))

    def read(self, wanted: Iterable[tuple[int, int]], tries: int = TRIES) -> dict[tuple[int, int], Value | None]:
        """Read parameters of several nodes at once.

        Parameters
        ----------
        wanted : iterable of (int, int)
            Node, and id of the parameter.
        tries : int
            How often the ones that did not answer are asked, a second each.

        Returns
        -------
        dict
            The values that were told, None for a parameter that the node does not have; who did not answer is not in
            it.
        """
        missing, found = dict.fromkeys(wanted), dict[tuple[int, int], Value | None]()
        for _ in range(tries):
            for node, parameter in missing:
                self._tap.send(*read_request(node, parameter))

            def take(message: Message) -> bool:
                key = message.node, message.index
                if message.name == "PARAM_VALUE" and key in missing:
                    unknown = message.signals["status"] == UNKNOWN
                    found[key] = None if unknown else value_of(message.signals)
                    del missing[key]
                return not missing

            if self.wait(take, ANSWER_S) or not missing:
                break
        return found

    def set(self, node: int, parameter: int, value: Value, kind: Kind) -> Value:
        """Set a parameter, and return the value that is now in force.

        Raises
        ------
        SystemFailure
            If the node does not answer, or refuses.
        """
        answers: list[Message] = []

        def take(message: Message) -> bool:
            if (message.name, message.node, message.index) == ("PARAM_VALUE", node, parameter):
                answers.append(message)
            return bool(answers)

        for _ in range(TRIES):
            self._tap.send(*set_request(node, parameter, value, kind))
            if not self.wait(take, ANSWER_S):
                continue
            refused = refusal(answers[0].signals, parameter, value)
            if refused is not None:
                raise SystemFailure(f"{self.name}: node {node} {refused}")
            return value_of(answers[0].signals)
        raise SystemFailure(
            f"{self.name}: node {node} did not answer when {label_of(parameter)} was to be set, in {TRIES} tries: see "
            "who is there with goldfield nodes"
        )

    def identities(self, node: int = 0, tries: int = TRIES) -> None:
        """Let a node, or all (0), tell the unique ids of their processors to the roster."""
        self._ask(IDENTITY, lambda one: bool(one.unique_ids), node, tries)

    def last_resets(self, tries: int = TRIES) -> None:
        """Let all nodes tell the roster why they started."""
        self._ask(LAST_RESET, lambda one: one.last_reset is not None and one.last_reset.whole, 0, tries)

    def _ask(self, command: int, told: Callable[[Node], bool], node: int, tries: int) -> None:
        """Give a command until all that are asked, or one of them, have told what it is for."""

        def known(_: Message | None = None) -> bool:
            asked = [one for one in self.roster.nodes.values() if node in (0, one.number) and one.same_protocol]
            return bool(asked) and all(told(one) for one in asked)

        for _ in range(tries):
            if not known():
                self._tap.send(*encode("COMMAND", {"board": 0, "argument": 0}, node=node, index=command))
                self.wait(known, IDENTITY_S)

    def command(self, node: int, command: int, argument: int = 0, board: str | None = None) -> int:
        """Give a node a command: `BLINK`, `RESET`, `CLEAR` what keeps its drive off, or `SAVE` its parameters.

        Parameters
        ----------
        node, command, argument : int
            ``argument``: seconds to blink; 1 lets a node that saves switch its coil off meanwhile.
        board : str, optional
            Unique id of the board that is meant, which a reset, a clear and a save must name.

        Returns
        -------
        int
            `DONE`, or `DONE_RESTARTS` if the node restarts behind it.

        Raises
        ------
        SystemFailure
            If the node does not answer, or refuses.
        """
        signals = {"board": 0 if board is None else board_of(board), "argument": argument}
        answers: list[Message] = []

        def take(message: Message) -> bool:
            if (message.name, message.node, message.index) == ("COMMAND_ANSWER", node, command):
                answers.append(message)
            return bool(answers)

        for _ in range(TRIES):
            self._tap.send(*encode("COMMAND", signals, node=node, index=command))
            if self.wait(take, ANSWER_S):
                break
        else:
            raise SystemFailure(
                f"{self.name}: node {node} did not answer in {TRIES} tries: see who is there with goldfield nodes"
            )
        status = int(answers[0].signals["status"])
        if status in (DONE, DONE_RESTARTS):
            return status
        why = REFUSALS.get((command, status), "refuses the command: flash it with this version's firmware")
        raise SystemFailure(f"{self.name}: node {node} {why.format(node=node)}")

    def wait(self, take: Callable[[Message], bool], seconds: float) -> bool:
        """Hand what comes to a function until it returns True, or the time is over; return whether it did."""
        deadline = time.monotonic() + seconds
        while (remaining := deadline - time.monotonic()) > 0.0:
            raw = self._tap.receive(remaining)
            message = None if raw is None else decoded(raw)
            if message is not None and take(message):
                return True
        return False
