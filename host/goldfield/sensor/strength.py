"""How strong each beacon is at the sensor, beside what the site says for the pose that was found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goldfield.field import FieldModel
from goldfield.locate.rotations import matrix_of
from goldfield.locate.sensor_axes import axes_of
from goldfield.sensor.pipeline import Epoch
from goldfield.site import Site
from goldfield.types import FloatArray, Status


@dataclass(frozen=True)
class Strength:
    """One beacon at the sensor; NaN where something is not known.

    Attributes
    ----------
    measured_T : float
        Magnitude of its field.
    expected_T : float
        Magnitude that the site file gives at the pose.
    ratio : float
        The measured field's part along the expected one, over the expected one: 1 if all is well, -1 if the coil is
        reversed, 0 if it is off.
    residual : float
        Its normalised residual, near 1 if the beacon is as the site says.
    used : bool
        Whether the pose rests on it.
    """

    measured_T: float
    expected_T: float
    ratio: float
    residual: float
    used: bool


class Strengths:
    """Compares the fields of epochs with the site's.

    Parameters
    ----------
    site : Site
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._model = FieldModel(site.beacons)
        self._axes = axes_of(site.sensor)

    def of(self, epoch: Epoch) -> dict[str, Strength]:
        """Return each beacon's strength in an epoch by its id.

        A beacon that was left out because its board reports a fault has the plain correlation with its code for a
        field, which holds a thousandth of the others.
        """
        pose = epoch.pose
        expected: FloatArray | None = None
        if pose.status is not Status.FAILED:
            in_site, _ = self._model.evaluate(pose.position_m)
            expected = in_site.T @ matrix_of(pose.orientation_xyzw)
        separated = dict(zip(epoch.fields.beacons, epoch.fields.field_T, strict=True))
        found = {}
        for row, beacon in enumerate(self._site.beacons):
            nothing = np.full(3, np.nan)
            measured = separated.get(beacon.id, epoch.report.correlation_T.get(beacon.code, nothing))
            if self._axes is not None:
                measured = self._axes.components(measured)
            wanted = nothing if expected is None else expected[row]
            found[beacon.id] = Strength(
                measured_T=float(np.linalg.norm(measured)),
                expected_T=float(np.linalg.norm(wanted)),
                ratio=float(measured @ wanted / (wanted @ wanted)),
                residual=pose.residuals.get(beacon.id, math.nan),
                used=beacon.id in pose.used,
            )
        return found


def mean_strengths(each: Sequence[dict[str, Strength]]) -> dict[str, Strength]:
    """Return each beacon's median over epochs, without those in which something is not known; used: in half of them."""
    found = {}
    for name in each[0] if each else ():
        rows = [strengths[name] for strengths in each]
        figures = np.array([(row.measured_T, row.expected_T, row.ratio, row.residual) for row in rows])
        known = [column[np.isfinite(column)] for column in figures.T]
        measured, expected, ratio, residual = (float(np.median(c)) if len(c) else math.nan for c in known)
        used = 2 * sum(row.used for row in rows) >= len(rows)
        found[name] = Strength(measured, expected, ratio, residual, used)
    return found
