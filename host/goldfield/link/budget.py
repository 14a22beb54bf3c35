"""What a link carries of a sensor: chips, sums of blocks of 31 chips, or whole cycles only.

Every length is that of the messages in the DBC: on CAN with the most stuff bits that a frame can have, on serial with
the bytes that framing adds. Real frames of CAN have fewer stuff bits, and take 80 to 90 % of that.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from goldfield.errors import counted
from goldfield.link.blocks import BLOCK_CHIPS
from goldfield.link.buses import CAN_BIT_RATE
from goldfield.link.serial_bus import BAUD_RATE
from goldfield_protocol.messages import database
from goldfield_protocol.parameters import PARAMETERS


class Link(StrEnum):
    """The two links that a board has."""

    SERIAL = "serial"
    CAN = "CAN"


class Carrier(StrEnum):
    """What carries the field from the sensor to the host."""

    BLOCKS = "blocks"
    """`BLOCK` and `BLOCK_SUM`: a pose every 31 chips."""
    CHIPS = "chips"
    """`CHIP`: every sample, from which the host makes the same."""
    CYCLES = "cycles"
    """`EPOCH` and `FIELD`: a pose every cycle, always sent."""


SHARE = {Link.SERIAL: 0.9, Link.CAN: 0.75}
"""Largest part of a link that one sensor may take: on CAN beacons, answers and repeated frames need the rest."""
LINK_BITS = {Link.SERIAL: 1, Link.CAN: 2}
"""Values of the parameter ``blocks``."""
NAMES = {Link.SERIAL: f"serial at {BAUD_RATE / 1e6:g} Mbaud", Link.CAN: f"CAN at {CAN_BIT_RATE / 1e6:g} Mbit/s"}


def message_s(link: Link, name: str) -> float:
    """Return the longest time that a message takes on a link, s, with the pause behind it.

    Examples
    --------
    >>> [round(1e6 * message_s(link, "BLOCK")) for link in Link]
    [80, 160]
    """
    length = database().get_message_by_name(name).length
    if link is Link.SERIAL:
        code_and_delimiter = 2  # COBS adds a byte to frames of this size
        return 10 * (4 + length + 2 + code_and_delimiter) / BAUD_RATE
    stuffed = 39 + 8 * length + 15  # from the start of the frame to the end of its CRC
    delimiters_and_pause = 1 + 2 + 7 + 3
    return (stuffed + (stuffed - 1) // 4 + delimiters_and_pause) / CAN_BIT_RATE


def load(link: Link, carrier: Carrier, codes: int, chips: int, chip_s: float) -> float:
    """Return the part of a link that a sensor takes with its reports of so many codes, at most.

    Parameters
    ----------
    link : Link
    carrier : Carrier
        What is sent besides the cycles.
    codes : int
        Codes that are reported.
    chips : int
        Chips in a cycle.
    chip_s : float
        Length of a chip, s.
    """
    headers = sum(message_s(link, name) for name in ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET"))
    cycles = (headers + codes * message_s(link, "FIELD")) / (chips * chip_s)
    if carrier is Carrier.BLOCKS:
        return cycles + block_s(link, codes) / (BLOCK_CHIPS * chip_s)
    return cycles + (message_s(link, "CHIP") / chip_s if carrier is Carrier.CHIPS else 0.0)


def block_s(link: Link, codes: int) -> float:
    """Return the longest time that the messages of a block take, s: from its first byte to its last."""
    return message_s(link, "BLOCK") + codes * message_s(link, "BLOCK_SUM")


@dataclass(frozen=True)
class Choice:
    """What a sensor is to send on a link.

    Attributes
    ----------
    carrier : Carrier
    load : float
        The part of the link that it takes, at most.
    text : str
        What was chosen and why, without a full stop.
    """

    carrier: Carrier
    load: float
    text: str
    link: Link

    @property
    def parameters(self) -> Mapping[int, int]:
        """The parameters, by id, that make the sensor send it; none for cycles, which it always sends."""
        if self.carrier is Carrier.BLOCKS:
            return {PARAMETERS["blocks"].first: LINK_BITS[self.link]}
        return {PARAMETERS["stream"].first: 1} if self.carrier is Carrier.CHIPS else {}


def choose(link: Link, codes: int, chips: int, chip_s: float, sensors: int = 1) -> Choice:
    """Choose what the sensors on a link are to send: blocks where they fit, else chips, else cycles only.

    Parameters
    ----------
    link : Link
    codes, chips, chip_s
        As in `load`.
    sensors : int, optional
        Sensors that share the link and all send the same; a serial line has one.

    Examples
    --------
    >>> print(choose(Link.CAN, 8, 1023, 97.75e-6).text)
    sums of 8 codes 330 times a second, at most 49 % of CAN at 1 Mbit/s
    >>> print(choose(Link.CAN, 20, 1023, 97.75e-6).text)
    whole cycles, 10 a second: sums of 20 codes 330 times a second would take 115 % of CAN at 1 Mbit/s, more than 75 %
    >>> print(choose(Link.SERIAL, 40, 1023, 97.75e-6).text)
    every chip, at most 85 % of serial at 2 Mbaud: sums of 40 codes 330 times a second would take 112 %
    """

    def taken(carrier: Carrier) -> float:
        return sensors * load(link, carrier, codes, chips, chip_s)

    blocks, streamed = taken(Carrier.BLOCKS), taken(Carrier.CHIPS)
    sums = f"sums of {counted(codes, 'codes')} {1.0 / (BLOCK_CHIPS * chip_s):.0f} times a second"
    of_sensors = "" if sensors == 1 else f" of {sensors} sensors"
    if blocks <= SHARE[link]:
        text = f"{sums}{of_sensors}, at most {blocks:.0%} of {NAMES[link]}"
        return Choice(Carrier.BLOCKS, blocks, _spaced(text), link)
    if link is Link.SERIAL and streamed <= SHARE[link]:
        text = f"every chip, at most {streamed:.0%} of {NAMES[link]}: {sums} would take {blocks:.0%}"
        return Choice(Carrier.CHIPS, streamed, _spaced(text), link)
    rate = f"{1.0 / (chips * chip_s):.0f} a second"
    text = f"whole cycles, {rate}: {sums}{of_sensors} would take {blocks:.0%} of {NAMES[link]}"
    return Choice(Carrier.CYCLES, taken(Carrier.CYCLES), _spaced(f"{text}, more than {SHARE[link]:.0%}"), link)


def _spaced(text: str) -> str:
    return text.replace("%", " %")


TABLE_CODES = (1, 4, 8, 12, 16, 24, 32, 64)


def table(chips: int = 1023, chip_s: float = 97.75e-6) -> str:
    """Return the budget of both links as a table in Markdown, for the usual codes (`protocol/framing.md`)."""
    lines = [
        "| codes | serial: cycles | with blocks | with chips | a block, ms | CAN: cycles | with blocks | a block, ms |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for codes in TABLE_CODES:
        cells = [str(codes)]
        for link, carriers in (
            (Link.SERIAL, (Carrier.CYCLES, Carrier.BLOCKS, Carrier.CHIPS)),
            (Link.CAN, (Carrier.CYCLES, Carrier.BLOCKS)),
        ):
            cells += [f"{100.0 * load(link, carrier, codes, chips, chip_s):.1f} %" for carrier in carriers]
            cells.append(f"{1e3 * block_s(link, codes):.2f}")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(table(), end="")
