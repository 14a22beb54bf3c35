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
from goldfield.link.line import FASTEST, RATES, Line, Link
from goldfield.link.reports import ON_SENSOR_POSE
from goldfield_protocol.messages import database
from goldfield_protocol.parameters import PARAMETERS


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


def message_s(line: Line, name: str) -> float:
    """Return the longest time that a message takes on a link, s, with the pause behind it.

    Examples
    --------
    >>> [round(1e6 * message_s(Line(link, RATES[link][0]), "BLOCK")) for link in Link]
    [80, 160]
    """
    length = database().get_message_by_name(name).length
    if line.link is Link.SERIAL:
        code_and_delimiter = 2  # COBS adds a byte to frames of this size
        return 10 * (4 + length + 2 + code_and_delimiter) / line.bit_rate
    stuffed = 39 + 8 * length + 15  # from the start of the frame to the end of its CRC
    delimiters_and_pause = 1 + 2 + 7 + 3
    return (stuffed + (stuffed - 1) // 4 + delimiters_and_pause) / line.bit_rate


def load(line: Line, carrier: Carrier, codes: int, chips: int, chip_s: float) -> float:
    """Return the part of a link that a sensor takes with its reports of so many codes, at most.

    Parameters
    ----------
    line : Line
    carrier : Carrier
        What is sent besides the cycles.
    codes : int
        Codes that are reported.
    chips : int
        Chips in a cycle.
    chip_s : float
        Length of a chip, s.
    """
    headers = sum(message_s(line, name) for name in ("EPOCH", "EPOCH_STATUS", "EPOCH_OFFSET"))
    cycles = (headers + codes * message_s(line, "FIELD")) / (chips * chip_s)
    if carrier is Carrier.BLOCKS:
        return cycles + block_s(line, codes) / (BLOCK_CHIPS * chip_s)
    return cycles + (message_s(line, "CHIP") / chip_s if carrier is Carrier.CHIPS else 0.0)


def most_reported(line: Line, codes: int, chips: int, chip_s: float, sensors: int = 1) -> int:
    """Return how many codes, up to so many, each of the sensors on a link can report in every cycle; 0: not even one.

    Examples
    --------
    >>> [most_reported(Line(Link.CAN, rate), 64, 1023, 97.75e-6) for rate in (125_000, 500_000, 1_000_000)]
    [55, 64, 64]
    >>> [most_reported(Line(Link.SERIAL, rate), 64, 1023, 97.75e-6) for rate in (115_200, 921_600)]
    [61, 64]
    """
    fitting = (
        count
        for count in range(codes, 0, -1)
        if sensors * load(line, Carrier.CYCLES, count, chips, chip_s) <= SHARE[line.link]
    )
    return next(fitting, 0)


def block_s(line: Line, codes: int) -> float:
    """Return the longest time that the messages of a block take, s: from its first byte to its last."""
    return message_s(line, "BLOCK") + codes * message_s(line, "BLOCK_SUM")


def block_rate_Hz(line: Line, codes: int, chips: int, chip_s: float, sensors: int = 1) -> float:
    """Return how many blocks a second each of the sensors on a link can send; the arguments are those of `choose`.

    Examples
    --------
    >>> [round(block_rate_Hz(Line(Link.CAN, 1_000_000), 8, 1023, 97.75e-6, sensors)) for sensors in (1, 2, 3, 4)]
    [330, 248, 161, 118]
    >>> [round(block_rate_Hz(Line(Link.CAN, rate), 8, 1023, 97.75e-6)) for rate in RATES[Link.CAN]]
    [330, 248, 118, 53]
    """
    if line.link is Link.CAN and codes > MOST_CODES_ON_CAN:
        return 0.0
    left = SHARE[line.link] / sensors - load(line, Carrier.CYCLES, codes, chips, chip_s)
    return max(0.0, min(1.0 / (BLOCK_CHIPS * chip_s), left / block_s(line, codes)))


def pose_rate_Hz(line: Line, codes: int, chips: int, chip_s: float, sensors: int = 1) -> float:
    """Return how many poses of its own blocks a second each of the sensors on a link can send, beside its cycles."""
    pose_s = len(ON_SENSOR_POSE) * message_s(line, "BLOCK_SUM")  # the sensor pays for the longest
    left = SHARE[line.link] / sensors - load(line, Carrier.CYCLES, codes, chips, chip_s) - pose_s / (chips * chip_s)
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


def choose(line: Line, codes: int, chips: int, chip_s: float, sensors: int = 1) -> Choice:
    """Choose what the sensors on a link are to send: blocks where they fit, else chips, else cycles only.

    Parameters
    ----------
    line : Line
    codes, chips, chip_s
        As in `load`.
    sensors : int, optional
        Sensors that share CAN and tell of their motion there; a serial line has one.

    Examples
    --------
    >>> print(choose(Line(Link.CAN, 1_000_000), 8, 1023, 97.75e-6).text)
    sums of 8 codes 330 times a second, at most 49 % of CAN at 1 Mbit/s
    >>> print(choose(Line(Link.CAN, 1_000_000), 20, 1023, 97.75e-6).text)
    sums of 20 codes 212 times a second, not 330, at most 75 % of CAN at 1 Mbit/s
    >>> print(choose(Line(Link.CAN, 1_000_000), 8, 1023, 97.75e-6, sensors=4).text)
    sums of 8 codes 118 times a second, not 330, with those of 4 sensors at most 75 % of CAN at 1 Mbit/s
    >>> print(choose(Line(Link.CAN, 1_000_000), 8, 1023, 97.75e-6, sensors=14).text)
    whole cycles, 10 a second: sums of 8 codes of 14 sensors would come 25 times a second over CAN at 1 Mbit/s
    >>> print(choose(Line(Link.SERIAL, 2_000_000), 40, 1023, 97.75e-6).text)
    every chip, at most 85 % of serial at 2 Mbaud: sums of 40 codes 330 times a second would take 112 %
    """

    def taken(carrier: Carrier) -> float:
        return sensors * load(line, carrier, codes, chips, chip_s)

    blocks, streamed, most_Hz = taken(Carrier.BLOCKS), taken(Carrier.CHIPS), 1.0 / (BLOCK_CHIPS * chip_s)
    sums, full = f"sums of {counted(codes, 'codes')}", f"{most_Hz:.0f} times a second"
    if blocks <= SHARE[line.link]:
        with_all = "" if sensors == 1 else f" with those of {sensors} sensors"
        text = f"{sums} {full},{with_all} at most {blocks:.0%} of {line}"
        return Choice(Carrier.BLOCKS, blocks, _spaced(text), line.link)
    if line.link is Link.SERIAL and streamed <= SHARE[line.link]:
        text = f"every chip, at most {streamed:.0%} of {line}: {sums} {full} would take {blocks:.0%}"
        return Choice(Carrier.CHIPS, streamed, _spaced(text), line.link)
    rate_Hz = block_rate_Hz(line, codes, chips, chip_s, sensors) if line.link is Link.CAN else 0.0
    if rate_Hz >= LEAST_HZ:
        with_all = "" if sensors == 1 else f" with those of {sensors} sensors"
        some = f"{rate_Hz:.0f} times a second, not {most_Hz:.0f}"
        text = f"{sums} {some},{with_all} at most {SHARE[line.link]:.0%} of {line}"
        return Choice(Carrier.BLOCKS, SHARE[line.link], _spaced(text), line.link, reduced=True)
    of_sensors = "" if sensors == 1 else f" of {sensors} sensors"
    if rate_Hz > 0.0:
        why = f"{sums}{of_sensors} would come {rate_Hz:.0f} times a second over {line}"
    else:
        why = f"{sums}{of_sensors} {full} would take {blocks:.0%} of {line}, more than {SHARE[line.link]:.0%}"
    text = f"whole cycles, {1.0 / (chips * chip_s):.0f} a second: {why}"
    return Choice(Carrier.CYCLES, taken(Carrier.CYCLES), _spaced(text), line.link)


def cycles_of_strongest(line: Line, codes: int, chips: int, chip_s: float) -> Choice:
    """Return the choice for a sensor that chooses so many codes, at most, anew in each cycle: whole cycles.

    Examples
    --------
    >>> print(cycles_of_strongest(Line(Link.CAN, 1_000_000), 8, 1023, 97.75e-6).text)
    whole cycles, 10 a second, at most 2 % of CAN at 1 Mbit/s: the up to 8 codes that it chooses change
    """
    taken = load(line, Carrier.CYCLES, codes, chips, chip_s)
    rate = f"{1.0 / (chips * chip_s):.0f} a second"
    text = f"whole cycles, {rate}, at most {taken:.0%} of {line}: the up to {counted(codes, 'codes')} that it"
    return Choice(
        Carrier.CYCLES, taken, _spaced(f"{text} {'chooses change' if codes > 1 else 'chooses changes'}"), line.link
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
            cells += [f"{100.0 * load(FASTEST[link], carrier, codes, chips, chip_s):.1f} %" for carrier in carriers]
            cells.append(f"{1e3 * block_s(FASTEST[link], codes):.2f}")
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
                block_rate_Hz(FASTEST[Link.CAN], codes, chips, chip_s, sensors),
                pose_rate_Hz(FASTEST[Link.CAN], codes, chips, chip_s, sensors),
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
    for line in (Line(link, rate) for link, rates in RATES.items() for rate in reversed(rates)):
        parts = [f"{100.0 * load(line, Carrier.CYCLES, codes, chips, chip_s):.1f} %" for codes in (8, 16, 64)]
        sensors = (1, 4, 16) if line.link is Link.CAN else (1,)
        most = [str(most_reported(line, 64, chips, chip_s, count) or "-") for count in sensors]
        cells = [str(line.link), f"{line.bit_rate:,}", *parts, *most, *[""] * (3 - len(most))]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def reported_text(line: Line, codes: int, chips: int, chip_s: float, sensors: int) -> str:
    """Return how many codes a sensor is to report on a link, where up to ``codes`` are wanted, and why.

    Examples
    --------
    >>> print(reported_text(Line(Link.CAN, 125_000), 16, 1023, 97.75e-6, 4))
    11 of the strongest codes, not 16: with those of 4 sensors at most 75 % of CAN at 125 kbit/s
    """
    most = most_reported(line, codes, chips, chip_s, sensors)
    with_all = "" if sensors == 1 else f" with those of {sensors} sensors"
    if most == 0:
        return _spaced(f"nothing: one code a cycle{with_all} takes more than {SHARE[line.link]:.0%} of {line}")
    fewer = f", not {codes}" if most < codes else ""
    share = SHARE[line.link] if fewer else sensors * load(line, Carrier.CYCLES, most, chips, chip_s)
    return _spaced(f"{most} of the strongest codes{fewer}:{with_all} at most {share:.0%} of {line}")


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
    if options.codes is None and options.strongest is None:
        print(table(options.chips), shared_table(options.chips), rate_table(options.chips), sep="\n", end="")
        return
    for link, rates in RATES.items():
        sensors = options.sensors if link is Link.CAN else 1
        for line in (Line(link, rate) for rate in rates):
            if options.strongest is not None:
                print(f"{line}: {reported_text(line, options.strongest, options.chips, chip_s, sensors)}")
                continue
            print(f"{link}: {choose(line, options.codes, options.chips, chip_s, sensors).text}")
            if link is Link.CAN:
                rate_Hz = pose_rate_Hz(line, options.codes, options.chips, chip_s, sensors)
                print(f"  poses of the sensors themselves (--on-sensor): {rate_Hz:.0f} a second")


if __name__ == "__main__":
    main()
