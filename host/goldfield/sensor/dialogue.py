"""The dialogue with a sensor about its parameters: read, set, and made to be what a site needs."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Mapping, Sequence

import can
import numpy as np

from goldfield.errors import SystemFailure, UserError, option
from goldfield.link.access import lock_request, unlock
from goldfield.link.buses import BusSource
from goldfield.link.chips import Calibration
from goldfield.link.requests import ANSWER_S, LOCKED, read_request, refusal, set_request, value_of
from goldfield.sensor.receiver import Receiver, used_message
from goldfield_protocol.messages import Identifier, Message, decode, type_of
from goldfield_protocol.parameters import PARAMETERS, Kind, label_of

TRIES = 5
Parameters = Mapping[int, int | float]
"""Values by the parameter's id; unsigned or single precision by their type."""
BLOCKS = PARAMETERS["blocks"].first
"""Each bit of this parameter is a link, so that hosts on several links each have their own."""
STREAM = PARAMETERS["stream"].first
"""Whether the sensor streams its chips."""
STRONGEST = PARAMETERS["strongest"].first
"""How many of the strongest codes the sensor reports; 0: it reports its code list."""

ANSWER_TYPES = frozenset(type_of(name) for name in ("ACCESS", "COMMAND_ANSWER", "IDENTITY"))
"""Types of the messages with which a board answers who unlocks it."""


class Unheard(SystemFailure):
    """A board is not heard, or does not answer: one that gets its power later may."""


class Dialogue:
    """Asks one node on a bus.

    Parameters
    ----------
    receiver : Receiver
        Where the answers come from.
    bus : BusSource
        Takes the requests.
    node : int
    keeps : bool, optional
        Whether what else arrives while an answer is awaited is kept for `Receiver.put_back`; else it is lost to others.

    Attributes
    ----------
    kept : list of can.Message
    unlocked : str or None
        Unique id of the node's board once it was unlocked, because something was to be set and it was locked.
    """

    def __init__(self, receiver: Receiver, bus: BusSource, node: int, *, keeps: bool = False) -> None:
        self._receiver = receiver
        self._bus = bus
        self.node = node
        self.kept: list[can.Message] = []
        self.unlocked: str | None = None
        self._keeps = keeps

    def check_degree(self, degree: int) -> None:
        """Check that the sensor works with codes of the site's degree, which it reads once at its start.

        Raises
        ------
        UserError
            If it does not.
        SystemFailure
            If it does not answer.
        """
        own = self.ask(PARAMETERS["degree"].first)
        if own != degree:
            raise UserError(
                f"{self._sensor} works with codes of degree {own}, the site file says {degree}: "
                "correct the site's degree, or store the parameter degree in every board"
            )

    def configure(self, codes: Sequence[int] | None, parameters: Parameters | None = None) -> bool:
        """Make the sensor report these codes; tells whether anything had to be set.

        Parameters
        ----------
        codes : sequence of int or None
            The code list; None: it stays as it is.
        parameters : mapping of int to int or float, optional
            Further parameters.

        Raises
        ------
        UserError
            If there are more codes than a sensor reports.
        SystemFailure
            If the sensor does not answer or refuses.
        """
        wanted = wanted_parameters(codes, parameters)
        found = {parameter: self.ask(parameter) for parameter in wanted}
        changes = {one: value for one, value in found.items() if not suits(one, value, wanted[one])}
        for parameter, value in changes.items():
            self.set(parameter, beside(parameter, value, wanted[parameter]))
        return bool(changes)

    def calibration(self) -> Calibration:
        """Return the sensor's own calibration; `SystemFailure` if it does not answer."""
        zero = [self.ask(PARAMETERS[f"zero_{axis}"].first) for axis in "xyz"]
        matrix = [self.ask(PARAMETERS["calibration"].identifier(element)) for element in range(9)]
        return Calibration(np.array(zero, dtype=np.float64), np.array(matrix, dtype=np.float64).reshape(3, 3))

    def set(self, parameter: int, value: int | float) -> None:
        """Set a parameter; `SystemFailure` if the sensor does not answer, refuses, or keeps another value.

        It is set again if the answer tells another value, as where another host has set it at the same time.
        """
        for _ in range(TRIES):
            answer = self.ask(parameter, value)
            if answer == value:
                return
        raise SystemFailure(
            f"{self._sensor} keeps parameter {label_of(parameter)} at {answer} instead of {value}, {TRIES} times: end "
            "what else sets it"
        )

    def ask(self, parameter: int, value: int | float | None = None) -> int | float:
        """Read a parameter, or set it if a value is given, and return the sensor's answer.

        A sensor that is locked is unlocked with the link's key, until `lock`.

        Raises
        ------
        Locked
            If it is locked, and there is no key, or another one.
        SystemFailure
            If the sensor does not answer or refuses.
        """
        if value is None:
            request = read_request(self.node, parameter)
        else:
            request = set_request(
                self.node, parameter, value, Kind.FLOAT if isinstance(value, float) else Kind.UNSIGNED
            )
        for _ in range(TRIES):
            self._bus.send(*request)
            answer = self._answer(parameter)
            if answer is None:
                continue
            if int(answer["status"]) == LOCKED and self.unlocked is None:
                self.unlocked = unlock(self, self.node, None, self._bus.key)
                continue
            refused = refusal(answer, parameter, value)
            if refused is not None:
                raise SystemFailure(f"{self._sensor} {refused}")
            return value_of(answer)
        raise Unheard(f"{self._sensor} did not answer a request for parameter {label_of(parameter)} in {TRIES} tries")

    @property
    def name(self) -> str:
        """The link's name."""
        return self._receiver.name

    def send(self, identifier: int, data: bytes) -> None:
        """Send a message."""
        self._bus.send(identifier, data)

    def wait(self, take: Callable[[Message], bool], seconds: float) -> bool:
        """Hand what comes of `ANSWERS` to a function until it returns True, or the time is over; tell whether it did.

        All else is kept, or taken by who listens.
        """
        deadline = time.monotonic() + seconds
        while (remaining := deadline - time.monotonic()) > 0.0:
            raw = self._receiver.receive_raw(remaining)
            if raw is None:
                continue
            answer = Identifier.unpack(raw.arbitration_id).type in ANSWER_TYPES
            message = decode(raw.arbitration_id, bytes(raw.data)) if answer else None
            if message is not None and take(message):
                return True
            if self._keeps and not answer:
                self.kept.append(raw)
            elif not answer:
                self._receiver.decoded(raw)
        return False

    def lock(self) -> None:
        """Lock a sensor that was unlocked; no answer is awaited, as it locks itself before long."""
        if self.unlocked is not None:
            self._bus.send(*lock_request(self.unlocked))
            self.unlocked = None

    def _answer(self, parameter: int) -> Mapping[str, float] | None:
        """Return the signals of the answer, None if it does not come in time."""
        wanted = "PARAM_VALUE", self.node, parameter
        deadline = time.monotonic() + ANSWER_S
        while (remaining := deadline - time.monotonic()) > 0.0:
            raw = self._receiver.receive_raw(remaining)
            if raw is None:
                continue
            peeked = used_message(raw)
            is_answer = peeked is not None and (peeked.name, peeked.node, peeked.index) == wanted
            if self._keeps and not is_answer:
                self.kept.append(raw)
                continue
            message = self._receiver.decoded(raw)
            if message is not None and is_answer:
                return message.signals
        return None

    @property
    def _sensor(self) -> str:
        return f"{self._receiver.name}: sensor {self.node}"


def suits(parameter: int, value: int | float, wanted: int | float) -> bool:
    """Return whether a parameter's value does for what is wanted: the same, or of `BLOCKS` with other links, too."""
    return value == wanted or (parameter == BLOCKS and int(value) & int(wanted) == wanted)


def beside(parameter: int, value: int | float, wanted: int | float) -> int | float:
    """Return what to set a parameter to that has a value: what is wanted, of `BLOCKS` beside the links that it has."""
    return int(value) | int(wanted) if parameter == BLOCKS else wanted


def wanted_parameters(codes: Sequence[int] | None, parameters: Parameters | None = None) -> dict[int, int | float]:
    """Return what a sensor must have to report these codes, with further parameters: values by id, as it keeps them.

    Without codes its list stays as it is, for a sensor that chooses what it reports (`STRONGEST`).

    Raises
    ------
    UserError
        If there are more codes than a sensor reports, or one comes twice.
    """
    most = PARAMETERS["code_list"].count
    if codes is not None and len(codes) > most:
        raise UserError(
            f"the site has {len(codes)} beacons, a sensor reports {most} of a list at most: split the site, or let the "
            f"sensor choose with {option('strongest')}"
        )
    if codes is not None and len(set(codes)) < len(codes):
        raise UserError(
            "beacons of the site share codes, and a list has each code once: let the sensor choose with "
            f"{option('strongest')}"
        )
    wanted: dict[int, int | float] = {
        PARAMETERS["code_list"].identifier(place): code for place, code in enumerate(codes or ())
    }
    wanted[STRONGEST] = 0
    if codes is not None:
        wanted[PARAMETERS["code_count"].first] = len(codes)
    for parameter, value in (parameters or {}).items():
        wanted[parameter] = _single(value) if isinstance(value, float) else value
    return wanted


def _single(value: float) -> float:
    """Round to single precision, as a sensor keeps it."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])
