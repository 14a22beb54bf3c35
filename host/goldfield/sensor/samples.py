"""Raw samples of a live sensor: whole cycles of the sum field, calibrated, for any way to tell beacons apart."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator

import numpy as np

from goldfield.errors import SystemFailure, UserError
from goldfield.link.budget import SHARE, Carrier, load
from goldfield.link.chips import Calibration, ChipAssembler
from goldfield.link.heartbeat import STATE_STARTING
from goldfield.link.line import FASTEST, Link
from goldfield.sensor.awaiting import until_heard
from goldfield.sensor.dialogue import STREAM
from goldfield.sensor.finding import SILENCE_S, WAIT_S
from goldfield.sensor.options import MOST_STRONGEST
from goldfield.sensor.session import Session
from goldfield.site import Site
from goldfield.types import FloatArray
from goldfield_protocol.messages import Message, decode
from goldfield_protocol.parameters import PARAMETERS


def sample_cycles(session: Session, site: Site) -> Generator[FloatArray]:
    """Find the sensor and yield cycles of samples without end; it streams them until the generator is closed.

    Parameters
    ----------
    session : Session
        A live one.
    site : Site

    Yields
    ------
    samples_T : ndarray, shape (N, 3)
        One row a chip from chip 0, sensor's frame; NaN where a sample is missing.

    Raises
    ------
    SystemFailure
        If no sensor is heard, or it does not answer, or sends no sample for `SILENCE_S`, and is not waited for.
    UserError
        If a node speaks another protocol, the sensor works with codes of another degree than the site's, or the link
        does not carry all samples.
    """

    def begun() -> tuple[Calibration, _Stream]:
        session.find()
        _check_line(session, site)
        return _calibration(session, site), _Stream(session)

    calibration, stream = until_heard(begun, awaits=session.waits)
    try:
        yield from _cycles(stream, ChipAssembler(site.chips), calibration)
    finally:
        stream.end()


def _check_line(session: Session, site: Site) -> None:
    line = session.line
    if line is None:
        return
    codes = min(len(site.codes), MOST_STRONGEST)
    part, most = load(line, Carrier.CHIPS, codes, site.chips, site.chip_period_s), SHARE[line.link]
    if part > most:
        fastest = FASTEST[Link.SERIAL].bit_rate
        told = f"{session.name}: the samples take {part:.0%} of {line}, more than {most:.0%}".replace("%", " %")
        raise UserError(f"{told}: let the board speak faster, with goldfield nodes bit-rate {fastest}")


def _calibration(session: Session, site: Site) -> Calibration:
    """Return the sensor's own calibration; where it is only listened to, that of a sensor without one."""
    if session.talks:
        session.dialogue.check_degree(site.degree)
        return session.dialogue.calibration()
    session.receiver.tell_once(
        "the sensor is only listened to, so its calibration is unknown: that of the parameters' defaults is taken"
    )
    zero = [PARAMETERS[f"zero_{axis}"].default[0] for axis in "xyz"]
    matrix = list(PARAMETERS["calibration"].default)
    return Calibration(np.array(zero, dtype=np.float64), np.array(matrix, dtype=np.float64).reshape(3, 3))


class _Stream:
    """The stream of raw chips: switched on, and on again where the sensor may have forgotten it; at the end as before.

    A sensor that is only listened to is left as it is: it streams if that is stored in it, or another host has set it.
    """

    def __init__(self, session: Session) -> None:
        self.session = session
        self._reconnections = session.reconnections
        self._before = session.dialogue.ask(STREAM) if session.talks else None
        self.begin()

    def begin(self) -> None:
        """Switch it on."""
        if self._before is not None:
            self._set(1)

    def _set(self, value: int | float) -> None:
        """Set it, and lock a sensor that was unlocked for it."""
        dialogue = self.session.dialogue
        dialogue.ask(STREAM, value)
        dialogue.lock()

    def take(self, message: Message) -> None:
        """Take any message of the sensor, which may tell that it has restarted or is back after the link was gone."""
        reconnections, self._reconnections = self._reconnections, self.session.reconnections
        started = message.name == "HEARTBEAT" and message.signals["state"] == STATE_STARTING
        if started or reconnections != self._reconnections:
            self.begin_again()

    def begin_again(self) -> None:
        """Switch it on; a sensor that does not answer yet is tried again later."""
        try:
            self.begin()
        except SystemFailure as error:
            if not self.session.waits:
                raise
            self.session.receiver.tell_once(f"the sensor's samples could not be switched on: {error}")

    def end(self) -> None:
        """Leave the sensor as it was found."""
        if self._before is not None:
            self._set(self._before)


def _cycles(stream: _Stream, assembler: ChipAssembler, calibration: Calibration) -> Iterator[FloatArray]:
    session, silent_s = stream.session, 0.0
    while True:
        begin_s = time.monotonic()
        raw = session.receiver.receive_raw(WAIT_S)
        message = None if raw is None else decode(raw.arbitration_id, bytes(raw.data))
        if message is not None and message.node == session.node:
            stream.take(message)
            if message.name == "CHIP":
                silent_s = 0.0
                for sums in assembler.feed(message):
                    yield calibration.field_T(sums)
                continue
        silent_s += min(time.monotonic() - begin_s, WAIT_S)  # this process may have been stopped meanwhile
        if silent_s > SILENCE_S:
            text = f"sensor {session.node} sent no raw chip for {SILENCE_S:.0f} s"
            if not session.waits:
                raise SystemFailure(f"{session.name}: {text}")
            session.receiver.tell_once(f"{text}; waiting for it")
            silent_s = 0.0
            stream.begin_again()
