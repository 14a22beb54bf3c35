"""Types that pass between the stages of the host: fields of an epoch, poses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

from goldfield.errors import UserError, counted

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Fields:
    """The separated fields of one epoch, in the sensor's frame; equal to itself only, as arrays have no one answer.

    Attributes
    ----------
    epoch : int
        Number of the code cycle.
    time_s : float
        Middle of the cycle.
    beacons : tuple of str
        Beacon ids of the site, one a row of ``field_T``.
    field_T : ndarray, shape (n, 3)
        One vector a beacon, tesla; NaN where an axis was not measured.
    sigma_T : ndarray, shape (n,)
        Standard deviation of each component.
    sweep_T_s : float or None
        Standard deviation of the ramp of the ambient field that is left in the fields, T/s, each axis; None if nobody
        took the ramp out. Only of interest while the sensor turns (`goldfield.access.sweep`).

    Raises
    ------
    UserError
        If the arrays' shapes are not those of as many beacons, they hold anything but real numbers, or a beacon comes
        twice.

    Examples
    --------
    >>> Fields(0, 0.0, ("b1", "b2"), np.zeros((2, 3)), np.ones(3))
    Traceback (most recent call last):
    goldfield.errors.UserError: sigma_T= of Fields has the shape (3,): 2 beacons need (2,)
    >>> Fields(0, 0.0, ("b1", "b1"), np.zeros((2, 3)), np.ones(2))
    Traceback (most recent call last):
    goldfield.errors.UserError: beacons= of Fields names b1 twice: a beacon has one row
    """

    epoch: int
    time_s: float
    beacons: tuple[str, ...]
    field_T: FloatArray
    sigma_T: FloatArray
    sweep_T_s: float | None = None

    def __post_init__(self) -> None:
        """Check shapes and names, so that nothing reaches the search that is not as this class says."""
        object.__setattr__(self, "beacons", tuple(self.beacons))  # a list would do, too
        count = len(self.beacons)
        for name, shape in (("field_T", (count, 3)), ("sigma_T", (count,))):
            values = np.asarray(getattr(self, name))
            if values.shape != shape:
                needed = f"{counted(count, 'beacons need')} {shape}"
                raise UserError(f"{name}= of Fields has the shape {values.shape}: {needed}")
            if count and values.dtype.kind not in "fiu":
                raise UserError(f"{name}= of Fields holds {values.dtype.name} values: it needs real numbers, in tesla")
            object.__setattr__(self, name, values)  # a list would do, too
        if len(set(self.beacons)) < count:
            twice = next(name for name in self.beacons if self.beacons.count(name) > 1)
            raise UserError(f"beacons= of Fields names {twice} twice: a beacon has one row")


LARGEST_T, LEAST_SIGMA_T = 1e3, 1e-15
"""No field that is measured is stronger, and no sensor has less noise: beyond these, numbers lose all their digits."""


def usable_components(field_T: FloatArray, sigma_T: FloatArray) -> NDArray[np.bool_]:
    """Tell which components, shape (..., n, 3), are measurements: finite, possible, and of a known deviation."""
    known = np.isfinite(sigma_T) & (sigma_T > 0.0) & (sigma_T <= LARGEST_T)
    return known[..., None] & (np.abs(field_T) <= LARGEST_T)


@dataclass(frozen=True, eq=False)
class Block:
    """What a sensor knows of some successive chips, in its own frame: their samples or sums of them; docs/blocks.md.

    Attributes
    ----------
    cycle : int
        Number of the code cycle of the first sample.
    chip : int
        Code chip of the first sample, 0 to N - 1; a block may run into the next cycle.
    time_s : float
        Time of the last sample, which is the end of its chip, on the sensor's clock.
    chips : int
        How many successive chips the block has.
    data_T : ndarray, shape (chips, 3) or (c + 1, 3)
        The samples, one row a chip, if ``sampled``; else the sums, in tesla, of samples times code for each of the
        site's c codes in the order of ``site.codes``, and last the plain sum. NaN on an axis that was not measured.
    sampled : bool
    """

    cycle: int
    chip: int
    time_s: float
    chips: int
    data_T: FloatArray
    sampled: bool = False


class Status(StrEnum):
    """What a pose is worth; where several hold, the last of them is told."""

    OK = "ok"
    """The pose fits the fields, no other does, and no fault of one beacon hides an error above the alert limit."""
    UNVERIFIED = "unverified"
    """The pose fits the fields, but a fault of one beacon could hide an error above the alert limit."""
    WEAK = "weak"
    """The beacons that were heard do not fix the pose."""
    AMBIGUOUS = "ambiguous"
    """Two poses fit the fields."""
    INCONSISTENT = "inconsistent"
    """No pose fits the fields of a clear majority of the beacons, or something else is known to be wrong."""
    FAILED = "failed"
    """There is no pose."""


class Explanation(StrEnum):
    """Kinds of `Finding`: in what way the world differs from the site file."""

    MIRRORED = "mirrored"
    """All fields are negated: the sensor's axes are left-handed, or all coils are reversed."""
    STRENGTH = "strength"
    """All fields are larger or smaller by one factor: the sensor's gain, or all currents."""
    AXIS_GAIN = "axis_gain"
    """One axis of the sensor has another gain."""
    SENSOR = "sensor"
    """The sensor distorts the fields in another linear way: axes that are not square, iron beside it."""
    UNITS = "units"
    """The site file is in other units of length."""
    DEAD = "dead"
    """A beacon has no field."""
    REVERSED = "reversed"
    """A beacon's field is reversed."""
    CURRENT = "current"
    """A beacon has another current."""
    MOVED = "moved"
    """A beacon is at another place."""
    BEACON = "beacon"
    """A beacon is not as the site says, in no simpler way."""
    CLOCK = "clock"
    """The sensor's clock, or its count of the cycles, is not that of the beacons."""
    BOARD = "board"
    """A board reports that something is wrong with it."""
    UNKNOWN = "unknown"
    """Nothing that was tried explains the fields."""


@dataclass(frozen=True, eq=False)
class Finding:
    """What explains the fields better than the site file does; equal to itself only.

    Attributes
    ----------
    kind : Explanation
    beacons : tuple of str
        Ids of the beacons that it is about; empty if it is about the sensor or the whole site.
    text : str
        A sentence for people: what was found and what to check.
    position_m : ndarray, shape (3,), or None
        Where in the site's frame a beacon fits better.
    factor : float or None
        By what its field, or all fields, or those of an axis must be multiplied; 0 for a beacon that is dead.
    """

    kind: Explanation
    beacons: tuple[str, ...]
    text: str
    position_m: FloatArray | None = None
    factor: float | None = None


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and attitude of the sensor in the site's frame: ``B_site = R B_sensor``; equal to itself only.

    Attributes
    ----------
    epoch, time_s
        As in `Fields`.
    position_m : ndarray, shape (3,)
        NaN when failed.
    orientation_xyzw : ndarray, shape (4,)
        Unit quaternion of R, SciPy's order; NaN when failed. w >= 0 where a pose stands for itself (`locate`) and in
        the first pose of a source or a track; each later pose has the sign with which it is nearer to the one before.
    position_cov_m2 : ndarray, shape (3, 3)
        Covariance of the position in the site's frame.
    attitude_cov_rad2 : ndarray, shape (3, 3)
        Covariance of a small rotation in the site's frame.
    residual : float
        Root of the weighted mean square residual; near 1 when the model and the noise are right.
    status : Status
    used, excluded : tuple of str
        Ids of the beacons that the pose rests on, and of those that were left out.
    alternative : Pose or None
        The other pose of an ambiguous pair.
    reason : str or None
        Why the pose is not worth more, or what was left out of it, as a sentence; None if there is nothing to say.
    protection_m : float
        Radius around the position that the error exceeds undetected only rarely if at most one beacon is not as the
        site says (`goldfield.locate.protection`); infinite if nothing can be promised, NaN when failed.
    residuals : mapping of str to float
        Each beacon's normalised residual by its id, near 1 if the beacon is as the site says.
    findings : tuple of Finding
        What explains the fields better than the site file does.
    """

    epoch: int
    time_s: float
    position_m: FloatArray
    orientation_xyzw: FloatArray
    position_cov_m2: FloatArray
    attitude_cov_rad2: FloatArray
    residual: float
    status: Status
    used: tuple[str, ...]
    excluded: tuple[str, ...] = ()
    alternative: Pose | None = field(default=None, repr=False)
    reason: str | None = None
    protection_m: float = math.inf
    residuals: Mapping[str, float] = field(default_factory=dict, repr=False)
    findings: tuple[Finding, ...] = field(default=(), repr=False)

    @classmethod
    def failed(
        cls,
        fields: Fields,
        used: tuple[str, ...] = (),
        excluded: tuple[str, ...] = (),
        reason: str = "the fields give no pose",
    ) -> Self:
        """Return the pose of an epoch that could not be located: every number is NaN, the status is ``failed``.

        Parameters
        ----------
        fields : Fields
            The epoch; its number and time are those of the pose.
        used : tuple of str
            Ids of the beacons that were tried.
        excluded : tuple of str
            Ids of the beacons that were not looked at.
        reason : str
            Why there is no pose.

        Examples
        --------
        >>> fields = Fields(7, 0.75, ("b1",), np.zeros((1, 3)), np.ones(1))
        >>> pose = Pose.failed(fields, used=fields.beacons)
        >>> pose.epoch, pose.status.value, pose.used, bool(np.isnan(pose.position_m).all())
        (7, 'failed', ('b1',), True)
        """
        return cls(
            epoch=fields.epoch,
            time_s=fields.time_s,
            position_m=np.full(3, np.nan),
            orientation_xyzw=np.full(4, np.nan),
            position_cov_m2=np.full((3, 3), np.nan),
            attitude_cov_rad2=np.full((3, 3), np.nan),
            residual=float("nan"),
            status=Status.FAILED,
            used=used,
            excluded=excluded,
            reason=reason,
            protection_m=math.nan,
        )
