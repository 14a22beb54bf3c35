"""What the doctor says: checks that are sound, faults with what to do, and what could not be judged."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Fault(StrEnum):
    """What can be wrong."""

    INSTALLATION = "installation"
    """A part of goldfield is missing or cannot be loaded."""
    PERMISSION = "permission"
    """This user may not open the port."""
    LINK = "link"
    """The port or the bus cannot be opened, is silent, or loses messages."""
    BAUD = "baud"
    """Bytes arrive at another rate, or of something that is no sensor."""
    FIRMWARE = "firmware"
    """A board speaks another protocol."""
    NO_SENSOR = "no_sensor"
    """No sensor is on the link."""
    NUMBERS = "numbers"
    """Two boards have one number."""
    HOSTS = "hosts"
    """Another host speaks to the boards."""
    MASTERS = "masters"
    """There is not exactly one sync master."""
    CLOCK = "clock"
    """A clock is not locked, or a board runs without its crystal."""
    CODE = "code"
    """A board drives a code that the site file does not give to it."""
    OFF = "off"
    """A beacon is off: no power, no amplitude, no field."""
    DRIVE = "drive"
    """A beacon's coil or driver is faulty."""
    CURRENT = "current"
    """A current, or the strength of a field, is not that of the site file."""
    REVERSED = "reversed"
    """A coil is reversed."""
    AXES = "axes"
    """The sensor's axes are swapped, reversed, dead or of another gain."""
    BEACON = "beacon"
    """A beacon is not where or not how the site file says."""
    SITE = "site"
    """The site file is not that of this room."""
    SENSOR = "sensor"
    """The sensor loses samples, or its converters saturate."""


class State(StrEnum):
    """How a check came out."""

    SOUND = "sound"
    WRONG = "wrong"
    UNJUDGED = "unjudged"
    """It could not be judged, for a reason that the text tells; that is no fault."""


@dataclass(frozen=True)
class Check:
    """One thing that was looked at.

    Attributes
    ----------
    subject : str
        What was looked at, in a word or two, as "clock" or "beacon b3".
    state : State
    text : str
        What was found.
    advice : str
        What to do; empty unless something is wrong.
    fault : Fault or None
        What is wrong; None unless something is.
    nodes : tuple of int
        Numbers of the boards that it is about.
    beacons : tuple of str
        Ids of the beacons that it is about.
    """

    subject: str
    state: State
    text: str
    advice: str = ""
    fault: Fault | None = None
    nodes: tuple[int, ...] = ()
    beacons: tuple[str, ...] = ()


def sound(subject: str, text: str) -> Check:
    """Return a check that found nothing wrong."""
    return Check(subject, State.SOUND, text)


def unjudged(subject: str, text: str) -> Check:
    """Return a check that could not be made, with the reason."""
    return Check(subject, State.UNJUDGED, text)


def wrong(
    fault: Fault,
    subject: str,
    text: str,
    advice: str,
    *,
    nodes: tuple[int, ...] = (),
    beacons: tuple[str, ...] = (),
) -> Check:
    """Return a fault with what to do about it."""
    return Check(subject, State.WRONG, text, advice, fault, nodes, beacons)
