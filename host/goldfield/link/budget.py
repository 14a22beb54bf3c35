"""What a link carries of a sensor: chips, sums of blocks of 31 chips, or whole cycles only.

Every length is that of the messages in the DBC: on CAN with the most stuff bits that a frame can have, on serial with
the bytes that framing adds. Real frames of CAN have fewer stuff bits, and take 80 to 90 % of that.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from goldfield.errors import counted
from goldfield.link.blocks import BLOCK_CHIPS
from goldfield.link.buses import CAN_BIT_RATE
from goldfield.link.reports import ON_SENSOR_POSE
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
"""Largest part of a link that its sensors may take: on CAN beacons, answers and repeated frames need the rest. All that
send blocks, or poses of blocks, divide it evenly, and leave some out if need be (firmware/core/link/bus_share.h)."""
MOST_CODES_ON_CAN = 60
"""Most codes of a block that a sensor sends on CAN: with it the report of a cycle must fit into its queue."""
LEAST_HZ = 30.0
"""Fewest blocks a second that are asked for on CAN: three of the 33 in a cycle, the fewest that were tried."""
LINK_BITS = {Link.SERIAL: 1, Link.CAN: 2}
"""Values of the parameter ``blocks``."""
RATES = {Link.SERIAL: (115_200, 921_600, BAUD_RATE), Link.CAN: (125_000, 500_000, CAN_BIT_RATE)}
"""Bits a second that the tables tell of. The last are those of the boards, which have no others; slower ones are those
of what passes their messages on, a bridge or an adapter."""
NAMES = {Link.SERIAL: f"serial at {BAUD_RATE / 1e6:g} Mbaud", Link.CAN: f"CAN at {CAN_BIT_RATE / 1e6:g} Mbit/s"}


def message_s(link: Link, name: str, rate: int | None = None) -> float:
    """Return the longest time that a message takes on a link, s, with the pause behind it.

    Parameters
    ----------
    link : Link
    name : str
    rate : int, optional
        Bits a second, in place of those of the boards.

    Examples
    --------
    >>> [round(1e6 * message_s(link, "BLOCK")) for link in Link]
    [80, 160]
    """
    length = database().get_message_by_name(name).length
    if link is Link.SERIAL:
        code_and_delimiter = 2  # COBS adds a byte to frames of this size
        return 10 * (4 + length + 2 + code_and_delimiter) / (rate or BAUD_RATE)
    stuffed = 39 + 8 * length + 15  # from the start of the frame to the end of its CRC
    delimiters_and_pause = 1 + 2 + 7 + 3
    return (stuffed + (stuffed - 1) // 4 + delimiters_and_pause) / (rate or CAN_BIT_RATE)


def load(link: Link, carrier: Carrier, codes: int, chips: int, chip_s: float, rate: int | None = None) -> float:
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
    rate : int, optional
        Bits a second, in place of those of the boards.
    """
    headers = sum(message_s(link, name, rate) for name in ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET"))
    cycles = (headers + codes * message_s(link, "FIELD", rate)) / (chips * chip_s)
    if carrier is Carrier.BLOCKS:
        return cycles + block_s(link, codes, rate) / (BLOCK_CHIPS * chip_s)
    return cycles + (message_s(link, "CHIP", rate) / chip_s if carrier is Carrier.CHIPS else 0.0)


def most_reported(link: Link, codes: int, chips: int, chip_s: float, sensors: int = 1, rate: int | None = None) -> int:
    """Return how many codes, up to so many, each of the sensors on a link can report in every cycle; 0: not even one.

    Examples
    --------
    >>> [most_reported(Link.CAN, 64, 1023, 97.75e-6, rate=rate) for rate in (125_000, 500_000, 1_000_000)]
    [55, 64, 64]
    >>> [most_reported(Link.SERIAL, 64, 1023, 97.75e-6, rate=rate) for rate in (115_200, 921_600)]
    [61, 64]
    """
    fitting = (
        count
        for count in range(codes, 0, -1)
        if sensors * load(link, Carrier.CYCLES, count, chips, chip_s, rate) <= SHARE[link]
    )
    return next(fitting, 0)


def block_s(link: Link, codes: int, rate: int | None = None) -> float:
    """Return the longest time that the messages of a block take, s: from its first byte to its last."""
    return message_s(link, "BLOCK", rate) + codes * message_s(link, "BLOCK_SUM", rate)


def block_rate_Hz(link: Link, codes: int, chips: int, chip_s: float, sensors: int = 1) -> float:
    """Return how many blocks a second each of the sensors on a link can send; the arguments are those of `choose`.

    Examples
    --------
    >>> [round(block_rate_Hz(Link.CAN, 8, 1023, 97.75e-6, sensors)) for sensors in (1, 2, 3, 4)]
    [330, 248, 161, 118]
    """
    if link is Link.CAN and codes > MOST_CODES_ON_CAN:
        return 0.0
    left = SHARE[link] / sensors - load(link, Carrier.CYCLES, codes, chips, chip_s)
    return max(0.0, min(1.0 / (BLOCK_CHIPS * chip_s), left / block_s(link, codes)))


def pose_rate_Hz(link: Link, codes: int, chips: int, chip_s: float, sensors: int = 1) -> float:
    """Return how many poses of its own blocks a second each of the sensors on a link can send, beside its cycles."""
    pose_s = len(ON_SENSOR_POSE) * message_s(link, "BLOCK_SUM")  # the sensor pays for the longest
    left = SHARE[link] / sensors - load(link, Carrier.CYCLES, codes, chips, chip_s) - pose_s / (chips * chip_s)
    return max(0.0, min(1.0 / (BLOCK_CHIPS * chip_s), left / pose_s))


@dataclass(frozen=True)
class Choice:
    """What a sensor is to send on a link.

    Attributes
    ----------
    carrier : Carrier
    load : float
        The part of the link that it takes, at most, with all that do the same.
    text : str
        What was chosen and why, without a full stop.
    """

    carrier: Carrier
    load: float
    text: str
    link: Link
    reduced: bool = False
    """Whether some of the blocks are left out, since the link does not carry all."""

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
        Sensors that share CAN and tell of their motion there; a serial line has one.

    Examples
    --------
    >>> print(choose(Link.CAN, 8, 1023, 97.75e-6).text)
    sums of 8 codes 330 times a second, at most 49 % of CAN at 1 Mbit/s
    >>> print(choose(Link.CAN, 20, 1023, 97.75e-6).text)
    sums of 20 codes 212 times a second, not 330, at most 75 % of CAN at 1 Mbit/s
    >>> print(choose(Link.CAN, 8, 1023, 97.75e-6, sensors=4).text)
    sums of 8 codes 118 times a second, not 330, with those of 4 sensors at most 75 % of CAN at 1 Mbit/s
    >>> print(choose(Link.CAN, 8, 1023, 97.75e-6, sensors=14).text)
    whole cycles, 10 a second: sums of 8 codes of 14 sensors would come 25 times a second over CAN at 1 Mbit/s
    >>> print(choose(Link.SERIAL, 40, 1023, 97.75e-6).text)
    every chip, at most 85 % of serial at 2 Mbaud: sums of 40 codes 330 times a second would take 112 %
    """

    def taken(carrier: Carrier) -> float:
        return sensors * load(link, carrier, codes, chips, chip_s)

    blocks, streamed, most_Hz = taken(Carrier.BLOCKS), taken(Carrier.CHIPS), 1.0 / (BLOCK_CHIPS * chip_s)
    sums, full = f"sums of {counted(codes, 'codes')}", f"{most_Hz:.0f} times a second"
    if blocks <= SHARE[link]:
        with_all = "" if sensors == 1 else f" with those of {sensors} sensors"
        text = f"{sums} {full},{with_all} at most {blocks:.0%} of {NAMES[link]}"
        return Choice(Carrier.BLOCKS, blocks, _spaced(text), link)
    if link is Link.SERIAL and streamed <= SHARE[link]:
        text = f"every chip, at most {streamed:.0%} of {NAMES[link]}: {sums} {full} would take {blocks:.0%}"
        return Choice(Carrier.CHIPS, streamed, _spaced(text), link)
    rate_Hz = block_rate_Hz(link, codes, chips, chip_s, sensors) if link is Link.CAN else 0.0
    if rate_Hz >= LEAST_HZ:
        with_all = "" if sensors == 1 else f" with those of {sensors} sensors"
        some = f"{rate_Hz:.0f} times a second, not {most_Hz:.0f}"
        text = f"{sums} {some},{with_all} at most {SHARE[link]:.0%} of {NAMES[link]}"
        return Choice(Carrier.BLOCKS, SHARE[link], _spaced(text), link, reduced=True)
    of_sensors = "" if sensors == 1 else f" of {sensors} sensors"
    if rate_Hz > 0.0:
        why = f"{sums}{of_sensors} would come {rate_Hz:.0f} times a second over {NAMES[link]}"
    else:
        why = f"{sums}{of_sensors} {full} would take {blocks:.0%} of {NAMES[link]}, more than {SHARE[link]:.0%}"
    text = f"whole cycles, {1.0 / (chips * chip_s):.0f} a second: {why}"
    return Choice(Carrier.CYCLES, taken(Carrier.CYCLES), _spaced(text), link)


def cycles_of_strongest(link: Link, codes: int, chips: int, chip_s: float) -> Choice:
    """Return the choice for a sensor that chooses so many codes, at most, anew in each cycle: whole cycles.

    Examples
    --------
    >>> print(cycles_of_strongest(Link.CAN, 8, 1023, 97.75e-6).text)
    whole cycles, 10 a second, at most 2 % of CAN at 1 Mbit/s: the up to 8 codes that it chooses change
    """
    taken = load(link, Carrier.CYCLES, codes, chips, chip_s)
    rate = f"{1.0 / (chips * chip_s):.0f} a second"
    text = f"whole cycles, {rate}, at most {taken:.0%} of {NAMES[link]}: the up to {counted(codes, 'codes')} that it"
    return Choice(
        Carrier.CYCLES, taken, _spaced(f"{text} {'chooses change' if codes > 1 else 'chooses changes'}"), link
    )


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


TABLE_SENSORS = (1, 2, 3, 4, 6, 8)


def shared_table(chips: int = 1023, chip_s: float = 97.75e-6) -> str:
    """Return as a table in Markdown how often each of several sensors on one CAN sends (`protocol/framing.md`)."""
    lines = [
        f"| codes | {' | '.join(counted(sensors, 'sensors') for sensors in TABLE_SENSORS)} |",
        f"| --- |{' --- |' * len(TABLE_SENSORS)}",
    ]
    for codes in TABLE_CODES[:-1]:
        rates = [
            (
                block_rate_Hz(Link.CAN, codes, chips, chip_s, sensors),
                pose_rate_Hz(Link.CAN, codes, chips, chip_s, sensors),
            )
            for sensors in TABLE_SENSORS
        ]
        cells = [f"{_or_none(blocks)} / {_or_none(poses, 0.5)}" for blocks, poses in rates]
        lines.append(f"| {codes} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def rate_table(chips: int = 1023, chip_s: float = 97.75e-6) -> str:
    """Return as a table in Markdown what links of several rates carry (`protocol/framing.md`)."""
    lines = [
        "| link | bits a second | cycles of 8 codes | of 16 | of 64 | most codes, 1 sensor | 4 sensors | 16 sensors |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for link, rates in RATES.items():
        for rate in rates:
            parts = [f"{100.0 * load(link, Carrier.CYCLES, codes, chips, chip_s, rate):.1f} %" for codes in (8, 16, 64)]
            sensors = (1, 4, 16) if link is Link.CAN else (1,)
            most = [str(most_reported(link, 64, chips, chip_s, count, rate) or "-") for count in sensors]
            cells = [str(link), f"{rate:,}", *parts, *most, *[""] * (3 - len(most))]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def reported_text(link: Link, codes: int, chips: int, chip_s: float, sensors: int, rate: int) -> str:
    """Return how many codes a sensor is to report on a link of a rate, where up to ``codes`` are wanted, and why.

    Examples
    --------
    >>> print(reported_text(Link.CAN, 16, 1023, 97.75e-6, 4, 125_000))
    11 of the strongest codes, not 16: with those of 4 sensors at most 75 % of CAN at 125000 bit/s
    """
    most = most_reported(link, codes, chips, chip_s, sensors, rate)
    with_all = "" if sensors == 1 else f" with those of {sensors} sensors"
    if most == 0:
        return _spaced(
            f"nothing: one code a cycle{with_all} takes more than {SHARE[link]:.0%} of {link} at {rate} bit/s"
        )
    part = sensors * load(link, Carrier.CYCLES, most, chips, chip_s, rate)
    fewer = f", not {codes}" if most < codes else ""
    share = SHARE[link] if fewer else part
    text = f"{most} of the strongest codes{fewer}:{with_all} at most {share:.0%} of {link} at {rate} bit/s"
    return _spaced(text)


def _or_none(rate_Hz: float, least_Hz: float = LEAST_HZ) -> str:
    return f"{rate_Hz:.0f}" if rate_Hz >= least_Hz else "-"


def main(given: list[str] | None = None) -> None:
    """Print the tables of the page, or what a sensor among some others sends on each link."""
    parser = argparse.ArgumentParser(prog="python -m goldfield.link.budget", description=__doc__)
    parser.add_argument("--codes", type=int, metavar="N", help="what so many codes allow, in place of the tables")
    parser.add_argument("--sensors", type=int, default=1, metavar="N", help="sensors on CAN that tell of their motion")
    parser.add_argument("--strongest", type=int, metavar="K", help="what a sensor that chooses up to K codes takes")
    parser.add_argument("--chips", type=int, default=1023, metavar="N", help="chips in a cycle (default 1023)")
    options = parser.parse_args(given)
    chip_s = 97.75e-6
    if options.strongest is not None:
        for link in Link:
            print(f"{link}: {cycles_of_strongest(link, options.strongest, options.chips, chip_s).text}")
            for rate in RATES[link]:
                sensors = options.sensors if link is Link.CAN else 1
                print(f"  {reported_text(link, options.strongest, options.chips, chip_s, sensors, rate)}")
        return
    if options.codes is None:
        print(table(options.chips), shared_table(options.chips), rate_table(options.chips), sep="\n", end="")
        return
    for link, sensors in ((Link.SERIAL, 1), (Link.CAN, options.sensors)):
        print(f"{link}: {choose(link, options.codes, options.chips, chip_s, sensors).text}")
    rate_Hz = pose_rate_Hz(Link.CAN, options.codes, options.chips, chip_s, options.sensors)
    print(f"{Link.CAN}, poses of the sensors themselves (--on-sensor): {rate_Hz:.0f} a second")


if __name__ == "__main__":
    main()
