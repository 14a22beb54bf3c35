"""Types that pass between the stages of the host: fields of an epoch, poses."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray

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
    """

    epoch: int
    time_s: float
    beacons: tuple[str, ...]
    field_T: FloatArray
    sigma_T: FloatArray
    sweep_T_s: float | None = None


class Status(StrEnum):
    """What a pose is worth."""

    OK = "ok"
    AMBIGUOUS = "ambiguous"
    WEAK = "weak"
    INCONSISTENT = "inconsistent"
    FAILED = "failed"


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
        Unit quaternion of R, SciPy's order, w >= 0; NaN when failed.
    position_cov_m2 : ndarray, shape (3, 3)
        Covariance of the position in the site's frame.
    attitude_cov_rad2 : ndarray, shape (3, 3)
        Covariance of a small rotation in the site's frame.
    residual : float
        Root of the weighted mean square residual; near 1 when the model and the noise are right.
    status : Status
    used, excluded : tuple of str
        Beacon ids.
    alternative : Pose or None
        The other pose of an ambiguous pair.
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

    @classmethod
    def failed(cls, fields: Fields, used: tuple[str, ...] = (), excluded: tuple[str, ...] = ()) -> Self:
        """Return the pose of an epoch that could not be located: every number is NaN, the status is ``failed``.

        Parameters
        ----------
        fields : Fields
            The epoch; its number and time are those of the pose.
        used : tuple of str
            Ids of the beacons that were tried.
        excluded : tuple of str
            Ids of the beacons that were not looked at.

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
        )
