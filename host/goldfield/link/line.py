"""The two links that a board has, each at one of its bit rates."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from goldfield.errors import UserError, option
from goldfield_protocol.rates import CAN_RATES, SERIAL_RATES


class Link(StrEnum):
    """The two links that a board has."""

    SERIAL = "serial"
    CAN = "CAN"


RATES = {Link.SERIAL: SERIAL_RATES, Link.CAN: CAN_RATES}
"""Bits a second at which boards speak, by the value of their parameter; they leave the works with the first."""
PARAMETER = {Link.SERIAL: "serial_rate", Link.CAN: "can_rate"}
"""Names of the parameters that choose among them."""
VIRTUAL_OF_KERNEL = ("vcan", "vxcan")
"""How names of a kernel's CAN interfaces begin that have no bit rate, by custom: those of their kinds."""


@dataclass(frozen=True)
class Line:
    """A link at its bit rate.

    Attributes
    ----------
    link : Link
    bit_rate : int
        Bits a second.

    Examples
    --------
    >>> print(Line(Link.CAN, 1_000_000), Line(Link.CAN, 125_000), sep=", ")
    CAN at 1 Mbit/s, CAN at 125 kbit/s
    >>> print(Line(Link.SERIAL, 2_000_000), Line(Link.SERIAL, 115_200), sep=", ")
    serial at 2 Mbaud, serial at 115,200 baud
    """

    link: Link
    bit_rate: int

    def __str__(self) -> str:
        """Return the words that name it."""
        if self.bit_rate >= 1_000_000:
            return f"{self.link} at {self.bit_rate / 1e6:g} {'Mbit/s' if self.link is Link.CAN else 'Mbaud'}"
        kilobits = f"{self.bit_rate / 1e3:g} kbit/s"
        return f"{self.link} at {kilobits if self.link is Link.CAN else f'{self.bit_rate:,} baud'}"


FASTEST = {link: Line(link, rates[0]) for link, rates in RATES.items()}
"""The links as boards have them from the works."""


def checked_rate(link: Link, bit_rate: int) -> int:
    """Return a bit rate at which boards speak on a link.

    Raises
    ------
    UserError
        If it is none.

    Examples
    --------
    >>> checked_rate(Link.CAN, 115_200)
    Traceback (most recent call last):
    goldfield.errors.UserError: bit_rate=115200: boards speak on CAN at 1000000, 500000, 250000 or 125000 bit/s
    """
    if bit_rate not in RATES[link]:
        *rates, last = RATES[link]
        unit = "bit/s" if link is Link.CAN else "baud"
        told = f"{', '.join(map(str, rates))} or {last} {unit}"
        raise UserError(f"{option('bit_rate', bit_rate)}: boards speak on {link} at {told}")
    return bit_rate
