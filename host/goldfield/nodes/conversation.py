"""The conversation with the nodes of a link: listen, read and set parameters.

Whatever arrives meanwhile goes to the `Roster`, so that nothing is missed while an answer is awaited.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping

from goldfield.errors import SystemFailure, UserError, listed
from goldfield.link.access import COMMAND_LOCKED, board_of, is_locked, unlock
from goldfield.link.access_key import AccessKey
from goldfield.link.budget import message_s
from goldfield.link.line import RATES, Line, Link
from goldfield.link.requests import ANSWER_S, UNKNOWN, Value, read_request, refusal, set_request, value_of
from goldfield.nodes.roster import IDENTITY as IDENTITY_NAME
from goldfield.nodes.roster import decoded
from goldfield.nodes.tap import Tap
from goldfield_protocol.messages import Message, encode
from goldfield_protocol.parameters import Kind, find_id, label_of

TRIES = 3
HEARD_S = 2.2
"""Nodes send a heartbeat once a second: in this time each was heard twice."""
PATIENCE_S = 10.0
"""Longest wait for the first heartbeat."""

WINDOW = 24
"""Requests that wait for their answers at a time: so many frames fit the queues of an adapter, a bus and a board."""
IDENTITY, BLINK, RESET, CLEAR, LAST_RESET, SAVE, START, STOP, SIGNATURE, NUMBER = range(10)
"""Numbers of the commands, the index of ``COMMAND``."""
ALL_GROUPS = 65535
"""The argument of `START` and `STOP` that means the boards of all groups."""
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
    (START, REFUSED): (
        "is not started: it was not commissioned, as its amplitude is 0, or it is a sensor: give it its part of a site "
        "with goldfield site push"
    ),
    (SIGNATURE, REFUSED): "shows no signature, as its coil is not driven: start it with goldfield nodes start {node}",
    (NUMBER, REFUSED): "takes no such number: give one from 1 to 4095",
    (SAVE, FLASH_FAILED): (
        "could not write its flash, and keeps what it had saved before: its flash is worn, or its supply below 2.7 V"
    ),
}
"""What a node says against a command, to stand behind its name."""
BROADCAST_S = 0.18
"""How long the answers of all nodes to one message are waited for, s, beside what `SPREAD` takes on the link."""
LAST_RESETS_S = 0.38
"""The same for the nodes that have yet to tell their last resets."""
SPREAD = 800
"""Messages for whose time the answers of all nodes are waited for: each board answers at a time of its own within that
of 400, and the other 400 are the two frames of 200 boards. At 1 Mbit/s they take 0.13 s."""


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

    @property
    def line(self) -> Line:
        """What the link is, and at which rate."""
        return self._tap.line

    @property
    def virtual(self) -> bool:
        """Whether the link has no bit rate of its own."""
        return self._tap.virtual

    def set_bit_rate(self, bit_rate: int) -> None:
        """Open the link anew at another rate, as `Tap.set_bit_rate` does it."""
        self._tap.set_bit_rate(bit_rate)

    @property
    def key(self) -> AccessKey | None:
        """The key with which boards are unlocked."""
        return self._tap.key

    @key.setter
    def key(self, key: AccessKey | None) -> None:
        self._tap.key = key

    def unlock(self, node: int, unique_id: str | None = None) -> None:
        """Unlock a board, as `goldfield.link.access.unlock` does it."""
        self._tap.unlocked.add(unlock(self, node, unique_id, self.key))

    def lock(self) -> None:
        """Lock what was unlocked."""
        self._tap.lock()

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

    def send(self, identifier: int, data: bytes) -> None:
        """Send a message that nobody answers, or whose answers are taken by `wait`."""
        self._tap.send(identifier, data)

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
        answers = self.exchange({key: read_request(*key) for key in wanted}, "PARAM_VALUE", tries)
        return {
            key: None if answer.signals["status"] == UNKNOWN else value_of(answer.signals)
            for key, answer in answers.items()
        }

    def write(self, wanted: Mapping[tuple[int, int], Value]) -> None:
        """Set parameters of several nodes at once: values by node and id of the parameter.

        Raises
        ------
        UserError
            If two boards are known to have the number of one of the nodes: both would be set. Nothing is set then.
        SystemFailure
            If a node does not answer, or refuses.
        """
        self._check_alone(node for node, _ in wanted)
        requests = {}
        for (node, parameter), value in wanted.items():
            found = find_id(parameter)
            assert found is not None
            requests[node, parameter] = set_request(node, parameter, value, found[0].kind)
        answers = self.exchange(requests, "PARAM_VALUE")
        for (node, parameter), value in wanted.items():
            answer = answers.get((node, parameter))
            if answer is None:
                raise self._silent(node, f"when {label_of(parameter)} was to be set, ")
            refused = refusal(answer.signals, parameter, value)
            if refused is not None:
                raise SystemFailure(f"{self.name}: node {node} {refused}")

    def exchange(
        self,
        requests: Mapping[tuple[int, int], tuple[int, bytes]],
        answer: str,
        tries: int = TRIES,
        boards: Mapping[int, str | None] | None = None,
    ) -> dict[tuple[int, int], Message]:
        """Send requests, `WINDOW` at a time, and return the answers to them; what got none is sent again.

        A board that is locked is unlocked, and gets its requests again.

        Parameters
        ----------
        requests : mapping
            Identifier and data by the node and the index of the answer.
        answer : str
            Name of the message that answers.
        tries : int
            How often a request is sent; an answer is waited for `ANSWER_S`.
        boards : mapping of int to str or None, optional
            Unique ids of the boards that are meant, by the node, where two may share one.

        Raises
        ------
        Locked
            If a board is locked, and there is no key, or another one.
        """
        found = self._exchange(requests, answer, tries)
        locked = {key for key, message in found.items() if is_locked(message)}
        if locked:
            for node in sorted({node for node, _ in locked}):
                self.unlock(node, (boards or {}).get(node))
            found |= self._exchange({key: requests[key] for key in locked}, answer, tries)
        return found

    def _exchange(
        self, requests: Mapping[tuple[int, int], tuple[int, bytes]], answer: str, tries: int
    ) -> dict[tuple[int, int], Message]:
        """Send requests and return the answers, whatever they say."""
        found: dict[tuple[int, int], Message] = {}
        for _ in range(tries):
            missing = [key for key in requests if key not in found]
            for begin in range(0, len(missing), WINDOW):
                left = {key for key in missing[begin : begin + WINDOW] if key not in found}
                for key in left:
                    self._tap.send(*requests[key])

                def take(message: Message, left: set[tuple[int, int]] = left) -> bool:
                    key = message.node, message.index
                    if message.name == answer and key in requests:
                        found.setdefault(key, message)
                        left.discard(key)
                    return not left

                if left:
                    self.wait(take, ANSWER_S)
            if len(found) == len(requests):
                break
        return found

    def _check_alone(self, nodes: Iterable[int]) -> None:
        for node in sorted(set(nodes)):
            known = self.roster.nodes.get(node)
            if known is not None and len(known.unique_ids) > 1:
                raise UserError(
                    f"node {node} is {listed(known.unique_ids)}, and what is set by its number is set in both: give "
                    "each its own number first, with goldfield nodes assign"
                )

    def _silent(self, node: int, what: str = "") -> SystemFailure:
        return SystemFailure(
            f"{self.name}: node {node} did not answer {what}in {TRIES} tries: see who is there with goldfield nodes"
        )

    def set(self, node: int, parameter: int, value: Value, kind: Kind) -> Value:
        """Set a parameter, and return the value that is now in force.

        Raises
        ------
        UserError
            If two boards are known to have the node's number: both would be set.
        SystemFailure
            If the node does not answer, or refuses.
        """
        self._check_alone([node])
        key = node, parameter
        answer = self.exchange({key: set_request(node, parameter, value, kind)}, "PARAM_VALUE").get(key)
        if answer is None:
            raise self._silent(node, f"when {label_of(parameter)} was to be set, ")
        refused = refusal(answer.signals, parameter, value)
        if refused is not None:
            raise SystemFailure(f"{self.name}: node {node} {refused}")
        return value_of(answer.signals)

    def _all_s(self, least_s: float) -> float:
        """Return how long the answers of all nodes are waited for, s."""
        on_can = self.line if self.line.link is Link.CAN else Line(Link.CAN, RATES[Link.CAN][-1])  # it may have any
        return least_s + SPREAD * message_s(on_can, IDENTITY_NAME)

    def discover(self) -> list[tuple[str, int]]:
        """Return the unique id and the number of every board, in the order of the ids, those that share a number, too.

        All are asked again until two rounds in a row have brought nobody new.
        """
        for node in self.roster.nodes.values():
            node.halves.clear()

        def alone(_: Message) -> bool:
            """Whether the one board of a serial line has answered."""
            whole = any(node.unique_ids for node in self.roster.nodes.values())
            return whole and self.line.link is Link.SERIAL

        quiet, known = 0, 0
        while quiet < 2:
            self._tap.send(*encode("COMMAND", {"board": 0, "argument": 0}, node=0, index=IDENTITY))
            self.wait(alone, self._all_s(BROADCAST_S))
            found = [(unique_id, node.number) for node in self.roster.nodes.values() for unique_id in node.unique_ids]
            quiet = quiet + 1 if len(found) == known else 0
            known = len(found)
        return sorted(found)

    def last_resets(self, tries: int = TRIES) -> None:
        """Let all nodes tell the roster why they started."""

        def known(_: Message | None = None) -> bool:
            told = [one.last_reset for one in self.roster.nodes.values() if one.same_protocol]
            return bool(told) and all(reset is not None and reset.whole for reset in told)

        for _ in range(tries):
            if not known():
                self._tap.send(*encode("COMMAND", {"board": 0, "argument": 0}, node=0, index=LAST_RESET))
                self.wait(known, self._all_s(LAST_RESETS_S))

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
        (status,) = self.commands({node: (argument, board)}, command).values()
        return status

    def try_command(self, node: int, command: int, argument: int, board: str) -> int | None:
        """Give a board a command that it may refuse, and return its status; None if it does not answer."""
        signals = {"board": board_of(board), "argument": argument}
        request = encode("COMMAND", signals, node=node, index=command)
        answers = self.exchange({(node, command): request}, "COMMAND_ANSWER", boards={node: board})
        answer = answers.get((node, command))
        return None if answer is None else int(answer.signals["status"])

    def commands(self, wanted: Mapping[int, tuple[int, str | None]], command: int) -> dict[int, int]:
        """Give several nodes a command at once.

        Parameters
        ----------
        wanted : mapping of int to (int, str or None)
            Argument, and unique id of the board that is meant, by the node.
        command : int

        Returns
        -------
        dict of int to int
            `DONE` or `DONE_RESTARTS` by the node.

        Raises
        ------
        SystemFailure
            If a node does not answer, or refuses.
        """
        requests = {
            (node, command): encode(
                "COMMAND",
                {"board": 0 if board is None else board_of(board), "argument": argument},
                node=node,
                index=command,
            )
            for node, (argument, board) in wanted.items()
        }
        boards = {node: board for node, (_, board) in wanted.items()}
        answers = self.exchange(requests, "COMMAND_ANSWER", boards=boards)
        done = {}
        for node in wanted:
            answer = answers.get((node, command))
            if answer is None:
                raise self._silent(node)
            status = int(answer.signals["status"])
            if status not in (DONE, DONE_RESTARTS):
                why = REFUSALS.get((command, status), "refuses the command: flash it with this version's firmware")
                raise SystemFailure(f"{self.name}: node {node} {why.format(node=node)}")
            done[node] = status
        return done

    def broadcast(self, command: int, argument: int) -> dict[int, int]:
        """Give all nodes a command, and return the statuses of those that answered, by the node.

        A board that has carried a start or a stop out does so again when it is asked again: each is sent twice. Boards
        that are locked are unlocked, and all are asked once more.

        Raises
        ------
        Locked
            If a board is locked, and there is no key, or another one.
        """
        told = self._broadcast(command, argument)
        locked = [node for node, status in told.items() if status == COMMAND_LOCKED]
        if locked:
            for node in sorted(locked):
                self.unlock(node)
            told |= self._broadcast(command, argument)
        return told

    def _broadcast(self, command: int, argument: int) -> dict[int, int]:
        told: dict[int, int] = {}

        def take(message: Message) -> bool:
            if message.name == "COMMAND_ANSWER" and message.index == command:
                told[message.node] = int(message.signals["status"])
            return bool(told) and self.line.link is Link.SERIAL  # which has one board

        for _ in range(2):
            self._tap.send(*encode("COMMAND", {"board": 0, "argument": argument}, node=0, index=command))
            self.wait(take, self._all_s(BROADCAST_S))
        return told

    def wait(self, take: Callable[[Message], bool], seconds: float) -> bool:
        """Hand what comes to a function until it returns True, or the time is over; return whether it did."""
        deadline = time.monotonic() + seconds
        while (remaining := deadline - time.monotonic()) > 0.0:
            raw = self._tap.receive(remaining)
            message = None if raw is None else decoded(raw)
            if message is not None and take(message):
                return True
        return False
