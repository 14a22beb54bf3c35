"""What a user decides about the pipeline: how poses are made, which node is read, for how long."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from numbers import Real

from goldfield.errors import UserError, option
from goldfield.link.access_key import AccessKey
from goldfield.site import Site

LAST_NODE = 4095
"""The largest node that the twelve bits of a message's identifier hold; 0 is no node."""

HIGHEST_RATE_HZ = 10_000.0
"""Poses a second that can be asked for; the chips themselves come at 10,230 Hz, so more would tell nothing."""

USUAL_STRONGEST = 16
"""How many a sensor of a site of hundreds of beacons chooses unless it is said: more add little to a pose."""

MOST_STRONGEST = 64
"""Most codes that a sensor can choose by their strength, as many as it reports."""

LONGEST_LAG_S = 2.0
"""Longest lag of a smoothed pose; after 100 ms there is next to nothing to gain."""


class Method(StrEnum):
    """How the pose of an epoch is made."""

    EACH = "each"
    """Every epoch is located by itself, with no prior."""
    TRACK = "track"
    """A filter follows the sensor: a pose is made of all that came up to its time, block by block where blocks come."""
    ON_SENSOR = "on_sensor"
    """The sensor board computes its poses itself; the host passes them on."""


def chosen_method(track: bool, on_sensor: bool, rate_hz: float | None = None, lag_s: float | None = None) -> Method:
    """Return the method that two switches choose; a rate or a lag needs a track, of the host's or of the sensor's.

    Raises
    ------
    UserError
        If both are on, or the sensor is to compute poses and the host to smooth them.
    """
    if track and on_sensor:
        raise UserError(
            f"{option('on_sensor')} and {option('track')} are both given: the sensor tracks by itself; "
            "leave out one of them"
        )
    if on_sensor and lag_s is not None:
        raise UserError(
            f"{option('on_sensor')} and {option('lag_s')} are both given: a pose that the sensor computes is not "
            "smoothed; leave out one of them"
        )
    if on_sensor:
        return Method.ON_SENSOR
    return Method.TRACK if track or rate_hz is not None or lag_s is not None else Method.EACH


@dataclass(frozen=True)
class Options:
    """The choices, with their defaults.

    Attributes
    ----------
    method : Method
    node : int or None
        Node of the sensor, 1 to 4095, which may be an anchor's; None: the only sensor there is, and no anchor.
    seconds : float or None
        Ends the epochs after so much time of the sensor; None: they go on until the log ends, or without end.
    channel : str or None
        Channel of the sensor in a log or on an interface that has several.
    listen_only : bool
        Nothing is ever sent: for a bus on which a recording is replayed, or that another host has set up.
    reconnect : bool
        A live link that is gone, and a sensor that is silent, are waited for; else they end the epochs.
    awaits : bool
        A live sensor that is not heard at the start is waited for, too; else it ends what reads it.
    rate_hz : float or None
        Poses a second of the sensor's time; None: one a cycle. Only for a track, the host's or the sensor's own.
    lag_s : float or None
        By how much the poses of a track are late, to be made of what came after them, too; None: each is made of what
        came up to its time and is out at once.
    strongest : int or None
        The sensor is to report so many of the strongest codes that it hears in each cycle; None: those of the site.
        In a recording it has done so. Poses are then made of whole cycles.
    key : AccessKey or None
        What unlocks the sensor if it is locked and is not set up yet.
    bit_rate : int or None
        Bits a second of a live link; None: they are found on a serial line, on CAN those of the kernel or 1 Mbit/s.
    """

    method: Method = Method.EACH
    node: int | None = None
    seconds: float | None = None
    channel: str | None = None
    listen_only: bool = False
    reconnect: bool = False
    rate_hz: float | None = None
    lag_s: float | None = None
    awaits: bool = False
    strongest: int | None = None
    key: AccessKey | None = field(default=None, repr=False)
    bit_rate: int | None = None

    def check(self, site: Site) -> None:
        """Check that the options suit a site.

        Raises
        ------
        UserError
            If there is no such node, rate or lag, or the sensor is to compute poses from beacons that a board cannot
            separate, or with axes or metal of which a board does not know.
        """
        _check_range("rate_hz", self.rate_hz, HIGHEST_RATE_HZ, "Hz")
        _check_range("lag_s", self.lag_s, LONGEST_LAG_S, "s")
        if self.node is not None and not 1 <= self.node <= LAST_NODE:
            raise UserError(f"{option('node', self.node)}: is no node: nodes are 1 to {LAST_NODE}")
        if self.strongest is not None:
            self._check_strongest(site)
        if self.method is not Method.ON_SENSOR:
            return
        if self.rate_hz is not None:
            from goldfield.sensor.pose_rate import blocks_a_pose  # loads all messages: not for the help of a command

            blocks_a_pose(site, self.rate_hz)
        told = (site.sensor.axes, site.sensor.noise_ratio, site.sensor.lever_m)
        if any(part is not None for part in told):
            raise UserError(
                f"site {site.name}: a sensor that computes its own pose takes what its axes read for the field and "
                f"knows no axes, levers or noise of each, as the site file has them: leave out {option('on_sensor')}"
            )
        if site.metal is not None:
            raise UserError(
                f"site {site.name}: a sensor that computes its own pose does not know what metal adds to the fields "
                f"([metal] of the site file): leave out {option('on_sensor')}"
            )
        own_codes = site.access == "cdma" and len(set(site.codes)) == len(site.beacons)
        code_v = (
            site.chips + 1
        )  # the one code of the family that the board's closed form does not separate (framing.md)
        if not own_codes or code_v in site.codes:
            raise UserError(
                f"site {site.name}: a sensor computes its own pose only from beacons that have each their own code, "
                f"none of them {code_v}: change the codes or leave out {option('on_sensor')}"
            )

    def _check_strongest(self, site: Site) -> None:
        most = most_strongest(site)
        told = option("strongest", self.strongest)
        if not 1 <= (self.strongest or 0) <= most:
            raise UserError(f"{told}: a sensor chooses 1 to {most} codes of degree {site.degree}")
        if self.rate_hz is not None or self.lag_s is not None:
            other = option("rate_hz") if self.rate_hz is not None else option("lag_s")
            raise UserError(
                f"{told} and {other} are both given: poses between the cycles need the same codes all the time; leave "
                "out one of them"
            )
        if site.chips + 1 in site.codes:
            raise UserError(
                f"site {site.name}: a sensor never chooses code {site.chips + 1}, which leaks into others: give that "
                f"beacon another code, or leave out {option('strongest')}"
            )


def most_strongest(site: Site) -> int:
    """Return how many codes a sensor can choose on a site."""
    return min(MOST_STRONGEST, (site.chips + 1) // 8)


def _check_range(name: str, value: float | None, highest: float, unit: str) -> None:
    if value is None or (isinstance(value, Real) and 0.0 < value <= highest):
        return
    told = f"{value:g}" if isinstance(value, float) else f"{value!r}"
    raise UserError(f"{option(name)}: {told} {unit} is not above 0 and at most {highest:g} {unit}")
