"""A sensor is found: by its heartbeat on a live link, by the beginning of a recording."""

from __future__ import annotations

import time

import can

from goldfield.errors import counted
from goldfield.link.marks import is_mark, reads
from goldfield.sensor.census import Census, Place
from goldfield.sensor.dialogue import Unheard
from goldfield.sensor.receiver import Receiver

SILENCE_S = 10.0
"""Silence of a live link, or of the sensor that is read, which ends what reads it."""
PATIENCE_S = 30.0
"""Longest wait for a heartbeat of the sensor while others are heard. Heartbeats come once a second, but simulated
boards may run slower than the wall clock."""
LOOK_AROUND_S = 1.2
"""How long a bus that others share is listened to once a sensor was heard: each board has then sent a heartbeat."""
LOOKED_AT = 5000
"""Most messages of a recording that are looked at for sensors: a second of fifty boards."""
LOOKED_THROUGH = 200_000
"""Most messages that a recording may have before the mark from which on its sensor is read: forty seconds of them."""
WAIT_S = 0.5
"""Longest wait for one message while a sensor is looked for. A wait counts for no more, however long it took: this
process, or the whole computer, may have been stopped meanwhile."""


def find_live(receiver: Receiver, name: str, census: Census, *, alone: bool) -> Place:
    """Wait for a live sensor; what is received meanwhile is received once more by whoever reads on.

    Parameters
    ----------
    receiver : Receiver
    name : str
        The link's name, for error messages.
    census : Census
        Takes what is heard, and says which sensor it is.
    alone : bool
        Whether the first sensor that is heard is the one, so that nobody looks around for others.

    Returns
    -------
    Place

    Raises
    ------
    Unheard
        If nothing is heard for `SILENCE_S`, or no sensor within `PATIENCE_S`.
    UserError
        If there are several sensors to choose from.
    """
    kept: list[can.Message] = []
    silent_s = waited_s = around_s = 0.0
    while silent_s < SILENCE_S and waited_s < PATIENCE_S and around_s < LOOK_AROUND_S:
        begin_s = time.monotonic()
        raw = receiver.receive_raw(WAIT_S)
        step_s = min(time.monotonic() - begin_s, WAIT_S)
        if raw is not None:
            kept.append(raw)
        silent_s = silent_s + step_s if raw is None or census.take(raw) is None else 0.0
        waited_s += step_s
        if census.found and alone:
            break
        around_s += step_s if census.found or census.refused else 0.0
    place = census.choose(name)
    if place is None:
        for raw in kept:
            receiver.decoded(raw)  # which counts what is none of ours
        raise Unheard(_nothing_found(receiver, name, census, waited_s))
    receiver.put_back(kept)
    return place


def look_through(receiver: Receiver, census: Census) -> None:
    """Let a census take the beginning of a recording, which is then received once more by whoever reads on."""
    kept: list[can.Message] = []
    first_s: float | None = None
    paused: can.Message | None = None
    begun = False
    while len(kept) < (LOOKED_AT if paused is None else LOOKED_THROUGH):
        raw = receiver.receive_raw(0.0)
        if raw is None:
            break
        kept.append(raw)
        if is_mark(raw):
            paused, begun = None if begun or reads(raw) else raw, begun or reads(raw)
            continue
        message = census.take(raw)
        if message is not None and message.name == "EPOCH" and paused is None:
            first_s = raw.timestamp if first_s is None else first_s
            if raw.timestamp - first_s > LOOK_AROUND_S:
                break
    if paused is not None:  # the run ended before it read anything: what it heard is read all the same
        kept.remove(paused)
    receiver.put_back(kept)


def _nothing_found(receiver: Receiver, name: str, census: Census, waited_s: float) -> str:
    wanted = "a sensor" if census.node is None else f"sensor {census.node}"
    others = [counted(count, kind) for kind, count in receiver.traffic.items() if count]
    if census.heard:
        what = f"heard only {', '.join(sorted(census.heard)[:4])}"
    elif others:
        what = f"heard only {', '.join(others)}: check the wiring and that nothing else uses the link"
    else:
        what = "heard nothing: check the power, the cable and the port"
    return f"{name}: no heartbeat of {wanted} in {waited_s:.0f} s; {what}"
