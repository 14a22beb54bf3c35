"""Raw samples of a live sensor: whole cycles of the sum field, calibrated, for any way to tell beacons apart."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator

import numpy as np

from goldfield.errors import SystemFailure
from goldfield.link.chips import Calibration, ChipAssembler
from goldfield.sensor.dialogue import Dialogue
from goldfield.sensor.session import Session
from goldfield.site import Site
from goldfield.types import FloatArray
from goldfield_protocol.messages import decode
from goldfield_protocol.parameters import PARAMETERS

SILENCE_S = 10.0
WAIT_S = 0.5


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
        If no sensor is heard, or it does not answer, or sends no sample for `SILENCE_S`.
    UserError
        If a node speaks another protocol, or the sensor works with codes of another degree than the site's.
    """
    session.find()
    dialogue = session.dialogue
    dialogue.check_degree(site.degree)
    calibration = _calibration(dialogue)
    stream = PARAMETERS["stream"].first
    before = dialogue.ask(stream)
    dialogue.ask(stream, 1)
    try:
        yield from _cycles(session, ChipAssembler(site.chips), calibration)
    finally:
        dialogue.ask(stream, before)


def _calibration(dialogue: Dialogue) -> Calibration:
    zero = [dialogue.ask(PARAMETERS[f"zero_{axis}"].first) for axis in "xyz"]
    matrix = [dialogue.ask(PARAMETERS["calibration"].identifier(element)) for element in range(9)]
    return Calibration(np.array(zero, dtype=np.float64), np.array(matrix, dtype=np.float64).reshape(3, 3))


def _cycles(session: Session, assembler: ChipAssembler, calibration: Calibration) -> Iterator[FloatArray]:
    silent_s = 0.0
    while True:
        begin_s = time.monotonic()
        raw = session.receiver.receive_raw(WAIT_S)
        message = None if raw is None else decode(raw.arbitration_id, bytes(raw.data))
        if message is not None and message.node == session.node and message.name == "CHIP":
            silent_s = 0.0
            for sums in assembler.feed(message):
                yield calibration.field_T(sums)
            continue
        silent_s += min(time.monotonic() - begin_s, WAIT_S)  # this process may have been stopped meanwhile
        if silent_s > SILENCE_S:
            raise SystemFailure(f"{session.name}: sensor {session.node} sent no raw chip for {SILENCE_S:.0f} s")
