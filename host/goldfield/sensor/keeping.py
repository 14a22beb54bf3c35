"""Keeps a sensor at what it was set to, though another host sets it too: the change is noticed, told and put back.

On CAN each host hears what another one sets, and the sensor's answer. Who sets it on its serial port, or sat before it
while the link was gone, is noticed by its reports: they have other codes than they should.
"""

from __future__ import annotations

from collections.abc import Sequence

from goldfield.errors import SystemFailure
from goldfield.link.requests import value_of
from goldfield.sensor.dialogue import BLOCKS, STRONGEST, Dialogue, Parameters, beside, suits, wanted_parameters
from goldfield.sensor.receiver import Receiver
from goldfield_protocol.messages import Message
from goldfield_protocol.parameters import PARAMETERS, label_of

ROUNDS = 5
"""Times that parameters are put back; then two hosts want different things, and each would undo the other's."""
CALM_S = 10.0
"""Time after giving up in which nothing is put back; each time twice as long. The other host may end meanwhile."""
SETTLED_S = 1.0
"""Time after which reports are of what the sensor was set to; those under way may be of what it was before."""


class Keeping:
    """Watches the parameters of one sensor.

    Parameters
    ----------
    receiver : Receiver
        It tells the user.

    Attributes
    ----------
    changes : int
        Parameters that others have changed and that were put back.
    links, links_before : int or None
        The links on which the sensor sends blocks (`BLOCKS`) by its latest word, and by its first; None: not known.
    """

    def __init__(self, receiver: Receiver) -> None:
        self.changes = 0
        self.links: int | None = None
        self.links_before: int | None = None
        self._receiver = receiver
        self._node: int | None = None
        self._wanted: dict[int, int | float] = {}
        self._changed: dict[int, int | float] = {}
        self._codes: frozenset[int] = frozenset()
        self._rounds = 0
        self._calm_s = CALM_S
        self._gave_up_s: float | None = None
        self._set_s = 0.0
        self._suspicious = False
        self._trusts = False

    def begin(self, node: int | None, codes: Sequence[int] | None, parameters: Parameters | None, now_s: float) -> None:
        """Note what a sensor is about to be set to, at a time on its own clock; codes: None if it chooses them."""
        self._node, self._codes, self._set_s = node, frozenset(codes or ()), now_s
        self._wanted = wanted_parameters(codes, parameters)
        self._changed.clear()
        self._suspicious = self._trusts = False
        self._gave_up_s = None

    @property
    def disturbed(self) -> bool:
        """Whether a parameter is to be put back, or asked for because the reports are not as they should be."""
        return bool(self._changed) or self._suspicious

    def take(self, message: Message, now_s: float) -> None:
        """Take any message of the link."""
        if self._gave_up_s is not None:
            if now_s - self._gave_up_s < self._calm_s:
                return
            self._gave_up_s, self._rounds, self._calm_s = None, 0, 2.0 * self._calm_s
        if message.name == "PARAM_SET":
            if self._wanted and message.node in (0, self._node):
                self._receiver.tell_once(f"another host sets parameters of sensor {self._node}")
        elif message.node != self._node or not self._wanted:
            return
        elif message.name == "PARAM_VALUE":
            wanted = self._wanted.get(message.index)
            if wanted is None or message.signals["status"]:
                return
            value = value_of(message.signals)
            if message.index == BLOCKS:
                self.links = int(value)
                self.links_before = self.links if self.links_before is None else self.links_before
            if suits(message.index, value, wanted):
                self._changed.pop(message.index, None)
            else:
                self._changed[message.index] = value
        elif not self._trusts and now_s - self._set_s > SETTLED_S:
            self._suspicious = self._suspicious or self._is_strange(message)

    def _is_strange(self, message: Message) -> bool:
        """Return whether a report has other codes than it should, or more where the sensor chooses them."""
        strongest, fields = self._wanted[STRONGEST], message.signals.get("fields")
        if message.name == "EPOCH_STATUS" and fields is not None:
            return fields > strongest if strongest else fields != len(self._codes)
        return message.name == "FIELD" and not strongest and message.index not in self._codes

    def put_back(self, dialogue: Dialogue, now_s: float) -> None:
        """Put back what others have changed; a sensor that does not answer is asked again at the next change."""
        if self._rounds >= ROUNDS:
            self._receiver.tell_once(
                f"another host keeps setting sensor {self._node}, and this one has put it back {ROUNDS} times: end one "
                "of them, or let it only listen"
            )
            self._changed.clear()
            self._suspicious, self._gave_up_s = False, now_s
            return
        self._set_s = now_s
        try:
            if self._suspicious:
                self._find(dialogue)
            for parameter, value in list(self._changed.items()):
                self._receiver.tell_once(
                    f"another host has set {label_of(parameter)} of sensor {self._node} to {value}: put back to "
                    f"{self._wanted[parameter]}"
                )
                dialogue.set(parameter, beside(parameter, value, self._wanted[parameter]))
                self.changes += 1
        except SystemFailure as error:
            self._receiver.tell_once(f"what another host has changed could not be put back: {error}")
            self._changed.clear()
        self._rounds += 1

    def _find(self, dialogue: Dialogue) -> None:
        """Ask what codes it is to report; `take` hears the answers. If that is as it should be, the site is not."""
        self._suspicious = False
        before = len(self._changed)
        listed = (PARAMETERS["code_count"].first, *map(PARAMETERS["code_list"].identifier, range(len(self._codes))))
        for parameter in (STRONGEST, *(one for one in listed if one in self._wanted)):
            dialogue.ask(parameter)
        self._trusts = len(self._changed) == before
