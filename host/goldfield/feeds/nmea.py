"""Poses as sentences in the form of NMEA 0183, for loggers and plotters that know such lines: two for each pose.

``$PGFDP,unix_s,x_m,y_m,z_m,sd_x_m,sd_y_m,sd_z_m,status,latency_s*hh`` is the position and
``$PGFDA,unix_s,qx,qy,qz,qw,sd_x_rad,sd_y_rad,sd_z_rad,status*hh`` the attitude; what is not known is empty.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import reduce
from operator import xor

import numpy as np

from goldfield.feeds.address import Address
from goldfield.feeds.feed import Clock, Feed, Setting
from goldfield.feeds.stamped import StampedPose
from goldfield.feeds.udp import DatagramFeed
from goldfield.files.outputs import OutputFile
from goldfield.types import FloatArray, Status

LETTERS = {
    Status.OK: "A",
    Status.UNVERIFIED: "U",
    Status.WEAK: "W",
    Status.AMBIGUOUS: "M",
    Status.INCONSISTENT: "I",
    Status.FAILED: "V",
}
"""A status in one letter: A and V are NMEA's for data that are valid and that are not."""


def open_feed(address: Address, setting: Setting) -> Feed:
    """Return the feed that writes a file or sends datagrams, with the errors of `OutputFile` or `DatagramFeed`."""
    if address.scheme == "nmea":
        return NmeaFile(OutputFile(address.path, "the sentences", live=True, force=setting.force), setting.clock)
    return DatagramFeed(address, setting.clock, sentences)


class NmeaFile:
    """Writes the two sentences of each pose.

    Parameters
    ----------
    file : OutputFile
    clock : callable
    """

    whole = True
    dropped = 0

    def __init__(self, file: OutputFile, clock: Clock) -> None:
        self._file = file
        self._clock = clock

    def write(self, stamped: StampedPose, /) -> None:
        """Append a pose."""
        self._file.write(sentences(stamped, self._clock()))

    def close(self) -> None:
        """Close the file and keep it."""
        self._file.close()


def sentences(stamped: StampedPose, now_s: float) -> bytes:
    """Return the sentences of a pose, whatever its status; in any room less than 1 km wide none is over 82 characters.

    Parameters
    ----------
    stamped : StampedPose
    now_s : float
        The time by the wall clock, s since 1970.
    """
    pose = stamped.pose
    time, letter = _number(stamped.unix_s, 3), LETTERS[pose.status]
    position = [time, *_numbers(pose.position_m, 3), *_numbers(_deviations(pose.position_cov_m2), 3)]
    attitude = [time, *_numbers(pose.orientation_xyzw, 4), *_numbers(_deviations(pose.attitude_cov_rad2), 4)]
    latency = _number(stamped.latency_s(now_s), 3)
    return (sentence("PGFDP", [*position, letter, latency]) + sentence("PGFDA", [*attitude, letter])).encode("ascii")


def sentence(name: str, fields: Iterable[str]) -> str:
    r"""Return a sentence: the checksum is the exclusive or of all characters between ``$`` and ``*``.

    Examples
    --------
    >>> sentence("GPGLL", ["5300.97914", "N", "00259.98174", "E", "125926", "A"])
    '$GPGLL,5300.97914,N,00259.98174,E,125926,A*28\r\n'
    """
    body = ",".join([name, *fields])
    return f"${body}*{reduce(xor, body.encode('ascii')):02X}\r\n"


def _deviations(covariance: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.diag(covariance)))


def _numbers(values: FloatArray, digits: int) -> list[str]:
    return [_number(value, digits) for value in values.tolist()]


def _number(value: float, digits: int) -> str:
    """Return a number with so many digits behind the point; empty if it is not finite."""
    return f"{value:.{digits}f}" if math.isfinite(value) else ""
